"""The closed surface of a lattice body, the volume it encloses, and the pressure that follows it.

The corners of the surface are the nodes of the outer square faces, those that one cell alone owns. Its polygons are
these squares and the gaps between them, one around every corner of the body's voxels: in turn a side of a square and
a link across a voxel edge (where the edge is convex that link is the edge tendon). So the surface is the outline of
the body itself, watertight, and no point of it is interpolated. A polygon need not stay flat: it is the fan of
triangles from its mean point m to its sides, and adds m . sum_i (x_i x x_{i+1}) / 6 to the enclosed volume V.

V is cubic in the nodes, does not change under rigid motions, and V(A x) = det(A) V(x). Hence the nodal forces
-p dV/dx of a pressure p have no resultant and no moment, sum x (x) f = -p V 1 exactly, and p V is their potential: the
load follows the surface and stays conservative, its tangent symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import face_nodes
from tsg_micro.cells.structure import Structure, unit_of
from tsg_micro.data.errors import InputError

__all__ = ["Surface", "enclosed_volume", "outer_surface", "pair_vectors", "volume_gradient"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Surface:
    """A closed surface of polygons, counter-clockwise seen from outside."""

    squares: Index
    """Nodes (f, 4) of the outer square faces."""
    gaps: tuple[Index, ...]
    """Nodes of the polygons between them, one array (g, k) for each number k of corners."""
    pairs: Index
    """Distinct pairs (p, 2) of nodes that share a polygon, the lower number first."""
    place: tuple[Index, ...]
    """For every array of polygons, squares first: where the pairs of corners (a, b), a < b, are among ``pairs``."""

    @property
    def polygons(self) -> tuple[Index, ...]:
        """All polygons, squares first."""
        return (self.squares, *self.gaps)

    @property
    def nodes(self) -> Index:
        """Numbers of the nodes on the surface (s,)."""
        return np.unique(self.squares)


def outer_surface(structure: Structure) -> Surface:
    """The surface of a lattice body.

    Raises:
        InputError: the structure is no lattice of cells with square faces, is periodic, or two of its cells touch along
            an edge only.
    """
    cells = structure.cells
    if len(cells) == 0 or any(structure.periodic):
        raise InputError("structure: expected a lattice of cells without periodic axes")
    low = cells.min(axis=0) - 1
    present = np.zeros(np.ptp(cells, axis=0) + 3, dtype=bool)
    present[tuple((cells - low).T)] = True
    corners, partner = _outer_faces(structure, present, low)
    # the corner between the sides k and k + 1 of a face, left over side k, is entered again on the next face there
    face, side = partner // 4, partner % 4
    after = 4 * face + (side - 1) % 4
    gaps: dict[int, list[list[int]]] = {}
    seen = np.zeros(len(after), dtype=bool)
    flat = corners.ravel()
    for start in range(len(after)):
        polygon, at = [], start
        while not seen[at]:
            seen[at] = True
            polygon += [int(flat[4 * (at // 4) + (at + 1) % 4]), int(flat[at])]
            at = int(after[at])
        if polygon:
            gaps.setdefault(len(polygon), []).append(polygon)
    return _with_pairs(corners, tuple(np.array(gaps[k]) for k in sorted(gaps)), len(structure.nodes))


def _outer_faces(structure: Structure, present: NDArray[np.bool_], low: Index) -> tuple[Index, Index]:
    """Nodes (f, 4) of the outer faces, node k towards side k, counter-clockwise; and the side (4f,) beyond each side.

    Sides are numbered 4 face + k. A square is twisted by less than 45 degrees, so each node has a side of its own.
    """
    unit = np.eye(3, dtype=np.int64)
    if any(len(nodes) != 4 for sides in unit_of(structure).faces for nodes in sides):
        raise InputError("structure: expected cells with four nodes on every face, the corners of a square")
    corners, edges = [], []
    for axis in range(3):
        for sign in (-1, 1):
            u, v = (unit[(axis + 1) % 3], unit[(axis + 2) % 3])[::sign]  # u x v points outwards
            neighbour = structure.cells - low + sign * unit[axis]
            outer = ~present[tuple(neighbour.T)]
            node = face_nodes(structure, axis, end="high" if sign > 0 else "low")[outer]
            offset = structure.nodes[node] - structure.nodes[node].mean(axis=1, keepdims=True)
            towards = offset @ np.column_stack([u, v, -u, -v])
            corners.append(np.take_along_axis(node, towards.argmax(axis=1), axis=1))
            edges.append((2 * structure.cells[outer] + 1 + sign * unit[axis])[:, None] + np.array([u, v, -u, -v]))
    edge = np.concatenate(edges).reshape(-1, 3)  # twice the midpoint of the voxel edge, in cells
    edge -= edge.min(axis=0)
    number = np.ravel_multi_index(tuple(edge.T), tuple(edge.max(axis=0) + 1))
    _, inverse, count = np.unique(number, return_inverse=True, return_counts=True)
    if (count != 2).any():
        raise InputError("structure: expected cells that share faces, got two that touch along an edge only")
    order = np.argsort(inverse, kind="stable").reshape(-1, 2)
    partner = np.empty(len(number), dtype=np.int64)
    partner[order] = order[:, ::-1]
    return np.concatenate(corners), partner


def _with_pairs(squares: Index, gaps: tuple[Index, ...], n: int) -> Surface:
    """The surface with its distinct pairs of nodes; ``n`` nodes in all."""
    keys = []
    for polygon in (squares, *gaps):
        first, second = (polygon[:, side] for side in np.triu_indices(polygon.shape[1], 1))
        keys.append(np.minimum(first, second) * n + np.maximum(first, second))
    distinct, place = np.unique(np.concatenate([key.ravel() for key in keys]), return_inverse=True)
    ends = np.cumsum([key.size for key in keys])[:-1]
    return Surface(squares, gaps, np.column_stack([distinct // n, distinct % n]), tuple(np.split(place, ends)))


def _sum(polygon: Array) -> Array:
    """Sum over the sides of x_i x x_{i+1} (g, 3), twice the area vector."""
    return np.cross(polygon, np.roll(polygon, -1, axis=1)).sum(axis=1)


def enclosed_volume(surface: Surface, position: Array) -> float:
    """Volume (m^3) inside the surface, its nodes at ``position`` (n, 3), m."""
    total = 0.0
    for nodes in surface.polygons:
        x = position[nodes]
        total += float((x.mean(axis=1) * _sum(x)).sum()) / 6.0
    return total


def volume_gradient(surface: Surface, position: Array) -> Array:
    """Derivative (n, 3) of the enclosed volume by the nodes, m^2: their share of the surface, pointing outwards."""
    gradient = np.zeros_like(position)
    for nodes in surface.polygons:
        x = position[nodes]
        across = np.roll(x, -1, axis=1) - np.roll(x, 1, axis=1)
        share = _sum(x)[:, None] / nodes.shape[1] + np.cross(across, x.mean(axis=1, keepdims=True))
        for axis in range(3):
            gradient[:, axis] += np.bincount(nodes.ravel(), share[..., axis].ravel(), minlength=len(position)) / 6.0
    return gradient


def pair_vectors(surface: Surface, position: Array) -> Array:
    """Second derivative of the enclosed volume: vectors w (p, 3), m, one for each of ``surface.pairs`` (i, j).

    The derivative by x_i and x_j is the matrix of w x (a cross product), by x_j and x_i its transpose, by x_i twice 0.
    """
    w = np.zeros((len(surface.pairs), 3))
    for nodes, place in zip(surface.polygons, surface.place, strict=True):
        x, n = position[nodes], nodes.shape[1]
        a, b = np.triu_indices(n, 1)
        across = np.roll(x, -1, axis=1) - np.roll(x, 1, axis=1)
        mean = x.mean(axis=1, keepdims=True)
        beside = np.where(b - a == n - 1, 1.0, 0.0) - np.where(b - a == 1, 1.0, 0.0)
        vector = (across[:, a] - across[:, b]) / (6.0 * n) + beside[:, None] * mean / 6.0
        vector *= np.where(nodes[:, a] < nodes[:, b], 1.0, -1.0)[..., None]
        for axis in range(3):
            w[:, axis] += np.bincount(place, vector[..., axis].ravel(), minlength=len(w))
    return w
