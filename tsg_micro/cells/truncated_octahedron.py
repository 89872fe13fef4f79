"""The truncated-octahedron tensegrity cell in closed form, in the cube [-1, 1]^3.

All 24 nodes are the orbit of p = (a, -b, 1) under the 24 rotations of the cube, so each square face is flat,
normal to an axis, with half-diagonal r = sqrt(a^2 + b^2), twisted by theta = atan(b / a). Square tendons join
neighbours on a face, edge tendons join two faces, bars cross the cell: 24 + 12 + 12 members.
Equilibrium at one node for a bar force density of -1 gives the self-stress state
    q_e = (1 + b) / (1 - a),   q_s = 1 + (1 + b) / (2 a),   2 b (q_s + q_e) = 1 + b;
the last equation fixes theta for a given r.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.unit_cell import BAR, EDGE_TENDON, SQUARE_TENDON, UnitCell
from tsg_micro.data.errors import InputError

__all__ = ["unit_cell"]


def _twist(r: float) -> float:
    """The angle theta at which the cell of half-diagonal r is in self-equilibrium."""

    def imbalance(theta: float) -> float:
        a, b = r * np.cos(theta), r * np.sin(theta)
        return 2.0 * b * (1.0 + (1.0 + b) * (0.5 / a + 1.0 / (1.0 - a))) - (1.0 + b)

    low, high = 1e-9, np.pi / 2 - 1e-9
    while low < (middle := 0.5 * (low + high)) < high:  # until no number lies between; quicker than importing brentq
        low, high = (middle, high) if imbalance(middle) < 0.0 else (low, middle)
    return float(middle)


def _rotations() -> NDArray[np.float64]:
    """The 24 rotation matrices of the cube (24, 3, 3)."""
    matrices = []
    for permutation in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.diag(signs)[:, permutation]
            if np.linalg.det(matrix) > 0.0:
                matrices.append(matrix)
    return np.array(matrices)


@lru_cache(maxsize=32)
def unit_cell(half_diagonal: float, *, mirrored: bool = False) -> UnitCell:
    """The cell of half-diagonal r in (0, 1), or its mirror image in x.

    Raises:
        InputError: r is outside (0, 1).

    Example:
        >>> unit = tsg.unit_cell(0.5)
        >>> int(unit.bars.sum()), int((~unit.bars).sum()), unit.nodes.shape
        (12, 36, (24, 3))
        >>> float(unit.force_density[unit.bars][0].round(3))
        -1.0
    """
    if not 0.0 < half_diagonal < 1.0:
        raise InputError(f"half_diagonal r: expected a number in (0, 1), got {half_diagonal}")
    theta = _twist(half_diagonal)
    a, b = half_diagonal * np.cos(theta), half_diagonal * np.sin(theta)
    rotations = _rotations()
    nodes = rotations @ np.array([a, -b, 1.0])

    members, kind = [], []
    partners = {SQUARE_TENDON: (b, a, 1.0), EDGE_TENDON: (1.0, b, a), BAR: (-a, 1.0, -b)}
    for label, partner in partners.items():
        images = rotations @ np.array(partner)
        ends = np.abs(images[:, None] - nodes).sum(axis=2).argmin(axis=1)
        pairs = np.unique(np.sort(np.column_stack([np.arange(24), ends]), axis=1), axis=0)
        members.append(pairs)
        kind.append(np.full(len(pairs), label, dtype=np.uint8))

    densities = np.array([1.0 + 0.5 * (1.0 + b) / a, (1.0 + b) / (1.0 - a), -1.0])
    kinds = np.concatenate(kind)
    unit = UnitCell(
        nodes=nodes,
        places=np.where(np.abs(nodes) == 1.0, 4, 1) * np.sign(nodes).astype(np.int64),
        per_cell=8,
        members=np.concatenate(members),
        kind=kinds,
        force_density=densities[kinds],
        theta=theta,
        bar_length=float(np.sqrt(4.0 * a**2 + 2.0 * (1.0 + b) ** 2)),
    )
    return unit.turned(np.diag([-1, 1, 1])) if mirrored else unit
