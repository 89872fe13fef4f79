"""Instability with a closed form: snap-through, and buckling of a column that is held by springs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from tsg_micro.equilibrium import EquilibriumSolver
from tsg_micro.newton import NewtonOptions
from tsg_micro.structure import from_arrays
from tsg_micro.unit_cell import BAR, EDGE_TENDON

TIGHT = NewtonOptions(tolerance=1e-12)
EA, RISE = 1e-3, 0.3


@pytest.fixture
def truss():
    """Von Mises truss: two bars from (-1, 0, 0) and (1, 0, 0) to an apex that moves up and down only."""
    nodes = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, RISE]])
    structure = from_arrays(
        nodes,
        np.array([[0, 2], [1, 2]]),
        kind=np.full(2, BAR, dtype=np.uint8),
        EA=np.full(2, EA),
        rest_length=np.full(2, np.hypot(1.0, RISE)),
    )
    fixed = np.ones((3, 3), dtype=bool)
    fixed[2, 2] = False
    return structure, fixed


def push(w):
    """Downward force that holds the apex at the height w."""
    l0 = np.hypot(1.0, RISE)
    return 2.0 * EA * (1.0 / np.hypot(1.0, w) - 1.0 / l0) * w


def test_truss_below_its_limit_load(truss):
    structure, fixed = truss
    limit = max(push(w) for w in np.linspace(0.0, RISE, 20001))
    top = brentq(lambda w: push(w) - 0.9 * limit, 0.19, RISE)
    force = np.zeros((3, 3))
    force[2, 2] = -0.9 * limit
    result = EquilibriumSolver(structure, fixed=fixed, options=TIGHT).solve(force=force, stable=True)
    assert RISE + result.displacement[2, 2] == pytest.approx(top, rel=1e-9)
    assert result.negative_pivots == 0


def test_truss_snaps_through_to_the_other_branch(truss):
    structure, fixed = truss
    limit = max(push(w) for w in np.linspace(0.0, RISE, 20001))
    force = np.zeros((3, 3))
    force[2, 2] = -1.2 * limit
    below = brentq(lambda w: push(w) - 1.2 * limit, -1.0, -RISE)
    result = EquilibriumSolver(structure, fixed=fixed, options=TIGHT).solve(force=force, stable=True)
    assert RISE + result.displacement[2, 2] == pytest.approx(below, rel=1e-9)
    assert result.negative_pivots == 0


def test_truss_follows_prescribed_height_through_the_unstable_branch(truss):
    structure, fixed = truss
    fixed = fixed.copy()
    fixed[2, 2], fixed[1, 0] = True, False  # something must be free: the right support, held by its own bar
    nodes = np.vstack([structure.nodes, [3.0, 0.0, 0.0]])
    held = from_arrays(
        nodes,
        np.vstack([structure.members, [1, 3]]),
        kind=np.append(structure.kind, np.uint8(EDGE_TENDON)),
        EA=np.append(structure.EA, 1e9 * EA),
        rest_length=np.append(structure.rest_length, 2.0),
    )
    solver = EquilibriumSolver(held, fixed=np.vstack([fixed, [True] * 3]), options=NewtonOptions(tolerance=1e-8))
    for w in (0.2, 0.1, 0.0, -0.2, -0.4):
        u = np.zeros((4, 3))
        u[2, 2] = w - RISE
        assert -solver.solve(displacement=u).reaction[2, 2] == pytest.approx(push(w), rel=1e-6, abs=1e-12)


@pytest.fixture
def column():
    """Two bars in a line along x, their joint held by one spring along y and a stiffer one along z."""
    nodes = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [1.0, 5, 0], [1.0, -5, 0], [1.0, 0, 5], [1.0, 0, -5]])
    structure = from_arrays(
        nodes,
        np.array([[0, 1], [1, 2], [1, 3], [1, 4], [1, 5], [1, 6]]),
        kind=np.array([BAR, BAR] + [EDGE_TENDON] * 4, dtype=np.uint8),
        EA=np.array([1e-3, 1e-3, 1e-5, 1e-5, 2e-5, 2e-5]),
        rest_length=np.array([1.0, 1.0, 5.0, 5.0, 5.0, 5.0]),
    )
    fixed = np.ones((7, 3), dtype=bool)
    fixed[1] = fixed[2, 0] = False
    fixed[2] = [False, True, True]
    return structure, fixed


def critical_load():
    """P with 2 P / l = k: the springs' 2 EA / l0 against the two bars' force density."""
    k = 2.0 * 1e-5 / 5.0
    return brentq(lambda P: 2.0 * P / (1.0 - P / 1e-3) - k, 0.0, 1e-4)


def end_load(P):
    force = np.zeros((7, 3))
    force[2, 0] = -P
    return force


@pytest.mark.parametrize("slightly", [-1e-3, 1e-3])
def test_inertia_changes_at_the_critical_load(column, slightly):
    structure, fixed = column
    solver = EquilibriumSolver(structure, fixed=fixed, options=TIGHT)
    result = solver.solve(force=end_load((1.0 + slightly) * critical_load()))
    assert np.abs(result.displacement[1, 1:]).max() == 0.0  # by symmetry it stays straight
    assert solver.tangent().negative_pivots == (slightly > 0.0)


def test_buckled_column_is_stable_and_lower_in_energy(column):
    structure, fixed = column
    force = end_load(1.02 * critical_load())
    straight = EquilibriumSolver(structure, fixed=fixed, options=TIGHT).solve(force=force)
    buckled = EquilibriumSolver(structure, fixed=fixed, options=TIGHT).solve(force=force, stable=True)
    assert buckled.negative_pivots == 0
    assert buckled.residual <= 1e-12
    assert abs(buckled.displacement[1, 1]) > 0.01  # along the softer spring
    assert abs(buckled.displacement[1, 2]) < 1e-9

    def potential(result):
        return result.energy - float((force * result.displacement).sum())

    assert potential(buckled) < potential(straight)


def test_buckled_column_under_prescribed_shortening(column):
    structure, fixed = column
    fixed = fixed.copy()
    fixed[2] = True
    u = np.zeros((7, 3))
    u[2, 0] = -0.01
    straight = EquilibriumSolver(structure, fixed=fixed, options=TIGHT).solve(displacement=u)
    buckled = EquilibriumSolver(structure, fixed=fixed, options=TIGHT).solve(displacement=u, stable=True)
    assert buckled.negative_pivots == 0
    assert buckled.energy < 0.5 * straight.energy
    # Stiff bars keep their length: the joint moves sideways until the spans add up.
    sideways = buckled.displacement[1, 1]
    bars = buckled.members.length[:2]
    np.testing.assert_allclose(bars, np.hypot(1.0 - 0.005, sideways), rtol=1e-12)
    force = np.linalg.norm(buckled.reaction[2])
    assert force == pytest.approx(critical_load(), rel=0.02)


def test_cell_leaves_its_symmetric_branch(box, clamped):
    """A stack of cells compressed far between plates: whatever branch is found, it is a stable one."""
    structure = box(1, 3, 1, bar_force=1e-9)
    fixed, high = clamped(structure, 1)
    u = np.zeros(structure.nodes.shape)
    u[high, 1] = -0.1 * structure.size[1]
    symmetric = EquilibriumSolver(structure, fixed=fixed)
    first = symmetric.solve(displacement=u)
    assert symmetric.tangent().negative_pivots > 0
    second = EquilibriumSolver(structure, fixed=fixed).solve(displacement=u, stable=True)
    assert second.negative_pivots == 0
    assert second.energy < first.energy
