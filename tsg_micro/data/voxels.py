"""Bodies of voxels: equal cubes at whole-number places, which share the nodes where they meet; and named sides.

Corners are in the order of VTK and gmsh, those of an outer face such that its normal points outwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsg_micro.data.errors import InputError

__all__ = ["SIDES", "UNITS", "VoxelBody", "check_region", "combinations", "voxel_body"]

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

SIDES = ("left", "right", "bottom", "top", "back", "front")
"""Sides of a box: left and right are normal to x, bottom and top to y, back and front to z."""

UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
"""Units of a file's coordinates, in m."""

_CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
_FACES = np.array([[0, 4, 7, 3], [1, 2, 6, 5], [0, 1, 5, 4], [3, 7, 6, 2], [0, 3, 2, 1], [4, 5, 6, 7]])
"""Corners of the faces of a voxel, in the order of SIDES."""
_MOST = 2**62


@dataclass(frozen=True)
class VoxelBody:
    """Nodes (n, 3) in edges of an element, elements (m, 8), and outer faces (k, 4) of nodes."""

    nodes: Ints
    cells: Ints
    faces: Ints
    towards: Ints
    """Of every outer face (k,): the number in SIDES of the side that it looks to."""
    owner: Ints
    """Of every outer face (k,): its element."""

    def sides(self) -> dict[str, Mask]:
        """Outer faces (k,) of ``surface``, all of them, and of SIDES, those in the outermost planes of the body."""
        low, high = self.nodes.min(axis=0), self.nodes.max(axis=0)
        axis, upper = np.divmod(self.towards, 2)
        place = self.nodes[self.faces[:, 0], axis]
        outermost = place == np.where(upper == 1, high[axis], low[axis])
        found = {"surface": np.ones(len(self.faces), dtype=bool)}
        return found | {name: outermost & (self.towards == i) for i, name in enumerate(SIDES)}


def voxel_body(blocks: ArrayLike, *, refine: int = 1) -> VoxelBody:
    """The body of the voxels at ``blocks`` (b, 3), whole numbers; element i refine^3 + j is the j-th of voxel i.

    Raises:
        InputError: not whole numbers of that shape, no voxel, one twice, places too far apart to number, or refine < 1.
    """
    places = np.asarray(blocks)
    if places.ndim != 2 or places.shape[1:] != (3,) or not len(places) or not np.issubdtype(places.dtype, np.integer):
        raise InputError(
            f"blocks: expected whole numbers of shape (voxels, 3), got {places.dtype} of shape {places.shape}"
        )
    if not isinstance(refine, int) or refine < 1:
        raise InputError(f"refine: expected a whole number of at least 1, got {refine}")
    low = [int(column.min()) for column in places.T]
    span = [refine * (int(column.max()) - least + 1) + 2 for column, least in zip(places.T, low, strict=True)]
    if math.prod(span) >= _MOST or max(map(abs, low)) >= 2**40:
        raise InputError(f"blocks: expected places within a box that can be numbered, got one of {span} elements")
    inside = places.astype(np.int64) - low
    part = np.stack(np.unravel_index(np.arange(refine**3), (refine,) * 3), axis=1)
    elements = (refine * inside[:, None] + part).reshape(-1, 3)
    step = np.array([span[1] * span[2], span[2], 1])
    number = (elements + 1) @ step
    ordered = np.sort(number)
    if (ordered[1:] == ordered[:-1]).any():
        raise InputError("blocks: expected every voxel once, got one twice")
    corners = ((elements[:, None] + _CORNERS) @ step).reshape(-1)
    used, cells = np.unique(corners, return_inverse=True)
    cells = cells.reshape(-1, 8)
    owner, faces, towards = [], [], []
    for side, face in enumerate(_FACES):
        axis, upper = divmod(side, 2)
        beside = number + (step[axis] if upper else -step[axis])
        outer = ordered[np.searchsorted(ordered, beside).clip(max=len(ordered) - 1)] != beside
        owner.append(np.flatnonzero(outer))
        faces.append(cells[outer][:, face])
        towards.append(np.full(int(outer.sum()), side))
    nodes = np.stack(np.unravel_index(used, span), axis=1) + refine * np.array(low)
    return VoxelBody(nodes, cells, np.concatenate(faces), np.concatenate(towards), np.concatenate(owner))


def check_region(name: str, numbers: ArrayLike, voxels: int) -> Ints:
    """Numbers (r,) of the voxels of the region ``name``, each once.

    Raises:
        InputError: not whole numbers from 0 to voxels - 1, or none.
    """
    found = np.asarray(numbers)
    if found.ndim != 1 or not len(found) or not np.issubdtype(found.dtype, np.integer):
        raise InputError(f"region {name}: expected numbers of voxels (r,), got {found.dtype} of shape {found.shape}")
    if found.min() < 0 or found.max() >= voxels:
        raise InputError(f"region {name}: expected voxels from 0 to {voxels - 1}, got {found.min()} to {found.max()}")
    return np.unique(found).astype(np.int64)


def combinations(sides: Mapping[str, Mask]) -> tuple[list[tuple[int, ...]], Ints]:
    """The sets of sides that faces are on, by the sides' numbers, and of every face (k,) the number of its set."""
    rows, which = np.unique(np.stack(list(sides.values()), axis=1), axis=0, return_inverse=True)
    return [tuple(int(i) for i in np.flatnonzero(row)) for row in rows], which.reshape(-1).astype(np.int64)
