"""
Measured data: a biaxial test with noise
========================================

A sheet was pulled along x and y, 144 pairs of strain and stress were written down, and stresses are known to 3 %. The
table becomes a data set; columns and units are declared, nothing is guessed::

    tsgdd import-csv biaxial.csv --column "eps_xx=strain x:%" --column "eps_yy=strain y:%" \\
        --column "sigma_xx=stress x:kPa" --column "sigma_yy=stress y:kPa" \\
        --silent zz,yz,xz,xy --stress-measure first_piola --out data.h5

No instrument is at hand here, so an RVE stands in for the tissue.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from mpi4py import MPI

import dd_macro as dd
import tsg_micro as tsg
from tsg_micro.data.figure_style import new_figure, tidy
from workflows.runs.import_csv import import_csv

folder, random = Path(mkdtemp()), np.random.default_rng(1)
tissue = tsg.RVESpec(tsg.Tissue(bar_force=10e-9), free=("zz", "yz", "xz", "xy")).build()
rows = []
for x in np.linspace(0.0, 0.055, 12):
    for y in np.linspace(0.0, 0.055, 12)[:: 1 if len(rows) % 24 == 0 else -1]:
        stress = tissue.solve_strain([x, y, 0, 0, 0, 0], tangent=False).first_piola
        rows.append([100 * x, 100 * y, *(1e-3 * np.diag(stress)[:2] * random.normal(1.0, 0.03, 2))])
header = "strain x,strain y,stress x,stress y"
np.savetxt(folder / "biaxial.csv", rows, fmt="%.6g", delimiter=",", header=header, comments="")

# %%
# The thickness was not measured and carries nothing: it is declared silent, as are the shears, so that they are zero
# and do not count in the metric.

import_csv(
    folder / "biaxial.csv",
    column=["eps_xx=strain x:%", "eps_yy=strain y:%", "sigma_xx=stress x:kPa", "sigma_yy=stress y:kPa"],
    zero=[],
    silent=["zz", "yz", "xz", "xy"],
    stress_measure="first_piola",
    out=folder / "data.h5",
)
data = tsg.read_dataset(folder / "data.h5")

# %%
# A sheet of 200 x 100 µm under other loads, tractions of 40 Pa along x and 25 Pa along y. Three ways to take the
# data: each as a point; each with a tangent that is estimated from its neighbours; and averages of neighbours, which
# take noise out.

operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(10, 5, 1), size=(200e-6, 100e-6, 20e-6)))
planes = [dd.Displacement(side, (0.0,), (axis,)) for axis, side in enumerate(("left", "bottom", "back"))]
loads = [dd.Traction("right", (40.0, 0.0, 0.0)), dd.Traction("top", (0.0, 25.0, 0.0))]
problem = dd.Problem(operator, planes, loads)

strain = {}
for name in ("classical", "second order, estimated tangents", "second order, averages"):
    solution = dd.METHODS[name].prepare(problem, dd.Material(data)).solve()
    strain[name] = solution.mechanical.strain.mean(axis=0)[:2]
    error = dd.check_by_data(solution).error
    print(f"{name}: strain {100 * strain[name].round(4)} %, estimated error {error:.1%}")

# %%
# The tissue itself, asked for the strain under these two stresses by Newton's method on the RVE.

true = np.array(strain["second order, averages"])
for _ in range(5):
    state = tissue.solve_strain([*true, 0, 0, 0, 0])
    block = state.tangent[:2, :2] - state.tangent[:2, 2:] @ np.linalg.solve(
        state.tangent[2:, 2:], state.tangent[2:, :2]
    )
    true = true - np.linalg.solve(block, np.diag(state.first_piola)[:2] - [40.0, 25.0])
print(f"the tissue: {100 * true.round(4)} %")
assert np.abs(strain["second order, averages"] / true - 1.0).max() < 0.05

# %%
# The picture: where data are, and which strain each method finds.

figure = new_figure(6.0, 5.0)
axes = figure.subplots()
drawn = axes.scatter(*100 * data.strain[:, :2].T, c=data.stress[:, 0], s=14)
figure.colorbar(drawn, label="measured stress along x / Pa")
for marker, (name, found) in zip("s^o", strain.items(), strict=True):
    axes.plot(*100 * found, marker, mfc="none", color="tab:red", label=name)
axes.plot(*100 * true, "k+", markersize=14, label="the tissue")
axes.set(xlabel="strain along x / %", ylabel="strain along y / %")
figure.legend(loc="outside upper center", ncols=2, fontsize=9)
tidy(axes)
