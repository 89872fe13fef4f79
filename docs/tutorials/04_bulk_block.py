"""
A block of bulk tissue, in Python
=================================

A cube between smooth plates, compressed by 3 % in finite strain. Its state is homogeneous, so one RVE whose sides are
free must answer the same: two ways to one number.

Three nouns make a solve: a *problem*, a body that is held and loaded, which knows no material; a *material*; a
*method*, which brings both together.
"""

import numpy as np
from mpi4py import MPI

import dd_macro as dd
import tsg_micro as tsg
from tsg_micro.data.figure_style import new_figure, tidy

block = 20e-6  # edge of 2 x 2 x 2 cells, m
edge = 2 * block
mesh = dd.box(MPI.COMM_WORLD, elements=(2, 2, 2), size=(edge, edge, edge))
operator = dd.EnhancedGradientOperator(mesh)  # finite strain, elements that bend

# %%
# ``Displacement(side, values, components)``: the back, bottom and left are planes of symmetry, the front moves.

planes = [dd.Displacement(side, (0.0,), (axis,)) for axis, side in enumerate(("left", "bottom", "back"))]
tissue = tsg.Tissue(bar_force=10e-9)
bulk = tsg.RVESpec.of_kind("bulk", tissue)
method, material = dd.AdaptiveMethod(), dd.Material(source=tsg.RVESource(bulk))

# %%
# One RVE, free of stress along x and y, is followed to the same strains.

rve = tsg.RVESpec.of_kind("bulk", tissue, free=("xx", "yy")).build()
strains = np.linspace(0.0, -0.03, 4)[1:]
plates, alone = [], []
for strain in strains:
    problem = dd.Problem(operator, [*planes, dd.Displacement("front", (strain * edge,), (2,))])
    solution = method.prepare(problem, material).solve()
    plates.append(solution.reaction("front")[2] / edge**2)
    alone.append(rve.solve_strain([0.0, 0.0, strain, 0.0, 0.0, 0.0]).first_piola[2, 2])
    print(f"{strain:.1%}: {plates[-1]:.2f} Pa between plates, {alone[-1]:.2f} Pa of one RVE")

assert np.allclose(plates, alone, rtol=1e-3)

# %%
# The picture: nominal stress over strain.

figure = new_figure(6.0, 4.0)
axes = figure.subplots()
axes.plot(100 * strains, alone, "-", label="one RVE")
axes.plot(100 * strains, plates, "o", label="block between plates")
axes.set(xlabel="strain / %", ylabel="nominal stress / Pa")
axes.legend()
tidy(axes)
