"""Tilings: the counts of the paper, merging by keys, periodic images, and what is refused."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from tsg_micro.cells.lattice import box_cells, lattice, side_nodes, spheroid_cells
from tsg_micro.cells.structure import from_arrays, member_vectors
from tsg_micro.cells.truncated_octahedron import unit_cell
from tsg_micro.cells.unit_cell import BAR, SQUARE_TENDON
from tsg_micro.data.errors import InputError

CELL = st.tuples(*[st.integers(-2, 2)] * 3)


def shared_faces(cells):
    """Pairs of neighbouring cells, counted one by one."""
    present = set(map(tuple, np.asarray(cells).tolist()))
    return sum(tuple(np.add(cell, step)) in present for cell in present for step in np.eye(3, dtype=int))


def as_sets(structure):
    """A structure without its numbering: positions by key, and members by the keys and owners of their ends."""
    keys = list(map(tuple, structure.node_keys.tolist()))
    nodes = dict(zip(keys, map(tuple, structure.nodes.tolist()), strict=True))
    members = set()
    for (i, j), kind, owners in zip(structure.members, structure.kind, structure.member_cells, strict=True):
        cells = frozenset(tuple(structure.cells[c].tolist()) for c in owners if c >= 0)
        members.add((frozenset({keys[i], keys[j]}), int(kind), cells))
    return nodes, members


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (box_cells(1, 1, 1), (1, 24, 12, 36)),
        (box_cells(2, 2, 1), (4, 80, 48, 128)),
        (box_cells(2, 2, 2), (8, 144, 96, 240)),
        (spheroid_cells(5.0), (4416, 56832, 52992, 109824)),
    ],
    ids=["cell", "2x2x1", "2x2x2", "spheroid"],
)
def test_counts(cells, expected):
    structure = lattice(cells)
    bars = int(structure.bars.sum())
    assert (len(structure.cells), len(structure.nodes), bars, len(structure.members) - bars) == expected
    if len(cells) == 4416:
        assert len(structure.blocks) == 552
        assert (np.bincount(structure.cell_block) == 8).all()


@settings(max_examples=30)
@given(cells=st.sets(CELL, min_size=1, max_size=25))
def test_any_voxel_shape_shares_four_nodes_and_tendons_a_face(cells):
    structure = lattice(sorted(cells))
    faces = shared_faces(list(cells))
    assert len(structure.nodes) == 24 * len(cells) - 4 * faces
    assert len(structure.members) == 48 * len(cells) - 4 * faces
    both = (structure.member_cells >= 0).all(axis=1)
    assert both.sum() == 4 * faces
    assert (structure.kind[both] == SQUARE_TENDON).all()
    if len(structure.nodes) > 24:  # nothing that is one place was left as two nodes
        assert cKDTree(structure.nodes).query(structure.nodes, k=2)[0][:, 1].min() > 1e-6


@settings(max_examples=20)
@given(cells=st.lists(CELL, min_size=2, max_size=20, unique=True), data=st.data())
def test_order_of_the_cells_does_not_matter(cells, data):
    assert as_sets(lattice(cells)) == as_sets(lattice(data.draw(st.permutations(cells))))


def test_shape_with_a_hole():
    cells = box_cells(3, 3, 3)
    hollow = lattice(cells[(cells != 1).any(axis=1)])
    full = lattice(cells)
    assert len(full.members) - len(hollow.members) == 24  # edge tendons and bars of the cell in the middle
    assert len(full.nodes) == len(hollow.nodes)  # all its nodes belong to its neighbours too


@pytest.mark.parametrize(("axis", "start"), list(itertools.product(range(3), (-1, 0, 1))))
def test_neighbours_are_mirror_images_that_share_a_face(cell, axis, start):
    first = np.zeros(3, dtype=int)
    first[axis] = start
    structure = lattice([first, first + np.eye(3, dtype=int)[axis]], cell)
    assert (len(structure.nodes), len(structure.members)) == (44, 92)
    plane = cell.height * (start + 1)
    on_face = np.isclose(structure.nodes[:, axis], plane, rtol=0.0, atol=1e-12 * cell.height)
    assert on_face.sum() == 4
    mirror = structure.nodes.copy()
    mirror[:, axis] = 2.0 * plane - mirror[:, axis]
    assert cKDTree(structure.nodes).query(mirror)[0].max() < 1e-12 * cell.height


def test_cells_keep_the_geometry_of_the_unit_cell(cell):
    structure = lattice(box_cells(2, 3, 2), cell)
    unit = unit_cell(cell.half_diagonal)
    half = np.linalg.norm(np.subtract(*unit.nodes[unit.members.T]), axis=1)
    expected = np.array([half[unit.kind == kind].mean() for kind in range(3)]) * cell.height / 2.0
    length = np.linalg.norm(member_vectors(structure), axis=1)
    np.testing.assert_allclose(length, expected[structure.kind], rtol=1e-12)
    np.testing.assert_allclose(structure.rest_length, length)
    np.testing.assert_array_equal(structure.EA, np.where(structure.kind == BAR, cell.EA_bar, cell.EA_tendon))
    np.testing.assert_allclose(structure.size, cell.height * np.array([2, 3, 2]))
    np.testing.assert_allclose(np.ptp(structure.nodes, axis=0), structure.size, rtol=1e-14)


@pytest.mark.parametrize(
    ("periodic", "images", "nodes", "members"),
    [
        ((True, True, False), "merged", 112, 304),
        ((True, True, False), "duplicated", 112, 336),
        ((True, True, True), "merged", 96, 288),
        ((True, True, True), "duplicated", 96, 336),
        ((False, False, True), "merged", 128, 320),
    ],
)
def test_periodic_counts(periodic, images, nodes, members):
    structure = lattice(box_cells(2, 2, 2), periodic=periodic, images=images)
    assert (len(structure.nodes), len(structure.members)) == (nodes, members)
    np.testing.assert_allclose(np.linalg.norm(member_vectors(structure), axis=1), structure.rest_length, rtol=1e-14)
    kinds = [np.unique(structure.rest_length[structure.kind == k].round(12)).size for k in range(3)]
    assert kinds == [1, 1, 1]  # ends at images are where they would be in the infinite body


def test_side_nodes():
    structure = lattice(box_cells(2, 3, 4))
    for axis, faces in enumerate((12, 8, 6)):
        low, high = side_nodes(structure, axis, end="low"), side_nodes(structure, axis, end="high")
        assert len(low) == len(high) == 4 * faces
        np.testing.assert_allclose(structure.nodes[low, axis], 0.0, atol=1e-18)
        np.testing.assert_allclose(structure.nodes[high, axis], structure.size[axis], rtol=1e-14)


@pytest.mark.parametrize(
    ("cells", "options", "text"),
    [
        (np.zeros((0, 3)), {}, "expected lattice indices"),
        ([[0, 0]], {}, "expected lattice indices"),
        ([[0, 0, 0], [0, 0, 0]], {}, "expected distinct cells"),
        (box_cells(3, 2, 2), {"periodic": (True, False, False)}, "even number of cells along x, got 3"),
        (box_cells(2, 2, 2)[:-1], {"periodic": (False, True, False)}, "expected a full box"),
        (box_cells(2, 2, 2), {"images": "tied"}, "expected 'merged' or 'duplicated'"),
    ],
)
def test_bad_cells(cells, options, text):
    with pytest.raises(InputError, match=text):
        lattice(cells, **options)


def test_bad_shapes():
    with pytest.raises(InputError, match="cells: expected three counts of at least 1, got 2 0 2"):
        box_cells(2, 0, 2)
    for radius in (0.5, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match=r"radius: expected at least 0\.866"):
            spheroid_cells(radius)
    assert len(spheroid_cells(0.87)) == 64  # the eight blocks around the centre


GOOD = {"kind": [0], "EA": [1.0], "rest_length": [1.0]}


@pytest.mark.parametrize(
    ("nodes", "members", "change", "text"),
    [
        ([[0, 0], [1, 0]], [[0, 1]], {}, "nodes: expected finite coordinates"),
        ([[0, 0, 0], [np.nan, 0, 0]], [[0, 1]], {}, "nodes: expected finite coordinates"),
        ([[0, 0, 0], [1, 0, 0]], [[0, 2]], {}, "members: expected pairs of node numbers below 2"),
        ([[0, 0, 0], [0, 0, 0]], [[0, 1]], {}, "member of length 0"),
        ([[0, 0, 0], [1, 0, 0]], [[0, 1]], {"EA": [-1.0]}, "EA: expected positive numbers"),
        ([[0, 0, 0], [1, 0, 0]], [[0, 1]], {"rest_length": [np.nan]}, "rest_length: expected positive numbers"),
        ([[0, 0, 0], [1, 0, 0]], [[0, 1]], {"kind": [0, 1]}, "kind: expected shape"),
    ],
)
def test_bad_arrays(nodes, members, change, text):
    with pytest.raises(InputError, match=text):
        from_arrays(nodes, members, **GOOD | change)
