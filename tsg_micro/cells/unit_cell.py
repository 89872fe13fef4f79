"""What a lattice, its prestress and its continuum ask of the cell they are tiled from.

Every cell of a lattice is the unit cell or a mirror image of it, so any cell in a cube tiles: neighbours agree on the
face between them. What belongs to that face is one, and it is found by the nodes' exact integer places.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsg_micro.data.errors import InputError

__all__ = ["BAR", "EDGE_TENDON", "KINDS", "SQUARE_TENDON", "UnitCell"]

SQUARE_TENDON, EDGE_TENDON, BAR = 0, 1, 2
KINDS = ("square tendon", "edge tendon", "bar")
Sides = tuple[NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True)
class UnitCell:
    """One cell in units of half its height, from its centre, and its self-stress.

    Raises:
        InputError: on construction, where shapes do not fit, places and coordinates disagree about what is on a face,
            opposite faces have different numbers of nodes, a bar is on a face or any member on an edge of the cube, or
            the self-stress is not in equilibrium or gives the bars different forces.
    """

    nodes: NDArray[np.float64]
    """Coordinates (n, 3) in [-1, 1]^3."""
    places: NDArray[np.int64]
    """Exact positions (n, 3) in place of coordinates, ``per_cell`` to a cell: distinct, +-per_cell / 2 on a face."""
    per_cell: int
    """Even; eighths suit a cell whose nodes are in four quadrants of its faces."""
    members: NDArray[np.int64]
    """Node pairs (m, 2)."""
    kind: NDArray[np.uint8]
    """Kind of each member (m,): index into KINDS."""
    force_density: NDArray[np.float64]
    """Self-stress state (m,) that compresses every bar by ``bar_length``; zeros where it is not known yet."""
    bar_length: float
    """Length of a bar, or their mean, in half cell heights."""
    theta: float = 0.0
    """Twist of the faces, rad."""

    def __post_init__(self) -> None:
        n, m, half = len(self.nodes), len(self.members), self.per_cell // 2
        shapes = (self.nodes.shape, self.places.shape, self.members.shape, self.kind.shape, self.force_density.shape)
        if shapes != ((n, 3), (n, 3), (m, 2), (m,), (m,)) or self.per_cell != 2 * half:
            raise InputError(f"unit cell: expected n nodes and places, m members, an even per_cell, got {shapes}")
        on_face = np.abs(self.places) == half
        if (on_face != (np.abs(self.nodes) == 1.0)).any() or len(np.unique(self.places, axis=0)) < n:
            raise InputError(f"places: expected distinct ones, +-{half} where a coordinate is +-1 and nowhere else")
        if any(len(low) != len(high) for low, high in self.faces):
            raise InputError("unit cell: expected as many nodes on a face as on the opposite one")
        i, j = self.members.T
        shared = (on_face[i] & (self.places[i] == self.places[j])).sum(axis=1)
        if (shared > 1).any() or (shared[self.bars] > 0).any():
            raise InputError("members: expected none along an edge of the cube, and tendons only on its faces")
        d = self.nodes[j] - self.nodes[i]
        pull = self.force_density[:, None] * d
        rest = np.zeros((n, 3))
        np.add.at(rest, i, pull)
        np.add.at(rest, j, -pull)
        push = -self.force_density[self.bars] * np.linalg.norm(d[self.bars], axis=1)
        equal = np.allclose(push, self.bar_length, rtol=1e-9) or not pull.any()
        if np.abs(rest).max() > 1e-9 * np.abs(pull).max() or not equal:
            raise InputError("force_density: expected equilibrium, and bar_length as the compression of every bar")

    @property
    def bars(self) -> NDArray[np.bool_]:
        """Mask of the bars (m,)."""
        return self.kind == BAR

    @property
    def faces(self) -> tuple[Sides, Sides, Sides]:
        """For each axis the nodes on the low and on the high face across it."""
        low, high = (self.places == end * (self.per_cell // 2) for end in (-1, 1))
        x, y, z = ((np.flatnonzero(low[:, axis]), np.flatnonzero(high[:, axis])) for axis in range(3))
        return x, y, z

    def turned(self, matrix: ArrayLike) -> UnitCell:
        """The same cell seen in another frame: ``matrix`` (3, 3) swaps axes, their signs, or both."""
        turn = np.asarray(matrix, dtype=np.int64)
        return replace(self, nodes=self.nodes @ turn.T, places=self.places @ turn.T)
