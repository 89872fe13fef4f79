"""Equilibrium: balance, independence of the path's division, force against displacement control, and bad input."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tsg_micro.cells.lattice import side_nodes
from tsg_micro.cells.structure import from_arrays
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.equilibrium.load_path import EquilibriumSolver
from tsg_micro.equilibrium.newton import Iteration, NewtonOptions

TIGHT = NewtonOptions(tolerance=1e-12)


@pytest.fixture
def indented(box):
    """A cell on four fixed nodes, its solver, and 3 nN downwards on the four nodes of its top."""

    def make(bar_force, options=None):
        structure = box(1, 1, 1, bar_force=bar_force)
        top = side_nodes(structure, 2, end="high")
        fixed = np.zeros(structure.nodes.shape, dtype=bool)
        fixed[side_nodes(structure, 2, end="low")] = True
        force = np.zeros(structure.nodes.shape)
        force[top, 2] = -3e-9 / len(top)
        return EquilibriumSolver(structure, fixed=fixed, options=options), force, top, fixed

    return make


@pytest.fixture
def stretched(box, clamped):
    """A small sheet clamped at both ends across y, and the displacements of a stretch of 5 % with some shear."""
    structure = box(2, 4, 2)
    fixed, high = clamped(structure, 1)
    u = np.zeros(structure.nodes.shape)
    u[high] = [0.02 * structure.size[1], 0.05 * structure.size[1], 0.0]
    return structure, fixed, u


@pytest.mark.parametrize(("bar_force", "low", "high"), [(1e-9, 1.0e-6, 1.4e-6), (50e-9, 0.0, 0.2e-6)])
def test_indentation_of_a_cell(indented, bar_force, low, high):
    """model.md: about 1.2 um at f_b = 1 nN, less than 0.2 um at 50 nN."""
    solver, force, top, _ = indented(bar_force)
    result = solver.solve(force=force, stable=True)
    sinks = -result.displacement[top, 2]
    assert low < sinks.mean() < high
    np.testing.assert_allclose(sinks, sinks.mean(), rtol=1e-8)  # the four-fold axis stays
    assert result.negative_pivots == 0


def test_indentation_stiffens(indented):
    solver, force, top, _ = indented(1e-9)
    depth = np.array([-solver.solve(force=load * force).displacement[top, 2].mean() for load in np.linspace(0, 1, 7)])
    assert depth[0] == pytest.approx(0.0, abs=1e-15)
    assert (np.diff(depth, n=2) < 0.0).all()


def test_forces_balance(indented):
    solver, force, _, fixed = indented(1e-9)
    result = solver.solve(force=force)
    assert result.residual <= 1e-10
    np.testing.assert_allclose(result.reaction.sum(axis=0), -force.sum(axis=0), atol=1e-9 * 3e-9)
    position = solver.structure.nodes + result.displacement
    moment = np.cross(position, result.reaction + force).sum(axis=0)
    assert np.abs(moment).max() < 1e-8 * 3e-9 * 1e-5
    assert np.abs(result.reaction[~fixed]).max() < 1e-10 * np.abs(result.members.force).mean()


def test_displacement_control_meets_force_control(indented, box):
    solver, force, top, fixed = indented(1e-9, TIGHT)
    pushed = solver.solve(force=force)
    fixed = fixed.copy()
    fixed[top, 2] = True
    moved = EquilibriumSolver(solver.structure, fixed=fixed, options=TIGHT).solve(
        displacement=np.where(fixed, pushed.displacement, 0.0)
    )
    np.testing.assert_allclose(moved.reaction[top], force[top], atol=1e-9 * 3e-9)
    np.testing.assert_allclose(moved.displacement, pushed.displacement, atol=1e-9 * 1e-6)
    assert moved.energy == pytest.approx(pushed.energy, rel=1e-10)


@pytest.mark.parametrize("backend", ["superlu", "auto"])
def test_result_does_not_depend_on_the_number_of_steps(stretched, backend):
    structure, fixed, u = stretched
    options = NewtonOptions(tolerance=1e-12, linear_solver=backend)
    results = [
        EquilibriumSolver(structure, fixed=fixed, options=options).solve(displacement=u, steps=steps, stable=True)
        for steps in (1, 3, 8)
    ]
    first = results[0]
    for other in results[1:]:
        assert other.load_steps != first.load_steps
        np.testing.assert_allclose(other.displacement, first.displacement, atol=1e-9 * np.abs(u).max())
        np.testing.assert_allclose(other.members.force, first.members.force, atol=1e-9 * first.members.force.max())
    np.testing.assert_array_equal(first.displacement[fixed], u[fixed])
    assert first.negative_pivots == 0
    assert first.factorisations >= first.iterations > 0


def test_return_to_the_reference(stretched):
    structure, fixed, u = stretched
    solver = EquilibriumSolver(structure, fixed=fixed)
    loaded = solver.solve(displacement=u)
    back = solver.solve(displacement=0.0 * u)
    assert np.abs(back.displacement).max() < 1e-7 * np.abs(u).max()
    assert back.energy < loaded.energy
    solver.move_to(np.append(loaded.displacement.ravel(), np.zeros(9)), solver.force)
    assert solver.solve().iterations == 0  # it is still an equilibrium


def test_reaction_is_the_derivative_of_the_energy(stretched):
    structure, fixed, u = stretched
    solver = EquilibriumSolver(structure, fixed=fixed, options=TIGHT)
    here = solver.solve(displacement=u)
    for direction in np.eye(3):
        step = np.where(u.any(axis=1)[:, None], 1e-4 * np.abs(u).max() * direction, 0.0)
        energy = [solver.solve(displacement=u + sign * step).energy for sign in (1.0, -1.0)]
        work = float((here.reaction * step).sum())
        scale = np.abs(here.members.force).max() * np.abs(step).max()
        assert (energy[0] - energy[1]) / 2.0 == pytest.approx(work, rel=1e-6, abs=1e-6 * scale)


def test_failure_keeps_the_last_equilibrium(stretched):
    structure, fixed, u = stretched
    solver = EquilibriumSolver(structure, fixed=fixed, options=NewtonOptions(max_iterations=1))
    with pytest.raises(ConvergenceError, match=r"stopped at .* of the load, .*after 1 iterations") as caught:
        solver.solve(displacement=5.0 * u)
    assert len(caught.value.history) > 5
    assert all(isinstance(record, Iteration) and record.residual > 1e-10 for record in caught.value.history)
    free = ~fixed.ravel()
    state = solver.system.state(solver.y)
    balance = (solver.system.gradient(state)[:-9] - solver.force)[free]
    assert np.abs(balance).max() <= 1e-10 * np.abs(state.force).mean()
    patient = EquilibriumSolver(structure, fixed=fixed)
    patient.move_to(solver.y, solver.force)
    assert patient.solve().iterations == 0


def test_progress_and_history(stretched):
    structure, fixed, u = stretched
    seen: list[float] = []
    result = EquilibriumSolver(structure, fixed=fixed).solve(displacement=u, steps=4, progress=seen.append)
    assert len(seen) == result.load_steps
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)
    assert len(result.history) == result.iterations
    assert result.negative_pivots is None
    assert result.solver.reason


def test_slack_tendons(box, clamped):
    """A block compressed by a tenth: with slack no tendon pushes, without it some do."""
    structure = box(2, 4, 2, bar_force=1e-9)
    fixed, high = clamped(structure, 1)
    u = np.zeros(structure.nodes.shape)
    u[high, 1] = -0.1 * structure.size[1]
    stiff, slack = (
        EquilibriumSolver(structure, fixed=fixed, slack=slack).solve(displacement=u) for slack in (False, True)
    )
    tendons = ~structure.bars
    assert stiff.members.force[tendons].min() < -1e-9
    assert stiff.slack == 0
    assert slack.members.force[tendons].min() == 0.0
    assert slack.slack == (slack.members.force[tendons] == 0.0).sum() > 0
    assert slack.energy < stiff.energy
    np.testing.assert_allclose(slack.reaction.sum(axis=0), 0.0, atol=1e-9 * np.abs(slack.reaction).max())


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"displacement": np.zeros(3)}, r"displacement: expected finite numbers of shape \(24, 3\), got shape \(3,\)"),
        ({"force": np.full((24, 3), np.nan)}, "force: expected finite numbers"),
        ({"H": np.zeros((2, 2))}, r"H: expected finite numbers of shape \(3, 3\)"),
        ({"H": -2.0 * np.eye(3)}, r"H: expected det\(1 \+ H\) > 0"),
    ],
)
def test_bad_loads(indented, arguments, text):
    with pytest.raises(InputError, match=text):
        indented(1e-9)[0].solve(**arguments)


def test_bad_supports(box):
    structure = box(1, 1, 1)
    for fixed, text in (
        (np.zeros((1, 3), dtype=bool), "fixed: expected shape"),
        (np.zeros((24, 3), dtype=bool), "some displacements to be prescribed"),
        (np.ones((24, 3), dtype=bool), "and some to be free"),
    ):
        with pytest.raises(InputError, match=text):
            EquilibriumSolver(structure, fixed=fixed)


@pytest.mark.parametrize("name", ["tolerance", "max_iterations", "max_elongation"])
@pytest.mark.parametrize("value", [0, -1, np.nan])
def test_bad_options(name, value):
    with pytest.raises(InputError, match=f"{name}: expected a positive number"):
        NewtonOptions(**{name: value})


@dataclass(frozen=True)
class Softening:
    """t = EA e exp(-k e), e = l / l0 - 1: the force is largest at e = 1 / k."""

    k: float = 5.0

    def energy(self, length, rest_length, members):
        e = length / rest_length - 1.0
        return float(np.sum(members.EA * rest_length * (1.0 - (1.0 + self.k * e) * np.exp(-self.k * e))) / self.k**2)

    def force(self, length, rest_length, members):
        e = length / rest_length - 1.0
        return members.EA * e * np.exp(-self.k * e)

    def stiffness(self, length, rest_length, members):
        e = length / rest_length - 1.0
        return members.EA / rest_length * (1.0 - self.k * e) * np.exp(-self.k * e)

    def rest_length(self, length, force, members):
        return length * np.ones_like(force)


def hanging(law, *, angle=0.0):
    """A node that may move along x, on a member of length 1 and EA 1 that holds it, its direction turned by angle."""
    nodes = np.array([[-np.cos(angle), np.sin(angle), 0.0], [0.0, 0.0, 0.0]])
    one = np.ones(1)
    structure = from_arrays(nodes, np.array([[0, 1]]), kind=np.array([1], dtype=np.uint8), EA=one, rest_length=one)
    fixed = np.ones((2, 3), dtype=bool)
    fixed[1, 0] = False
    return replace(structure, law=law, size=np.ones(3)), fixed


@pytest.mark.parametrize("times", [1.1, 3.0])
@pytest.mark.parametrize("k", [2.0, 5.0])
def test_a_lost_equilibrium_at_a_limit_point_says_so(k, times):
    """The member bears 1 / (k e) N at most; the fraction of the load at which the path turns back is that."""
    structure, fixed = hanging(Softening(k))
    largest = np.exp(-1.0) / k
    force = np.zeros((2, 3))
    force[1, 0] = times * largest
    solver = EquilibriumSolver(structure, fixed=fixed, options=NewtonOptions(max_iterations=15))
    with pytest.raises(ConvergenceError) as caught:
        solver.solve(force=force, stable=True)
    (shown,) = re.findall(r"the path turns back at ([\d.]+)%, a limit point", str(caught.value))
    found = float(shown)
    assert found == pytest.approx(100.0 / times, rel=0.02)
    assert found <= 100.0 / times + 0.01
    reached = solver.solve()  # it stays at its last equilibrium, below the limit
    assert reached.members.force[0] == pytest.approx(solver.force[3], rel=1e-8)
    assert 0.9 * largest < reached.members.force[0] <= largest


def test_what_is_lost_otherwise_is_no_limit_point():
    structure, fixed = hanging(Softening(), angle=0.3)
    solver = EquilibriumSolver(structure, fixed=fixed, options=NewtonOptions(max_iterations=1, smallest_part=0.9))
    force = np.zeros((2, 3))
    force[1, 0] = 0.03
    with pytest.raises(ConvergenceError, match="no limit point was found"):
        solver.solve(force=force)
