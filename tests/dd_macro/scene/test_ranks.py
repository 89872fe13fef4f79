"""The same answer on 1, 2 and 3 ranks, and errors that reach all of them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from dd_macro import read_quadrature

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts mpirun itself")
ROOT = Path(__file__).parents[3]

SOLVE = """
import sys
import dd_macro
import numpy as np
from mpi4py import MPI
from tsg_micro.data.dataset import Dataset

comm = MPI.COMM_WORLD
law = dd_macro.isotropic(young=1e3, poisson=0.3)
metric = dd_macro.Metric(1.5 * law.C, "stiffer than the law")
strain = np.zeros((2000, 6))
strain[:, [0, 1, 5]] = np.random.default_rng(0).uniform([-0.03, -0.02, -0.03], [0.03, 0.08, 0.03], (2000, 3))
steps = np.arange(2000)
data = Dataset(strain=strain, stress=strain @ law.C, stress_measure="cauchy", path=0 * steps, step=steps)
operator = dd_macro.StrainOperator(dd_macro.box(comm, elements=(6, 5, 1), size=(6e-5, 5e-5, 1e-5)))
scene = dd_macro.Projection(
    operator,
    metric,
    [dd_macro.Displacement("bottom"), dd_macro.Displacement("top", (1e-6, 2e-6, 0.0))],
    [dd_macro.Traction("right", (5.0, 0.0, 0.0))],
)
result = dd_macro.solve(scene, dd_macro.MaterialSearch(data, metric))
dd_macro.write_quadrature(sys.argv[1] + "-small.h5", operator, result, stress_measure="cauchy")
pull = scene.reaction(result.mechanical, "top")
if comm.rank == 0:
    print(result.iterations, result.normalised_distance, *pull)
"""

FINITE = (
    SOLVE.replace("StrainOperator", "GradientOperator")
    .replace("Projection", "FiniteProjection")
    .replace("cauchy", "first_piola")
    .replace("operator, result,", "operator, dd_macro.in_space(result),")
    .replace("-small", "-finite")
)

VOXELS = """
import sys
import dd_macro
import numpy as np
from mpi4py import MPI

places = np.stack(np.unravel_index(np.arange(120), (6, 5, 4)), axis=1)
places = places[(places > 0).any(axis=1) & ((places < (3, 3, 2)).any(axis=1))]
core = np.flatnonzero((places[:, 0] > 3) & (places[:, 1] > 1))
mesh = dd_macro.voxel_mesh(MPI.COMM_WORLD, places, edge=2e-5, regions={"core": core})
operator = dd_macro.StrainOperator(mesh)
held = [dd_macro.Displacement("bottom"), dd_macro.Displacement("right", (1e-6,), (0,))]
loads = [dd_macro.Traction("surface", (3.0, 2.0, 1.0))]
law = dd_macro.LinearLaw(dd_macro.isotropic(young=1e3, poisson=0.3).C, np.zeros(6))
result = dd_macro.solve_law(operator, law, held, loads)
cells = mesh.regions["core"]
strain = result.mechanical.strain.reshape(mesh.owned_cells, -1, 6).mean(axis=1)[cells[cells < mesh.owned_cells]]
core = mesh.comm.allreduce(strain.sum(axis=0))
if mesh.comm.rank == 0:
    print(*core)
"""

FAIL = """
import sys
import dd_macro
from mpi4py import MPI
from dd_macro.parallel import in_turn
from tsg_micro.data.errors import InputError

comm = MPI.COMM_WORLD

def disk_full():
    if comm.rank == 1:
        raise OSError("disk full")

errors = 0
for action in (
    lambda: dd_macro.read_msh("none.msh", comm),
    lambda: in_turn(comm, disk_full),
    lambda: dd_macro.box(comm, elements=(2, 2, 1), size=(1, 1, 1)).facets("east"),
):
    try:
        action()
    except InputError:
        errors += 1
if comm.allreduce(errors) == 3 * comm.size and comm.rank == 0:
    print("all ranks told")
"""


ENVIRONMENT = {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}


@pytest.fixture
def run(mpirun):
    def start(ranks, script, *arguments):
        done = mpirun(ranks, sys.executable, "-c", script, *arguments, env=ENVIRONMENT)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return start


def test_same_answer_on_1_2_and_3_ranks(run, tmp_path):
    """Small strain, finite strain, and voxels with regions, in one run: most of its time is to start."""
    found = {}
    for ranks in (1, 2, 3):
        lines = run(ranks, SOLVE + FINITE + VOXELS, tmp_path / str(ranks)).splitlines()[-3:]
        found[ranks] = [np.array(line.split(), dtype=float) for line in lines]
    for k, name in enumerate(("small", "finite")):
        first, fields = found[1][k], read_quadrature(tmp_path / f"1-{name}.h5")
        assert first[0] > 3  # an iteration, not a lucky start
        for ranks in (2, 3):
            other, read = found[ranks][k], read_quadrature(tmp_path / f"{ranks}-{name}.h5")
            np.testing.assert_allclose(other, first, rtol=1e-8, atol=1e-8 * np.abs(first[2:]).max())
            np.testing.assert_array_equal(read.datum, fields.datum)
            np.testing.assert_array_equal(read.corners, fields.corners)
            scale = np.abs(fields.mechanical_stress).max()
            np.testing.assert_allclose(read.mechanical_stress, fields.mechanical_stress, atol=1e-9 * scale)
            np.testing.assert_allclose(read.local_distance, fields.local_distance, rtol=1e-6, atol=1e-9)
    core = found[1][2]
    assert np.abs(core).max() > 1e-3
    for ranks in (2, 3):
        np.testing.assert_allclose(found[ranks][2], core, atol=1e-8 * np.abs(core).max(), rtol=0)


def test_an_error_on_one_rank_is_raised_on_all(run):
    assert "all ranks told" in run(3, FAIL)


def test_no_compiler_is_one_clear_line(tmp_path):
    script = """
import dd_macro
from mpi4py import MPI
try:
    operator = dd_macro.StrainOperator(dd_macro.box(MPI.COMM_WORLD, elements=(1, 1, 1), size=(1, 1, 1)))
    operator.stiffness(dd_macro.isotropic(young=1.0, poisson=0.3).C)
except dd_macro.KernelError as error:
    print(error)
"""
    env = {**os.environ, "CC": "/nonexistent/cc", "XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", script], env=env, capture_output=True, text=True, timeout=120)
    lines = done.stdout.strip().splitlines()
    assert "they need a working C compiler" in lines[-1]
