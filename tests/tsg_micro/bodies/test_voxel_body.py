"""Bodies of blocks: forces of loads in closed form, known bodies reproduced, supports that leave rigid motions."""

from __future__ import annotations

import numpy as np
import pytest

from tsg_micro.bodies.sheet import ClampedSheet, Sheet, memory_needed
from tsg_micro.bodies.spheroid import build_spheroid, compress_spheroid
from tsg_micro.bodies.voxel_body import (
    body_forces,
    build_block_body,
    cell_faces,
    count_nodes,
    memory_of_body,
    outer_faces,
    traction_forces,
)
from tsg_micro.bodies.voxel_path import LoadedBody, VoxelLoads
from tsg_micro.cells.lattice import box_cells, side_nodes, spheroid_cells
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.homogenise import block_fields
from tsg_micro.data.errors import InputError
from tsg_micro.equilibrium.members import MemberSystem
from tsg_micro.equilibrium.rigid import free_motions, rigid_border, rigid_motions

TISSUE = Tissue()
EDGE = TISSUE.block
STAIR = np.array([[5, -2, 0], [6, -2, 0], [6, -1, 0], [6, -1, 1]])
"""Four blocks around corners, away from the origin of the lattice."""
ORIGIN = np.array([3e-5, -7e-5, 1e-5])


def body(blocks, force=1e-8, origin=None):
    return build_block_body(TISSUE, blocks, np.broadcast_to(force, len(blocks)), origin=origin)


def nothing(found):
    zero = np.zeros(found.structure.nodes.shape)
    return {"fixed": zero.astype(bool), "displacement": zero, "force": zero.copy()}


def outer(found, axis, end):
    faces = outer_faces(found.structure)
    return cell_faces(found.structure, faces[(faces[:, 1] == axis) & (faces[:, 2] == end)])


def uniform(*value):
    return lambda x: np.broadcast_to(value, x.shape)


def clamped(found, motion):
    """Bottom held, top (y) moved as one by ``motion`` (3,), m."""
    given = nothing(found)
    bottom, top = (side_nodes(found.structure, 1, end=end) for end in ("low", "high"))
    given["fixed"][bottom] = given["fixed"][top] = True
    given["displacement"][top] = motion
    return VoxelLoads(**given), top


def test_faces_lie_where_blocks_end():
    found = body(STAIR)
    rows = outer_faces(found.structure)
    assert len(rows) == 6 * 4 - 2 * 3
    faces = cell_faces(found.structure, rows)
    assert len(faces) == 4 * len(rows)
    nodes, k = found.structure.nodes, np.arange(len(faces))
    flat = nodes[faces.nodes][k[:, None], np.arange(4), faces.axis[:, None]]
    np.testing.assert_allclose(flat, faces.midpoint[k, faces.axis][:, None] * np.ones(4), atol=1e-18)
    np.testing.assert_allclose(nodes[faces.nodes].mean(axis=1), faces.midpoint, atol=1e-18)
    away = faces.midpoint - EDGE * (found.structure.blocks[faces.block] + 0.5)
    np.testing.assert_allclose((away * faces.outwards).sum(axis=1), 0.5 * EDGE)
    assert len(np.unique(faces.nodes)) == 4 * len(faces)  # no node is on two of them
    assert count_nodes(TISSUE, STAIR) == len(nodes)


def test_a_traction_has_the_resultant_and_the_moment_of_the_square():
    """A quadratic traction on faces normal to x, y and z: sums of forces and of x (x) f against Gauss on 40 x 40."""
    found = body(STAIR, origin=ORIGIN)

    def traction(x):
        x = x / EDGE
        return np.column_stack([1.0 + x[:, 0] - x[:, 2] ** 2, x[:, 1] * x[:, 2], 2.0 * x[:, 0] * x[:, 1] - 3.0])

    points, weights = np.polynomial.legendre.leggauss(40)
    for axis in range(3):
        faces = outer(found, axis, 1)
        force = traction_forces(found, faces, traction)
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        s, t = (a.ravel() * 0.25 * EDGE for a in np.meshgrid(points, points, indexing="ij"))
        x = (ORIGIN + faces.midpoint)[:, None] + np.outer(s, u) + np.outer(t, v)
        area = np.outer(weights, weights).ravel() * (0.25 * EDGE) ** 2
        value = traction(x.reshape(-1, 3)).reshape(x.shape)
        scale = np.abs(force).sum()
        np.testing.assert_allclose(force.sum(axis=0), np.einsum("g,kga->a", area, value), atol=1e-12 * scale)
        moment = np.einsum("g,kga,kgb->ab", area, x, value)
        np.testing.assert_allclose(found.position.T @ force, moment, atol=1e-12 * scale * np.abs(x).max())
    equal = traction_forces(found, outer(found, 0, 0), uniform(0.0, 0.0, 5.0))
    shares = equal[equal.any(axis=1)]
    np.testing.assert_allclose(shares, np.broadcast_to([0.0, 0.0, 5.0 * (0.5 * EDGE) ** 2 / 4.0], shares.shape))


def test_a_body_force_is_that_of_the_volume():
    found = body(STAIR, origin=ORIGIN)
    x = found.cell_midpoint
    density = np.column_stack([x[:, 1], np.ones(len(x)), x[:, 0] - x[:, 2]])
    force = body_forces(found, density)
    np.testing.assert_allclose(force.sum(axis=0), (0.5 * EDGE) ** 3 * density.sum(axis=0), rtol=1e-12)
    moment = (0.5 * EDGE) ** 3 * x.T @ density
    np.testing.assert_allclose(found.position.T @ force, moment, rtol=1e-12, atol=1e-12 * np.abs(moment).max())


def test_a_sheet_by_another_route():
    sheet = ClampedSheet(Sheet((3, 2)))
    found = body(box_cells(3, 2, 1)[::-1])  # in any order
    loads, top = clamped(found, (0.0, 0.04 * 2 * EDGE, 0.0))
    other, here = sheet.load(0.04), LoadedBody(found, loads).load(1.0)
    scale = np.abs(other.state.displacement).max()
    np.testing.assert_allclose(here.displacement, other.state.displacement, atol=1e-12 * scale)
    assert here.reaction[top, 1].sum() / sheet.area == pytest.approx(other.nominal_stress, rel=1e-10)


@pytest.mark.parametrize(("axis", "strain", "stress"), [(1, -0.03, -32.91), (0, 0.05, 79.07)])
def test_cube_between_clamps(axis, strain, stress):
    """Figures of 2 x 2 x 2 blocks at 10 nN that were found with another program."""
    found = body(box_cells(2, 2, 2))
    loads, top = clamped(found, 2 * EDGE * strain * np.eye(3)[axis])
    state = LoadedBody(found, loads).load(1.0)
    assert state.reaction[top, axis].sum() / (2 * EDGE) ** 2 == pytest.approx(stress, abs=0.005)
    assert (state.negative_pivots, state.residual < 1e-10) == (0, True)


def test_a_ball_under_pressure_by_another_route():
    ball = build_spheroid(Tissue(bar_force=5e-8), radius=1.5, profile="linear", decay=2.0)
    pressed = compress_spheroid(ball, "pressure", np.array([50.0, 100.0])).records[-1].state
    found = body(ball.structure.blocks, ball.bar_force)
    np.testing.assert_array_equal(found.prestress, ball.prestress)
    whole = LoadedBody(found, VoxelLoads(**nothing(found), pressure=100.0), free=True)
    whole.load(0.5)
    at = whole.load(1.0)
    np.testing.assert_allclose(at.displacement, pressed.displacement, atol=1e-10 * np.abs(pressed.displacement).max())
    change = whole.enclosed_volume_change()
    again = LoadedBody(found, whole.loads, free=True)
    half = again.load(0.5)
    resumed = LoadedBody(found, whole.loads, free=True)
    resumed.resume(half.displacement, 0.5)
    assert np.abs(resumed.forces_of_supports()).max() < 1e-9 * np.abs(half.members.force).mean()
    resumed.load(1.0)
    assert resumed.enclosed_volume_change() == pytest.approx(change, rel=1e-8)


def test_memory_that_was_measured():
    """Balls of radius 3 and 5 with PARDISO, and a sheet with SuperLU, whose fill is six times that."""
    for radius, measured in ((3, 460e6), (5, 1.69e9)):
        blocks = np.unique(spheroid_cells(radius) // 2, axis=0)
        backend, needed = memory_of_body(TISSUE, blocks, "auto")
        assert backend != "pardiso" or needed == pytest.approx(measured, rel=0.1)
    assert memory_of_body(TISSUE, box_cells(60, 30, 1), "superlu")[1] < 7 * memory_needed(600_000, "pardiso")
    with pytest.raises(InputError, match="linear"):
        memory_of_body(TISSUE, STAIR, "none such")


def test_two_bar_forces_are_in_balance_and_without_stress_at_rest():
    blocks = box_cells(3, 3, 3)
    force = np.where((blocks == 1).all(axis=1), 2e-8, 5e-9)
    found = body(blocks, force)
    system = MemberSystem(found.structure)
    rest = system.state(np.zeros(system.size))
    assert np.abs(system.gradient(rest)).max() < 1e-12 * np.abs(rest.force).mean()
    zero = np.zeros(found.structure.nodes.shape)
    own = block_fields(found.structure, zero, rest, prestress=found.prestress)
    halves = block_fields(found.structure, zero, rest)
    scale = np.abs(halves.kirchhoff).max()
    assert scale > 10.0  # halved, the tendons at the inclusion's face are a stress
    for stress in (own.kirchhoff, own.first_piola):
        assert np.abs(stress).max() < 1e-10 * scale
    np.testing.assert_allclose(own.kirchhoff.sum(axis=0), halves.kirchhoff.sum(axis=0), atol=1e-9 * scale)


def test_what_supports_leave_free():
    structure = body(box_cells(2, 2, 1)).structure
    fixed = np.zeros(structure.nodes.shape, dtype=bool)
    np.testing.assert_array_equal(free_motions(structure, fixed), np.eye(6))
    low = [side_nodes(structure, axis, end="low") for axis in range(3)]
    for axes, count in (((2,), 3), ((1, 2), 1), ((0, 1, 2), 0)):
        fixed[:] = False
        for axis in axes:
            fixed[low[axis], axis] = True
        free = free_motions(structure, fixed)
        assert len(free) == count
        np.testing.assert_allclose(free @ free.T, np.eye(count), atol=1e-12)
        motions = np.tensordot(free, rigid_motions(structure), axes=1)
        assert np.abs(motions[:, fixed]).max(initial=0.0) < 1e-12
        border = rigid_border(structure, fixed)
        assert border.constraint.shape[0] == count
        assert not border.constraint[:, :-9][:, fixed.ravel()].any()
    fixed[:] = True
    assert len(free_motions(structure, fixed)) == 0


def test_a_symmetry_plane_leaves_three_motions_and_pins_give_the_same_body():
    """Pulled along x on a plane that holds z alone: means hold the rest, or three displacements pinned elsewhere do."""
    found = body(box_cells(2, 1, 1))
    given = nothing(found)
    given["fixed"][side_nodes(found.structure, 2, end="low"), 2] = True
    for end, pull in ((0, -20.0), (1, 20.0)):
        given["force"] += traction_forces(found, outer(found, 0, end), uniform(pull, 0.0, 0.0))
    with pytest.raises(InputError, match="no rigid motion left free, got 3 of 6"):
        LoadedBody(found, VoxelLoads(**given))
    by_means = LoadedBody(found, VoxelLoads(**given), free=True)
    a = by_means.load(1.0)
    scale = np.abs(a.displacement).max()
    assert np.abs(a.displacement[:, :2].mean(axis=0)).max() < 1e-10 * scale
    loose = np.where(given["fixed"], 0.0, by_means.forces_of_supports())
    assert np.abs(loose).max() < 1e-8 * np.abs(a.members.force).mean()
    pinned = dict(given, fixed=given["fixed"].copy())
    far = found.structure.nodes[:, 0].argmax()
    pinned["fixed"][0, :2] = pinned["fixed"][far, 1] = True
    b = LoadedBody(found, VoxelLoads(**pinned)).load(1.0)
    np.testing.assert_allclose(a.members.length, b.members.length, rtol=1e-8)
    assert np.abs(a.displacement - b.displacement).max() > 0.01 * scale


def test_bad_bodies_and_loads():
    for blocks, force, text in (
        (STAIR, np.ones(3) * 1e-8, r"bar_force: expected one number a block \(4\), got shape \(3,\)"),
        (STAIR, np.zeros(4), "bar_force: expected positive forces"),
        (np.concatenate([STAIR, STAIR[:1]]), np.ones(5) * 1e-8, r"each once, got \[5, -2, 0\] twice"),
        (STAIR + 0.5, np.ones(4) * 1e-8, r"integers of shape \(b, 3\), b > 0, got float64"),
    ):
        with pytest.raises(InputError, match=text):
            build_block_body(TISSUE, blocks, force)
    found = body(box_cells(2, 1, 1))
    pushed = nothing(found)
    pushed["force"] += traction_forces(found, outer(found, 0, 1), uniform(0.0, 7.0, 0.0))
    with pytest.raises(InputError, match=r"a force of \(.*, 2.8e-09, .*\) N and a moment of \(.*, 5.6e-14\) N m"):
        LoadedBody(found, VoxelLoads(**pushed), free=True)
    apart = body(np.array([[0, 0, 0], [2, 0, 0]]))
    with pytest.raises(InputError, match="one connected body, or all parts held, got 2 parts"):
        LoadedBody(apart, VoxelLoads(**nothing(apart)), free=True)
    with pytest.raises(InputError, match="traction: expected finite numbers in Pa"):
        traction_forces(found, outer(found, 0, 1), lambda x: np.full(x.shape, np.nan))
