"""Instability with a closed form: snap-through, and buckling of a column that is held by springs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.optimize import brentq

from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.structure import from_arrays
from tsg_micro.cells.unit_cell import BAR, EDGE_TENDON
from tsg_micro.continuum.rve import build_rve
from tsg_micro.equilibrium.load_path import EquilibriumSolver
from tsg_micro.equilibrium.newton import NewtonOptions

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
    fixed[2] = [False, True, True]  # sideways the apex is free, and stays in the middle
    solver = EquilibriumSolver(structure, fixed=fixed, options=TIGHT)
    for w in (0.2, 0.1, 0.01, -0.2, -0.4):
        u = np.zeros((3, 3))
        u[2, 2] = w - RISE
        result = solver.solve(displacement=u)
        assert -result.reaction[2, 2] == pytest.approx(push(w), rel=1e-9)
        assert abs(result.displacement[2, 0]) < 1e-12


SPRING, ANCHOR = 1e-5, 5.0


@pytest.fixture
def column():
    """Two bars in line along x, their joint held by springs along y and stiffer ones along z; both ends prescribed."""
    anchors = ANCHOR * np.array([[0.0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    nodes = np.concatenate([np.array([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]]), anchors])
    structure = from_arrays(
        nodes,
        np.array([[0, 1], [1, 2], [1, 3], [1, 4], [1, 5], [1, 6]]),
        kind=np.array([BAR, BAR] + [EDGE_TENDON] * 4, dtype=np.uint8),
        EA=np.array([EA, EA, SPRING, SPRING, 2.0 * SPRING, 2.0 * SPRING]),
        rest_length=np.array([1.0, 1.0] + [ANCHOR] * 4),
    )
    fixed = np.ones((7, 3), dtype=bool)
    fixed[1] = False
    return structure, fixed


def shortened(d):
    """Both ends moved inwards by d."""
    u = np.zeros((7, 3))
    u[0, 0], u[2, 0] = d, -d
    return u


def critical_shortening(spring):
    """d at which the springs' 2 EA_s / l_s meets the bars' -2 q = 2 EA d / (1 - d)."""
    ratio = spring / (ANCHOR * EA)
    return ratio / (1.0 + ratio)


@pytest.mark.parametrize(
    ("d", "unstable"),
    [
        (0.999 * critical_shortening(SPRING), 0),
        (1.001 * critical_shortening(SPRING), 1),
        (0.999 * critical_shortening(2.0 * SPRING), 1),
        (1.001 * critical_shortening(2.0 * SPRING), 2),
    ],
)
def test_inertia_counts_the_unstable_directions(column, d, unstable):
    structure, fixed = column
    solver = EquilibriumSolver(structure, fixed=fixed, options=TIGHT)
    solver.move_to(np.append(shortened(d).ravel(), np.zeros(9)), solver.force)
    assert solver.solve().iterations == 0  # straight, and in equilibrium
    assert solver.tangent().negative_pivots == unstable


@pytest.mark.parametrize("times", [1.2, 3.0])
def test_column_leaves_its_straight_branch_for_a_stable_one(column, times):
    """Once or twice unstable, it buckles along the softer springs, to the state that one equation describes."""
    structure, fixed = column
    d = times * critical_shortening(SPRING)
    solver = EquilibriumSolver(structure, fixed=fixed, options=TIGHT)
    solver.move_to(np.append(shortened(d).ravel(), np.zeros(9)), solver.force)
    straight = solver.solve()
    assert solver.tangent().negative_pivots == (1 if times < 2.0 else 2)
    buckled = solver.solve(stable=True)
    assert buckled.negative_pivots == 0
    assert buckled.residual <= 1e-12
    assert buckled.energy < straight.energy
    assert max(record.negative_pivots for record in buckled.history) > 0

    def sideways(w):
        bar, cross = np.hypot(1.0 - d, w), np.hypot(ANCHOR, w)  # the springs along z are stretched too
        return EA * (1.0 - 1.0 / bar) + SPRING / ANCHOR + 2.0 * SPRING * (1.0 / ANCHOR - 1.0 / cross)

    w = brentq(sideways, 1e-6, 0.5)
    assert abs(buckled.displacement[1, 1]) == pytest.approx(w, rel=1e-9)
    np.testing.assert_allclose(buckled.displacement[1, [0, 2]], 0.0, atol=1e-9)


def test_loading_past_the_critical_point_ends_stable(column):
    structure, fixed = column
    u = shortened(3.0 * critical_shortening(SPRING))
    results = [
        EquilibriumSolver(structure, fixed=fixed, options=TIGHT).solve(displacement=u, stable=True, steps=steps)
        for steps in (1, 5)
    ]
    for result in results:
        assert result.negative_pivots == 0
        assert result.energy == pytest.approx(results[0].energy, rel=1e-9)


def test_sheet_of_cells_compressed_past_its_buckling(box, clamped):
    """On the way the tangent was indefinite, at the end it is not."""
    structure = box(2, 12, 1, bar_force=1e-7)
    fixed, high = clamped(structure, 1)
    u = np.zeros(structure.nodes.shape)
    u[high, 1] = -0.2 * structure.size[1]
    result = EquilibriumSolver(structure, fixed=fixed).solve(displacement=u, stable=True)
    assert max(record.negative_pivots for record in result.history) > 0
    assert result.negative_pivots == 0
    assert result.residual <= 1e-10


def test_a_slender_column_of_cells_buckles_and_is_followed(short_column):
    """Sixteen cells in a row, clamped and shortened by 6 %: past the bifurcation at 4.5 %, on to a stable state."""
    structure, fixed, u = short_column
    result = EquilibriumSolver(structure, fixed=fixed).solve(displacement=u, steps=4, stable=True)
    assert result.negative_pivots == 0
    assert max(iteration.negative_pivots for iteration in result.history) > 0
    sideways = result.displacement[:, [0, 2]]
    # a clamped column, shortened by D beyond its critical load, bows out by (2 / pi) sqrt(D L)
    bow = 2.0 / np.pi * np.sqrt(0.015) * structure.size[1]
    assert np.linalg.norm(sideways, axis=1).max() == pytest.approx(bow, rel=0.2)


@pytest.mark.parametrize(
    ("bar_force", "half_diagonal", "E_bar", "strain"),
    [
        (3.024e-10, 0.5708, 2.1424e5, (0.01418, 0.0008065, 0.05044)),
        (1.0389e-11, 0.6320, 1.7030e5, (0.04635, 0.04053, -0.01334)),
        (4.168e-11, 0.7972, 1.42496e6, (0.12803, -0.06932, 0.00372)),
    ],
)
def test_soft_cells_under_little_force_are_not_called_unstable(bar_force, half_diagonal, E_bar, strain):
    """Eigenvalues of the constrained tangent, by dense algebra, are positive, and the count of pivots agrees."""
    cell = CellParameters(half_diagonal=half_diagonal, E_bar=E_bar)
    rve = build_rve(cell, bar_force=bar_force)
    xx, yy, xy = strain
    state = rve.solve_strain([xx, yy, 0, 0, 0, xy]).equilibrium
    newton, m = rve.solver.newton, rve.solver.system.nodal_size
    unknowns = np.zeros((rve.solver.system.size, len(newton.free) + newton.border.macro.shape[1]))
    unknowns[newton.free, np.arange(len(newton.free))] = 1.0
    unknowns[m:, len(newton.free) :] = newton.border.macro / rve.structure.size.max()
    kept = unknowns @ null_space(newton.border.constraint @ unknowns)
    tangent = kept.T @ rve.solver.system.tangent_product(state.members, kept)
    assert np.linalg.eigvalsh(tangent).min() > 0.0
    assert state.negative_pivots == 0
