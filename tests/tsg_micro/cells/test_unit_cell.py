"""The cell in closed form: published figures, equilibrium for every shape, symmetry, and the SVD as a second route."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tsg_micro.cells.lattice import box_cells, lattice
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import self_stress
from tsg_micro.cells.truncated_octahedron import unit_cell
from tsg_micro.cells.unit_cell import BAR, EDGE_TENDON, SQUARE_TENDON
from tsg_micro.data.errors import InputError

SHAPES = st.floats(0.05, 0.95)


def out_of_balance(unit):
    d = unit.nodes[unit.members[:, 1]] - unit.nodes[unit.members[:, 0]]
    pull = unit.force_density[:, None] * d
    force = np.zeros((24, 3))
    np.add.at(force, unit.members[:, 0], pull)
    np.add.at(force, unit.members[:, 1], -pull)
    return np.abs(force).max() / np.linalg.norm(pull, axis=1).max()


def test_regular_proportion():
    unit = unit_cell(0.5)
    q = dict(zip(unit.kind, unit.force_density, strict=True))
    assert np.degrees(unit.theta) == pytest.approx(15.037, abs=5e-4)
    assert q[SQUARE_TENDON] == pytest.approx(2.16978, abs=5e-6)
    assert q[EDGE_TENDON] == pytest.approx(2.18464, abs=5e-6)
    assert q[BAR] == -1.0
    assert np.bincount(unit.kind).tolist() == [24, 12, 12]


@given(r=SHAPES, mirrored=st.booleans())
def test_in_equilibrium_for_every_shape(r, mirrored):
    unit = unit_cell(r, mirrored=mirrored)
    assert out_of_balance(unit) < 1e-14
    a, b = r * np.cos(unit.theta), r * np.sin(unit.theta)
    q_s, q_e = unit.force_density[unit.kind == SQUARE_TENDON][0], unit.force_density[unit.kind == EDGE_TENDON][0]
    assert 2.0 * b * (q_s + q_e) == pytest.approx(1.0 + b, rel=1e-12)
    assert q_e * (1.0 - a) == pytest.approx(1.0 + b, rel=1e-12)
    assert min(q_s, q_e) > 0.0


@given(r=SHAPES)
def test_geometry(r):
    unit = unit_cell(r)
    assert np.abs(unit.nodes).max() == 1.0
    top = unit.nodes[unit.nodes[:, 2] == 1.0]
    assert len(top) == 4
    np.testing.assert_allclose(np.hypot(top[:, 0], top[:, 1]), r, rtol=1e-14)
    length = np.linalg.norm(np.subtract(*unit.nodes[unit.members.T]), axis=1)
    np.testing.assert_allclose(length[unit.kind == SQUARE_TENDON], np.sqrt(2.0) * r, rtol=1e-13)
    np.testing.assert_allclose(length[unit.kind == BAR], unit.bar_length, rtol=1e-13)
    assert (np.bincount(unit.members.ravel()) == 4).all()  # two square tendons, one edge tendon, one bar at a node


def members_under(unit, transformation):
    """Members as a set of (kind, ends) after the nodes are moved by ``transformation`` and looked up again."""
    gap = np.linalg.norm((unit.nodes @ transformation.T)[:, None] - unit.nodes, axis=2)
    if gap.min(axis=1).max() > 1e-12:
        return None
    image = gap.argmin(axis=1)[unit.members]
    return {(kind, *sorted(ends)) for kind, ends in zip(unit.kind.tolist(), image.tolist(), strict=True)}


@pytest.mark.parametrize("mirrored", [False, True])
def test_symmetric_under_the_rotations_of_the_cube_and_under_no_reflection(mirrored):
    unit = unit_cell(0.5, mirrored=mirrored)
    members = members_under(unit, np.eye(3))
    rotations = Rotation.create_group("O").as_matrix()
    assert len(rotations) == 24
    assert all(members_under(unit, rotation) == members for rotation in rotations)
    assert not any(members_under(unit, -rotation) == members for rotation in rotations)


def test_mirror_image():
    unit, image = unit_cell(0.4), unit_cell(0.4, mirrored=True)
    np.testing.assert_array_equal(image.nodes, unit.nodes * [-1.0, 1.0, 1.0])
    np.testing.assert_array_equal(image.members, unit.members)
    np.testing.assert_array_equal(image.force_density, unit.force_density)


@pytest.mark.parametrize("r", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_svd_finds_the_closed_form(r):
    structure = lattice(box_cells(1, 1, 1), CellParameters(half_diagonal=r))
    found = self_stress(structure)
    assert (found.rank, found.states.shape, found.mechanisms) == (47, (48, 1), 19)
    assert found.singular_values[46] > 1e-3 * found.singular_values[0]
    unit = unit_cell(r)
    closed = dict(zip(unit.kind, unit.force_density, strict=True))
    q = np.array([closed[kind] for kind in structure.kind])
    state = found.states[:, 0]
    np.testing.assert_allclose(state / state[structure.bars].mean(), -q, rtol=1e-12)


@pytest.mark.parametrize("r", [0.0, 1.0, -0.1, 1.5, np.nan, np.inf])
def test_half_diagonal_outside_its_range(r):
    with pytest.raises(InputError, match=r"half_diagonal r: expected a number in \(0, 1\)"):
        unit_cell(r)
    with pytest.raises(InputError, match="half_diagonal"):
        CellParameters(half_diagonal=r)


@pytest.mark.parametrize("name", ["height", "E_bar", "E_tendon", "d_bar", "d_tendon"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_parameters_must_be_positive(name, value):
    with pytest.raises(InputError, match=f"{name}: expected a positive number"):
        CellParameters(**{name: value})
