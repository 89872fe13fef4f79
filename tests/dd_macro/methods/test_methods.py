"""Every method in ten lines: problem, method, solution; and what a newcomer adds, a method and a load."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.stats import qmc

import dd_macro as dd
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

ROOT = Path(__file__).parents[3]
C = dd.isotropic(young=1e3, poisson=0.3).C
DOC = (ROOT / "docs" / "CONTRIBUTING.md").read_text()
METHOD, LOAD = re.findall(r"```python\n(.*?)```", DOC, re.DOTALL)[:2]


class Stiffening:
    """W = q / 2 + q^2 / 16 with q = epsilon : C : epsilon."""

    def stress_and_tangent(self, strain):
        linear = strain @ C
        growth = 1 + 0.25 * np.einsum("ni,ni->n", strain, linear)
        tangent = growth[:, None, None] * C + 0.5 * linear[:, :, None] * linear[:, None, :]
        return growth[:, None] * linear, tangent


class LawSource:
    """The law as a source of data, which remembers what it was asked for."""

    def __init__(self):
        self.asked = 0

    def states(self, strains, origins, bar_forces=None):
        self.asked += len(strains)
        return data_at(strains)


def data_at(strain):
    stress, tangent = Stiffening().stress_and_tangent(strain)
    n = np.arange(len(strain))
    return Dataset(strain, stress, "first_piola", path=n, step=n, tangent=tangent)


def sheet(comm, theory="small", loads=()):
    """A sheet that is stretched a little aslant."""
    domain = dd.box(comm, elements=(4, 4, 1), size=(4e-5, 4e-5, 1e-5))
    clamps = [dd.Displacement("bottom"), dd.Displacement("top", (2e-7, 1e-6, 0.0))]
    return dd.Problem(dd.THEORIES[theory].operator(domain), clamps, loads)


def material():
    """Data that fill a box of all six strains evenly, the law, and the law as a source."""
    cube = qmc.Sobol(6, seed=1).random(2048) - 0.5
    strain = cube * [0.04, 0.07, 0.04, 0.02, 0.02, 0.04] + [0.0, 0.02, 0.0, 0.0, 0.0, 0.01]
    return dd.Material(data_at(strain), law=Stiffening(), source=LawSource())


@pytest.fixture(scope="module")
def expected():
    """Newton's method with the law, on all ranks."""
    return dd.solve_law(*scene_of(sheet(MPI.COMM_WORLD)), steps=2)


def scene_of(problem):
    return problem.operator, Stiffening(), problem.supports, problem.loads


# how far the pull is from that of the law: laws are exact, data as near as they are dense
EXACT, TANGENTS, ESTIMATED, POINTS = 1e-8, 0.02, 0.05, 0.1
CLOSE = {
    "classical": POINTS,
    "classical, omega 1": 0.5,
    "second order": TANGENTS,
    "second order, alternating": TANGENTS,
    "second order, estimated tangents": ESTIMATED,
    "second order, averages": ESTIMATED,
    "linear elastic law": 0.5,
    "polynomial energy law": 0.001,
    "adaptive": TANGENTS,
    "FE2": EXACT,
}


@pytest.mark.mpi
@pytest.mark.parametrize("name", dd.METHODS)
def test_the_job_in_ten_lines(name, comm, expected, folder):
    domain = dd.box(comm, elements=(4, 4, 1), size=(4e-5, 4e-5, 1e-5))
    clamps = [dd.Displacement("bottom"), dd.Displacement("top", (2e-7, 1e-6, 0.0))]
    problem = dd.Problem(dd.StrainOperator(domain), clamps)
    solution = dd.METHODS[name].prepare(problem, material()).solve()
    dd.write_solution(folder, solution, stress_measure="first_piola")
    pull = solution.reaction("top")

    exact = expected.reaction("top")
    assert np.linalg.norm(pull - exact) < CLOSE[name] * np.linalg.norm(exact)
    np.testing.assert_allclose(solution.reaction("bottom"), -pull, atol=1e-8 * np.abs(pull).max())
    assert problem.residual(solution.mechanical.nominal_stress) < 1e-8
    fields = dd.read_quadrature(folder / "quadrature.h5")
    assert fields.mechanical_stress.shape == (16, 8, 6)
    figures = solution.figures()
    assert figures["iterations"][0] == solution.iterations > 0
    assert figures["quadrature_points"][0] == 128


@pytest.mark.mpi
def test_reactions_and_distances_are_those_of_the_fields(comm, expected):
    """The distance from local distances and the metric, and Newton's own reactions."""
    problem = sheet(comm)
    found = dd.METHODS["classical"].prepare(problem, material()).solve()
    w, z = problem.operator.weights, found.mechanical
    assert isinstance(found, dd.DataDrivenResult)
    assert found.metric is not None
    sizes = comm.allreduce(
        np.array([w @ found.local_distance**2, w @ (found.metric.whiten(z.strain, z.stress) ** 2).sum(axis=1)])
    )
    assert found.distance == pytest.approx(np.sqrt(sizes[0]), rel=1e-9)
    assert found.normalised_distance == pytest.approx(np.sqrt(sizes[0] / sizes[1]), rel=1e-9)
    np.testing.assert_allclose(expected.reaction("top"), expected.reactions["top"], rtol=1e-12)


@pytest.mark.mpi
def test_a_factorised_projection_serves_again(comm):
    problem, given = sheet(comm), material()
    first = dd.METHODS["classical"].prepare(problem, given)
    assert isinstance(first, dd.PreparedData)
    again = dd.METHODS["classical"].prepare(
        problem, dd.Material(given.dataset, first.projection.metric), projection=first.projection
    )
    np.testing.assert_array_equal(again.solve().mechanical.u, first.solve().mechanical.u)


@pytest.mark.mpi
def test_adaptive_asks_no_more_than_its_budget_and_gets_nearer(comm, expected):
    exact, last = expected.reaction("top"), np.inf
    for budget in (1, 8, 64):
        source = LawSource()
        kept: list[Dataset] = []
        method = dd.AdaptiveMethod(dd.Adaptation(budget, tolerance=0.0))
        watch = dd.Watch(keep=kept.append)
        found = method.prepare(sheet(comm), dd.Material(source=source)).solve(watch=watch)
        off = np.linalg.norm(found.reaction("top") - exact) / np.linalg.norm(exact)
        assert off < last
        last = off
        assert source.asked == found.rounds[-1].rves == len(found.dataset) == len(kept[-1]) <= budget
    assert last < 2e-3


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["classical", "second order", "adaptive", "polynomial energy law"])
def test_finite_strain_is_the_same_calls(name, comm):
    """The law at Biot strains is objective: Newton's method with it is the other route."""
    problem = sheet(comm, "finite")
    exact = dd.equilibrium(problem, Stiffening(), steps=2).reaction("top")
    found = dd.METHODS[name].prepare(problem, material()).solve()
    assert np.linalg.norm(found.reaction("top") - exact) < CLOSE[name] * np.linalg.norm(exact)


@pytest.mark.mpi
def test_a_method_of_a_newcomer(comm, expected):
    """The block of docs/CONTRIBUTING.md; its means of linear data are data too, and noise has less of a say."""
    try:
        exec(METHOD, {})
        assert list(dd.METHODS)[-1] == "means"
        problem, clean = sheet(comm), material()
        noise = np.random.default_rng(2).standard_normal((2048, 6))
        noisy = dd.Material(data_at(clean.data().strain + 0.002 * noise), "secant")
        exact = expected.reaction("top")
        found = dd.METHODS["means"].prepare(problem, clean).solve()
        assert np.linalg.norm(found.reaction("top") - exact) < 2 * CLOSE["classical"] * np.linalg.norm(exact)
        assert dd.METHODS["means"].prepare(problem, noisy).solve().iterations > 1
    finally:
        dd.METHODS.pop("means", None)


@pytest.mark.mpi
def test_a_load_of_a_newcomer(comm):
    """The block of docs/CONTRIBUTING.md: its force is what the supports take, in any method that knows loads."""
    names: dict[str, Any] = {}
    exec(LOAD, names)
    force = np.array([2e-8, 1e-8, 3e-9])
    load = names["NodeForce"]((4e-5, 2e-5, 0.0), tuple(force))
    still = [dd.Displacement(side) for side in ("bottom", "top")]
    operator = sheet(comm).operator
    problem = dd.Problem(operator, still, [load, dd.Traction("right", (1.0, 0.0, 0.0))])
    taken = force + np.array([4e-5 * 1e-5, 0.0, 0.0])
    for name in ("second order", "FE2"):
        found = dd.METHODS[name].prepare(problem, material()).solve()
        np.testing.assert_allclose(
            found.reaction("top") + found.reaction("bottom"), -taken, atol=1e-8 * np.abs(taken).max()
        )
        assert problem.residual(found.mechanical.nominal_stress) < 1e-8


@pytest.mark.mpi
def test_what_a_method_lacks_is_said(comm):
    problem, nothing = sheet(comm), dd.Material()
    for name in ("classical", "second order", "linear elastic law"):
        with pytest.raises(InputError, match="material: expected a data set, got none"):
            dd.METHODS[name].prepare(problem, nothing)
    with pytest.raises(InputError, match="material: expected a law, got none"):
        dd.METHODS["FE2"].prepare(problem, nothing)
    with pytest.raises(InputError, match="material: expected a source of data, got none"):
        dd.METHODS["adaptive"].prepare(problem, nothing)
    for name in ("second order", "adaptive", "FE2"):
        with pytest.raises(InputError, match=r"over_relaxation: expected none but with data as points .*, got 1\.5"):
            dd.METHODS[name].tuned(over_relaxation=1.5)
    assert dd.METHODS["classical"].tuned(over_relaxation=1.0, max_iterations=7) == dd.PointMethod(
        dd.SolverOptions(7, over_relaxation=1.0)
    )


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="one rank samples")
def test_the_page_on_python_with_every_method(capsys):
    """Its blocks on a smaller sheet with fewer data; FE2 leaves no data error."""
    first, second, third = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL)
    for there, here in (
        ("range(100)", "range(20)"),
        ("(30, 15, 1)", "(4, 4, 1)"),
        ("300e-6", "80e-6"),
        ("600e-6", "80e-6"),
    ):
        assert there in first
        first = first.replace(there, here)
    names: dict[str, Any] = {}
    exec(first + second, names)
    out = capsys.readouterr().out
    exec(third, names)
    assert float(re.findall(r": (.*)% of volume", capsys.readouterr().out)[0]) == pytest.approx(-1.7, abs=0.3)
    pulls = dict(re.findall(r"(.*): .*, pull (.*) N", out))
    assert list(pulls) == list(dd.METHODS)
    exact = float(pulls["FE2"])
    assert float(pulls["adaptive"]) == pytest.approx(exact, rel=0.02)
    for name in ("second order", "second order, alternating"):  # the box of stretch lacks what the clamps do
        assert float(pulls[name]) == pytest.approx(exact, rel=0.15)


SOLVE = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from mpi4py import MPI
from test_methods import dd, material, sheet

for name in dd.METHODS:
    pull = dd.METHODS[name].prepare(sheet(MPI.COMM_WORLD), material()).solve().reaction("top")
    if MPI.COMM_WORLD.rank == 0:
        print(*(f"{value:.17g}" for value in pull))
"""


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts mpirun itself")
def test_ranks_do_not_change_the_answer_of_any_method(mpirun):
    env = {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    pulls = []
    for ranks in (1, 2):
        done = mpirun(ranks, sys.executable, "-c", SOLVE, Path(__file__).parent, env=env)
        assert done.returncode == 0, done.stderr
        pulls.append(np.array(done.stdout.split(), dtype=float).reshape(-1, 3))
    assert len(pulls[0]) == len(dd.METHODS)
    np.testing.assert_allclose(pulls[1], pulls[0], rtol=0, atol=1e-8 * np.abs(pulls[0]).max())
