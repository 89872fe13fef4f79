"""What a mesh file must be to be a body: hexahedra of positive volume that share the nodes where they touch.

Numbers of nodes are labels, and nodes that no hexahedron uses are left out. Groups of volumes are names of regions: a
cell in two of them is one cell. Corners are in the order of gmsh and VTK.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dd_macro.scene.msh import Block, MshFile
from tsg_micro.data.errors import InputError

__all__ = ["Hexahedra", "connected_parts", "hexahedra"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_FACES = np.array([[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
"""Corners of the faces of a hexahedron."""

_SOLIDS = {4: "tetrahedra", 5: "hexahedra", 6: "prisms", 7: "pyramids", 11: "second-order tetrahedra"}
_NEIGHBOURS = np.array([[1, 3, 4], [2, 0, 5], [3, 1, 6], [0, 2, 7], [7, 5, 0], [4, 6, 1], [5, 7, 2], [6, 4, 3]])
"""Corners next to each corner, in the order that makes their triple product positive in a right-handed cell."""
_TOUCH = 1e-3
"""Of the shortest edge: nodes that are nearer are at one place."""


@dataclass(frozen=True)
class Hexahedra:
    """Points (n, 3) in m, cells (m, 8), tagged facets (k, 4), and what the tags mean."""

    points: Array
    cells: Ints
    facets: Ints
    facet_tags: NDArray[np.int32]
    sides: dict[str, tuple[int, ...]]
    """Name of a physical surface to the tags of its facets, its own first; one in two groups has a tag for both."""
    regions: dict[str, Ints]
    """Name of a physical volume to its cells."""
    parts: Ints
    """Of every cell (m,): the number of the connected part, from 0."""


def hexahedra(file: MshFile, *, unit: float = 1.0, merge_nodes: bool = False) -> Hexahedra:
    """The body in a mesh file, whose coordinates are in ``unit`` m.

    ``merge_nodes`` joins nodes at one place, nearer than a thousandth of the shortest edge; else they are refused.

    Raises:
        InputError: other solids than 8-node hexahedra, no named surface, numbers of nodes that come twice or are not
            there, coordinates that are not finite, degenerate or folded cells, parts that touch but share no node, or
            share an edge or a node only.
    """
    solids = [block for block in file.blocks if block.dimension == 3]
    kinds = {block.kind for block in solids if len(block.nodes)}
    if kinds != {5}:
        found = (
            ", ".join(sorted(_SOLIDS.get(k, f"gmsh type {k}") for k in kinds))
            or "no solid cells (a file with named surfaces holds only solids that are in a physical volume)"
        )
        remedy = "; 'tsgdd mesh voxels' makes hexahedra of a closed surface" * bool(kinds)
        raise InputError(f"expected 8-node hexahedra only, got {found}{remedy}")
    named = {tag: name for (dimension, tag), name in file.names.items() if dimension == 2 and name}
    surfaces = [b for b in file.blocks if b.kind == 3 and len(b.nodes) and any(tag in named for tag in b.groups)]
    if not named or not surfaces:
        raise InputError("expected named physical surfaces (its sides), got none")
    cells, regions = _cells(solids, file.names)
    points, (cells, *quads) = _used(file, [cells, *(block.nodes for block in surfaces)], unit)
    cells = _right_handed(points, cells)
    points, moved = _at_one_place(points, cells, merge_nodes)
    cells = moved[cells]
    facets, tags, sides = _sides(cells, [moved[q] for q in quads], [b.groups for b in surfaces], named)
    parts = connected_parts(cells, len(points))
    if parts.any():
        _check_apart(points, cells, parts)
    return Hexahedra(points, cells, facets, tags, sides, regions, parts)


def _cells(solids: Iterable[Block], names: dict[tuple[int, int], str]) -> tuple[Ints, dict[str, Ints]]:
    """Every cell once, in the order of the file's groups, and the cells of every named one."""
    blocks = sorted((block for block in solids if len(block.nodes)), key=lambda block: (block.groups or (0,))[0])
    nodes = np.concatenate([block.nodes for block in blocks])
    _, first, which = np.unique(_numbers(nodes), return_index=True, return_inverse=True)
    place = np.empty(len(first), dtype=np.int64)
    place[np.argsort(first)] = np.arange(len(first))  # cells in the order in which they come first
    cell = np.split(place[which.reshape(-1)], np.cumsum([len(block.nodes) for block in blocks])[:-1])
    regions: dict[str, list[Ints]] = {}
    for block, inside in zip(blocks, cell, strict=True):
        for group in block.groups:
            regions.setdefault(names.get((3, group)) or str(group), []).append(inside)
    return nodes[np.sort(first)], {name: np.unique(np.concatenate(parts)) for name, parts in regions.items()}


def _numbers(rows: Ints) -> Ints:
    """A number for every row (n,), the same for rows of the same nodes in any order."""
    distinct, places = np.unique(rows, return_inverse=True)
    number, *others = np.sort(places.reshape(rows.shape), axis=1).T
    for column in others:
        number = np.unique(number * len(distinct) + column, return_inverse=True)[1].reshape(-1)
    return number


def _used(file: MshFile, elements: list[Ints], unit: float) -> tuple[Array, list[Ints]]:
    """Points in m of the nodes of ``elements[0]``, by rising number, and elements by point; -1 for another node."""
    order = np.argsort(file.numbers, kind="stable")
    numbers = file.numbers[order]
    twice = np.flatnonzero(numbers[1:] == numbers[:-1])
    if twice.size:
        raise InputError(f"expected every node once, got two of number {numbers[twice[0]]}")
    used = np.unique(elements[0])
    at = np.searchsorted(numbers, used).clip(max=len(numbers) - 1) if len(numbers) else np.zeros(0, dtype=np.int64)
    missing = used[numbers[at] != used] if len(numbers) else used
    if missing.size:
        raise InputError(f"expected coordinates of every node, got none of node {missing[0]}")
    points = file.points[order[at]] * unit
    bad = used[~np.isfinite(points).all(axis=1) | (np.abs(points) > 1e100).any(axis=1)]
    if bad.size:
        raise InputError(f"expected finite coordinates, got others at node {bad[0]}")
    local = []
    for nodes in elements:
        place = np.searchsorted(used, nodes).clip(max=len(used) - 1)
        local.append(np.where(used[place] == nodes, place, -1))
    return points, local


def _at_one_place(points: Array, cells: Ints, merge: bool) -> tuple[Array, Ints]:
    """The points that stay, and the new number of every point (with one more, -1 for -1)."""
    edges = np.linalg.norm(points[cells[:, _NEIGHBOURS]] - points[cells][:, :, None], axis=-1)
    pairs = cKDTree(points).query_pairs(_TOUCH * float(edges.min()), output_type="ndarray")
    if not len(pairs):
        return points, np.append(np.arange(len(points)), -1)
    n = len(points)
    if not merge:
        parts = int(connected_parts(cells, n, hinged=True).max()) + 1
        raise InputError(
            f"expected one node at one place, got {len(pairs)} pairs of coincident nodes and {parts} "
            f"part{'s' * (parts > 1)} that touch but share no node there; mend the mesh, or merge them (--merge-nodes)"
        )
    _, label = connected_components(coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n)), directed=False)
    _, first, new = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first)  # by rising number of the first of each
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return points[first[order]], np.append(rank[new], -1)


def _corner_jacobians(points: Array, cells: Ints) -> Array:
    """Jacobian determinants (m, 8) at the corners, in units of the cell's volume; the sign is the cell's hand."""
    x = points[cells]
    return np.asarray(np.linalg.det(x[:, _NEIGHBOURS] - x[:, :, None]))


def _right_handed(points: Array, cells: Ints) -> Ints:
    """Cells in the order of corners that has positive volume."""
    jacobian = _corner_jacobians(points, cells)
    extent = np.ptp(points[cells], axis=1).max(axis=1) ** 3
    mean = jacobian.mean(axis=1)
    good = np.abs(mean) > 1e-9 * extent
    good &= (jacobian * np.sign(mean)[:, None] > 1e-12 * extent[:, None]).all(axis=1)
    if not good.all():
        raise InputError(f"expected cells of positive volume, got {int((~good).sum())} degenerate or folded cells")
    return np.where((mean < 0.0)[:, None], cells[:, [4, 5, 6, 7, 0, 1, 2, 3]], cells)


def _sides(
    cells: Ints, quads: list[Ints], groups: list[tuple[int, ...]], named: dict[int, str]
) -> tuple[Ints, NDArray[np.int32], dict[str, tuple[int, ...]]]:
    """Facets that are faces of cells, each once, their tags, and the tags of every name."""
    nodes = np.concatenate(quads)
    owner = np.repeat(np.arange(len(quads)), [len(q) for q in quads])
    faces = cells[:, _FACES].reshape(-1, 4)
    which = _numbers(np.concatenate([faces, nodes]))
    is_face = np.zeros(int(which.max()) + 1, dtype=bool)
    is_face[which[: len(faces)]] = True
    which = which[len(faces) :]
    members: dict[int, set[int]] = {}
    first: dict[int, int] = {}
    for at in np.flatnonzero(is_face[which]):
        facet = int(which[at])
        first.setdefault(facet, int(at))
        members.setdefault(facet, set()).update(tag for tag in groups[owner[at]] if tag in named)
    sides: dict[str, list[int]] = {}
    for tag, name in named.items():
        sides.setdefault(name, []).append(tag)
    combined: dict[frozenset[int], int] = {}
    tags = np.empty(len(first), dtype=np.int32)
    for i, facet in enumerate(first):
        tag_set = frozenset(members[facet])
        if len(tag_set) == 1:
            (tags[i],) = tag_set
            continue
        if tag_set not in combined:
            combined[tag_set] = max(named) + 1 + len(combined)
            for name in {named[tag] for tag in tag_set}:
                sides[name].append(combined[tag_set])
        tags[i] = combined[tag_set]
    return nodes[list(first.values())], tags, {name: tuple(own) for name, own in sides.items()}


def connected_parts(cells: Ints, nodes: int, *, hinged: bool = False) -> Ints:
    """Connected part (m,) of every cell (m, 8) of so many nodes, from 0.

    Raises:
        InputError: parts share an edge or a node only, unless ``hinged`` may be.
    """
    m = len(cells)
    graph = coo_array(
        (np.ones(8 * m), (np.repeat(np.arange(m), 8), m + cells.reshape(-1))), shape=(m + nodes, m + nodes)
    )
    _, label = connected_components(graph, directed=False)
    _, parts = np.unique(label[:m], return_inverse=True)
    if hinged:
        return parts.astype(np.int64)
    face = _numbers(cells[:, _FACES].reshape(-1, 4))
    most = int(face.max()) + 1
    by_face = coo_array(
        (np.ones(6 * m), (np.repeat(np.arange(m), 6), m + face.reshape(-1))), shape=(m + most, m + most)
    )
    _, joined = connected_components(by_face, directed=False)
    pieces, bodies = len(np.unique(joined[:m])), int(parts.max()) + 1
    if pieces != bodies:
        raise InputError(
            f"expected cells that are joined by faces, got {pieces} pieces in {bodies} "
            f"part{'s' * (bodies > 1)}: some hang together at an edge or a node only"
        )
    return parts.astype(np.int64)


def _check_apart(points: Array, cells: Ints, parts: Ints) -> None:
    """Raise InputError where nodes of a part lie on the surface of another."""
    faces, part = cells[:, _FACES].reshape(-1, 4), np.repeat(parts, 6)
    _, first, count = np.unique(_numbers(faces), return_index=True, return_counts=True)
    faces, part = faces[first[count == 1]], part[first[count == 1]]
    part_of = np.zeros(len(points), dtype=np.int64)
    part_of[cells] = parts[:, None]
    x = points[faces]
    centre, near = x.mean(axis=1), _TOUCH * np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).min()
    radius = np.linalg.norm(x - centre[:, None], axis=2).max(axis=1) + near
    nodes = np.unique(faces)
    found: set[int] = set()
    for face, candidates in enumerate(cKDTree(points[nodes]).query_ball_point(centre, radius)):
        others = nodes[candidates][part_of[nodes[candidates]] != part[face]]
        normal = np.cross(x[face, 2] - x[face, 0], x[face, 3] - x[face, 1])
        normal /= np.linalg.norm(normal)
        away = points[others][:, None] - x[face]  # (nodes, corner, 3)
        along = np.roll(x[face], -1, axis=0) - x[face]
        inside = np.cross(along, away) @ normal / np.linalg.norm(along, axis=1)  # distance from each edge
        on = (np.abs(away.mean(axis=1) @ normal) < near) & (inside > -near).all(axis=1)
        found.update(others[on].tolist())
    if found:
        raise InputError(
            f"expected parts that share the nodes where they touch, got {parts.max() + 1} parts, with {len(found)} "
            "nodes on a face of another part and none shared; make the meshes of the parts agree there"
        )
