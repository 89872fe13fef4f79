"""What is drawn of a lattice that is too large or too deep for all of its members to be told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.structure import Structure
from tsg_micro.data.figure_style import block_outlines

__all__ = ["is_deep", "middle_layer", "part", "top_cells"]

Array = NDArray[np.float64]

_DEEP = 4
"""Cells along each axis from which on a body is a tangle of lines."""
_OF_MEMBERS = ("members", "kind", "EA", "rest_length", "shift", "member_cells", "member_places")


def is_deep(structure: Structure) -> bool:
    """Whether a lattice has many cells along all three axes."""
    return len(structure.cells) > 0 and int(np.ptp(structure.cells, axis=0).min()) + 1 >= _DEEP


def middle_layer(structure: Structure) -> NDArray[np.bool_]:
    """Members (m,) of the cells in the layer across z that is in the middle."""
    z = structure.cells[:, 2]
    inside = z == np.unique(z)[len(np.unique(z)) // 2]
    return np.append(inside, False)[structure.member_cells].any(axis=1)  # the last one stands for "no cell"


def part(structure: Structure, members: NDArray[np.bool_]) -> Structure:
    """The structure with the chosen ``members`` (m,) alone; nodes and cells stay."""
    return replace(structure, **{name: getattr(structure, name)[members] for name in _OF_MEMBERS})


def top_cells(structure: Structure, displacement: Array) -> tuple[NDArray[np.int64], Array]:
    """The cells (k,) of the uppermost layer of a box, and their deformed outlines (k, 4, 2) seen from above, m.

    Raises:
        InputError: the cells are not those of a box.
    """
    top = np.flatnonzero(structure.cells[:, 2] == structure.cells[:, 2].max())
    nodes = structure.cell_nodes[top]
    midpoint, moved = structure.nodes[nodes].mean(axis=1), displacement[nodes].mean(axis=1)
    midpoint[:, :2] = structure.height * (structure.cells[top, :2] + 0.5)
    return top, block_outlines(midpoint, moved, structure.height)
