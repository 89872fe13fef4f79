"""FE2: the RVE as a law, Newton's method with it, and the command."""

from __future__ import annotations

import itertools
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve import build_rve
from tsg_micro.continuum.rve_law import FOLLOW, RVELaw, leaders, solution_tree
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import to_mandel
from workflows.runs.fe2 import fe2
from workflows.runs.scene import Scene

ROOT = Path(__file__).parents[3]
F_B = 1e-8
STATE = np.array([-0.015, 0.05, -0.01, 0.004, -0.006, 0.02])
"""A strain with all six components."""


@pytest.fixture(scope="module")
def rve():
    return build_rve(bar_force=F_B, free=())


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def law(rve):
    return RVELaw(rve)


def cold(strain):
    """Stress and tangent of an RVE that comes from its reference state."""
    state = build_rve(bar_force=F_B, free=()).solve_strain(strain)
    return to_mandel(state.first_piola), state.tangent


def test_the_law_is_the_rve_warm_or_cold(law, rng):
    strain = STATE + 0.01 * rng.standard_normal((6, 6))
    for scale in (0.4, 1.0, 1.05):  # from point to point, and from state to state
        stress, tangent = law.stress_and_tangent(scale * strain)
        for i in (0, 5):
            expected = cold(scale * strain[i])
            np.testing.assert_allclose(stress[i], expected[0], atol=1e-9 * np.abs(expected[0]).max())
            np.testing.assert_allclose(tangent[i], expected[1], atol=1e-9 * np.abs(expected[1]).max())
    assert law.effort.solves == 18
    assert law.unstable == 0


def test_the_tangent_is_the_derivative_of_the_stress(law):
    step = 1e-4
    around = np.concatenate([STATE + step * np.eye(6), STATE - step * np.eye(6)])
    stress, _ = law.stress_and_tangent(around)
    _, (tangent,) = law.stress_and_tangent(STATE[None])
    np.testing.assert_array_equal(tangent, tangent.T)
    differences = (stress[:6] - stress[6:]) / (2 * step)
    np.testing.assert_allclose(differences, tangent, atol=1e-5 * np.abs(tangent).max())


def test_without_stress_across_the_sheet_it_is_the_material_data(law):
    datum = build_rve(bar_force=F_B).solve_strain([-0.01, 0.05, 0.0, 0.0, 0.0, 0.02])  # as `tsgdd sample` makes them
    assert abs(datum.strain[2]) > 0.01
    stress, tangent = law.stress_and_tangent(datum.strain[None])
    scale = np.abs(stress).max()
    np.testing.assert_allclose(stress[0], to_mandel(datum.first_piola), atol=1e-9 * scale)
    assert np.abs(stress[0, 2:5]).max() < 1e-9 * scale
    assert datum.tangent is not None
    np.testing.assert_allclose(tangent[0], datum.tangent, atol=1e-9 * np.abs(tangent).max())


def test_near_states_follow_the_tangent_without_an_error_that_counts(law):
    law.stress_and_tangent(STATE[None])
    near = STATE + 0.9e-7 * np.eye(6)[1]
    stress, _ = law.stress_and_tangent(near[None])
    assert law.effort.solves == 1
    expected, _ = cold(near)
    assert np.abs(stress[0] - expected).max() < 1e-10 * np.abs(expected).max()
    law.stress_and_tangent(STATE[None] + 1e-6)
    assert law.effort.solves == 2


def test_points_of_one_strain_are_solved_once(law):
    stress, tangent = law.stress_and_tangent(np.tile(STATE, (7, 1)))
    assert law.effort.solves == 1
    assert (stress == stress[0]).all()
    assert (tangent == tangent[0]).all()


def test_an_rve_that_fails_says_where_and_the_law_goes_on(law):
    expected, _ = law.stress_and_tangent(STATE[None])
    with pytest.raises(ConvergenceError, match="RVE at strain"):
        law.stress_and_tangent(np.array([[-1.5, 0.0, 0.0, 0.0, 0.0, 0.0]]))  # inside out
    stress, _ = law.stress_and_tangent(STATE[None])
    np.testing.assert_array_equal(stress, expected)


def test_the_tree_has_the_shortest_jumps(rng):
    """Against Prim's algorithm on the complete graph; every point comes after its parent."""
    along = np.sort(rng.uniform(0.02, 0.1, 40))  # beyond a gap: the first comes from its old state, the rest in a chain
    strain = along[:, None] * STATE / np.linalg.norm(STATE)
    order, parent = solution_tree(strain, np.zeros_like(strain))
    np.testing.assert_array_equal(np.sort(order), np.arange(40))
    np.testing.assert_array_equal(order, np.arange(40))
    np.testing.assert_array_equal(parent, np.arange(40) - 1)
    cloud, previous = rng.standard_normal((2, 30, 6))
    previous = cloud + 1.5 * previous
    order, parent = solution_tree(cloud, previous)
    place = np.empty(30, dtype=int)
    place[order] = np.arange(30)
    children = parent >= 0
    assert (place[parent[children]] < place[children]).all()
    found = np.linalg.norm(cloud - np.where(children[:, None], cloud[parent], previous), axis=1).sum()
    own = np.linalg.norm(cloud - previous, axis=1)
    best, least = own.copy(), 0.0
    for _ in range(30):
        k = int(best.argmin())
        least += best[k]
        best = np.minimum(best, np.linalg.norm(cloud - cloud[k], axis=1))
        own[k] = best[k] = np.inf
        best[np.isinf(own)] = np.inf
    assert least <= found <= 1.02 * least  # the tree knows six neighbours of every point
    assert [len(a) for a in solution_tree(cloud[:0], previous[:0])] == [0, 0]
    assert [list(a) for a in solution_tree(cloud[:1], previous[:1])] == [[0], [-1]]


def test_leaders_lead_themselves_and_all_that_are_near(rng):
    strain = rng.standard_normal((60, 6))
    radius = rng.uniform(0.5, 3.0, 60)
    leader = leaders(strain, radius)
    np.testing.assert_array_equal(leader[leader], leader)
    assert (np.linalg.norm(strain - strain[leader], axis=1) <= radius).all()
    assert 1 < len(set(leader)) < 40
    np.testing.assert_array_equal(leaders(strain, np.zeros(60)), np.arange(60))
    assert [list(leaders(strain[:n], radius[:n])) for n in (0, 1)] == [[], [0]]


def test_following_leaves_hundredths_of_the_linearisation(rve, rng):
    """Of a jump by j the tangent leaves an error that goes with j squared; following, one with (j / 10) squared."""
    jump = STATE + 0.003 * rng.standard_normal((40, 6))
    exact, followed = RVELaw(rve), RVELaw(rve, follow=FOLLOW)
    start, tangent = exact.stress_and_tangent(np.zeros((40, 6)))
    stress, _ = exact.stress_and_tangent(jump)
    followed.stress_and_tangent(np.zeros((40, 6)))
    near, _ = followed.stress_and_tangent(jump)
    left = np.abs(start + np.einsum("nij,nj->ni", tangent, jump) - stress).max()
    assert 0.0 < np.abs(near - stress).max() < 10.0 * FOLLOW**2 * left
    assert followed.effort.solves < 30
    with pytest.raises(InputError, match="follow: expected a number from 0 to less than 1, got 1"):
        RVELaw(rve, follow=1)


def test_newton_that_follows_comes_to_the_same(rve):
    problem = Scene("stretch", 0.05, elements=(6, 4, 1), element="trilinear", edges=False).problem(MPI.COMM_SELF)
    laws = RVELaw(rve), RVELaw(rve, follow=FOLLOW)
    exact, followed = (dd.equilibrium(problem, law) for law in laws)
    assert laws[1].effort.solves < laws[0].effort.solves
    for name in ("strain", "stress"):
        expected, found = (getattr(result.mechanical, name) for result in (exact, followed))
        np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


def test_patch_a_homogeneous_strain_gives_the_stress_of_one_rve(law):
    operator = dd.StrainOperator(dd.box(MPI.COMM_SELF, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
    H = np.array([[-0.01, 0.01, 0.003], [0.01, 0.05, -0.004], [0.003, -0.004, -0.02]])
    sides = [dd.Displacement(side, lambda x: x @ H.T) for side in dd.SIDES]
    result = dd.solve_law(operator, law, sides)
    stress, _ = cold(to_mandel(H))
    np.testing.assert_allclose(result.mechanical.stress, np.tile(stress, (32, 1)), atol=1e-8 * np.abs(stress).max())
    assert law.effort.solves < 32  # many of these points have one strain


def test_newton_converges_quadratically(law):
    scene = Scene("shear", 0.06, elements=(3, 2, 1), element="trilinear", edges=False)
    problem = scene.problem(MPI.COMM_SELF)
    result = dd.equilibrium(problem, law, steps=2, options=dd.ReferenceOptions(tolerance=1e-10))
    assert result.load_steps == 2
    assert all(it.step == 1.0 for it in result.history)
    for load in (0.5, 1.0):
        residuals = [it.residual for it in result.history if it.load == load]
        assert len(residuals) <= 5
        assert residuals[-1] < 1e-10
        for before, after in itertools.pairwise(residuals):
            assert after < max(2.0 * before**2, 1e-10)
    forces = result.reactions["top"] + result.reactions["bottom"]
    assert np.abs(forces).max() < 1e-9 * np.abs(result.reactions["top"]).max()


def test_load_steps_and_ranks_do_not_change_the_answer(mpirun, read_summary, tmp_path):
    scene = Scene("stretch", 0.05, elements=(3, 2, 1), element="trilinear", edges=False)
    summary = fe2(tmp_path / "one", scene=scene, tissue=Tissue(bar_force=F_B), plots=False)
    plain = ("--element", "trilinear", "--no-edges", "--no-plots")
    arguments = ("fe2", "--elements", 3, 2, 1, *plain, "--steps", 2, "--out", tmp_path / "two")
    env = {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = mpirun(2, sys.executable, "-c", "from workflows.cli import main; main()", *arguments, env=env)
    assert done.returncode == 0, done.stderr
    other = read_summary(tmp_path / "two")
    assert other["ranks"] == 2
    assert summary["iterations"] < other["iterations"]
    assert other["top_force"] == pytest.approx(summary["top_force"], rel=1e-8)
    a, b = (dd.read_quadrature(tmp_path / name / "quadrature.h5") for name in ("one", "two"))
    assert a.stress_measure == "first_piola"
    np.testing.assert_array_equal(a.material_stress, a.mechanical_stress)
    np.testing.assert_array_equal(a.corners, b.corners)
    for name in ("mechanical_strain", "mechanical_stress"):
        x, y = getattr(a, name), getattr(b, name)
        np.testing.assert_allclose(y, x, atol=1e-8 * np.abs(x).max())


def test_the_command_draws_and_can_be_compared(tsgdd, chain, read_summary, is_png, tmp_path):
    out = tmp_path / "fe2"
    done = tsgdd("fe2", "--elements", 4, 4, 1, "--no-graded", "--strain", 0.04, "--out", out)
    assert done.code == 0, done.err
    summary = read_summary(out)
    assert summary["residual"] == summary["residual_history"][-1] <= 1e-9
    assert summary["rve_solves"] <= summary["rve_states_asked"]
    assert summary["unstable_rves"] == 0
    assert is_png(out / "fields.png")
    assert is_png(out / "convergence.png")
    assert (out / "fields.vtkhdf").exists()
    done = tsgdd("compare", "--dd", out, "--dns", chain.dns, "--out", tmp_path / "compare")
    assert done.code == 0, done.err
    errors = read_summary(tmp_path / "compare")
    assert errors["error_q_mech"] == errors["error_q_mat"]
    assert 0.001 < errors["error_q_mech"]["l2"] < 0.05  # of the inner blocks, 2 x 2


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (("--steps", 0), "steps: expected at least 1, got 0"),
        (("--bar-force", -1), "bar_force: expected"),
        (("--strain", 0), "strain: expected"),
        (("--tolerance", 2), "tolerance: expected"),
        (("--elements", 0, 2, 1), "elements: expected"),
    ],
)
def test_bad_input_is_one_line(change, text, tsgdd, tmp_path):
    done = tsgdd("fe2", "--elements", 3, 2, 1, *change, "--out", tmp_path)
    assert done.code == 2
    assert len(done.err.splitlines()) == 1
    assert text in done.err


def test_compare_says_which_commands_make_its_folder(tsgdd, chain, tmp_path):
    done = tsgdd("compare", "--dd", chain.dns, "--dns", chain.dns, "--out", tmp_path)
    assert done.code == 2
    assert "made by 'tsgdd solve' or 'tsgdd fe2'" in done.err
