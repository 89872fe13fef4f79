"""Stiffness from the factorised tangent against differences of reactions; rotations and means of known fields."""

from __future__ import annotations

import numpy as np
import pytest

from tsg_micro.cells.lattice import side_nodes
from tsg_micro.continuum.response import cell_displacement, face_rotation, stiffness_under_load, stiffness_under_motion
from tsg_micro.equilibrium.load_path import EquilibriumSolver
from tsg_micro.equilibrium.newton import NewtonOptions

TIGHT = NewtonOptions(tolerance=1e-12)


def test_stiffness_under_motion_is_the_slope_of_the_reaction(box, clamped):
    structure = box(2, 4, 1)
    fixed, high = clamped(structure, 1)
    solver = EquilibriumSolver(structure, fixed=fixed, options=TIGHT)
    up = np.zeros(structure.nodes.shape)
    up[high, 1] = 1.0
    stretch, step = 0.1 * structure.size[1], 1e-9

    def reaction(u):
        return solver.solve(displacement=u * up).reaction[high, 1].sum()

    slope = (reaction(stretch + step) - reaction(stretch - step)) / (2 * step)
    solver.solve(displacement=stretch * up)
    assert stiffness_under_motion(solver, up) == pytest.approx(slope, rel=1e-5)
    # twice the motion, four times the second derivative
    assert stiffness_under_motion(solver, 2 * up) == pytest.approx(4 * slope, rel=1e-5)


def test_stiffness_under_load_is_the_slope_of_the_force(box):
    structure = box(1, 1, 1, bar_force=5e-9)
    top = side_nodes(structure, 2, end="high")
    fixed = np.zeros(structure.nodes.shape, dtype=bool)
    fixed[side_nodes(structure, 2, end="low")] = True
    solver = EquilibriumSolver(structure, fixed=fixed, options=TIGHT)
    down = np.zeros(structure.nodes.shape)
    down[top, 2] = -0.25

    def depth(force):
        return -solver.solve(force=force * down).displacement[top, 2].mean()

    force, step = 2e-9, 1e-13
    slope = 2 * step / (depth(force + step) - depth(force - step))
    solver.solve(force=force * down)
    stiffness = stiffness_under_load(solver, down)
    assert stiffness == pytest.approx(slope, rel=1e-4)
    assert stiffness_under_load(solver, 7.0 * down) == pytest.approx(stiffness, rel=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("end", ["low", "high"])
def test_face_rotation(box, axis, end):
    """Turned anticlockwise as seen from outside, tilted a little, stretched and moved away."""
    structure = box(1, 1, 1)
    outward = np.eye(3)[axis] * (1.0 if end == "high" else -1.0)
    angle = 0.3
    K = np.cross(outward, np.eye(3)).T  # K v = outward x v
    R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    moved = 1.2 * structure.nodes @ R.T + [1e-6, -2e-6, 3e-6]
    moved += 1e-2 * outward * (structure.nodes @ np.roll(np.eye(3)[axis], 1))[:, None]
    assert face_rotation(structure, moved - structure.nodes, axis=axis, end=end) == pytest.approx(angle, abs=1e-12)


def test_cell_displacement_of_a_linear_field(box, rng):
    structure = box(3, 2, 2)
    H = 0.1 * rng.standard_normal((3, 3))
    midpoint = (structure.cells + 0.5) * 1e-5
    np.testing.assert_allclose(cell_displacement(structure, structure.nodes @ H.T), midpoint @ H.T, atol=1e-18)
