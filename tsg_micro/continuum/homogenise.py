"""From members to continuum: stress of a volume, deformation of every cell and block.

The sum over members of t_e (x) l_e, with l_e the current member vector, is the Kirchhoff stress tau times the
reference volume (paper, Section 2.4; Christoffersen et al. 1981). The volume average of the displacement gradient
comes from the displacements of the faces, H e_a = (u of face +a - u of face -a) / h (Hohe and Becker 2001).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import face_nodes
from tsg_micro.cells.structure import Structure, member_vectors
from tsg_micro.data.errors import InputError
from tsg_micro.equilibrium.members import MemberState

__all__ = ["BlockFields", "block_fields", "cell_gradient", "kirchhoff_stress"]

Array = NDArray[np.float64]


def kirchhoff_stress(members: MemberState, volume: float) -> Array:
    """Volume average (3, 3) of the Kirchhoff stress, Pa, over the reference ``volume`` (m^3) that holds all members."""
    d = members.vector
    return np.einsum("m,ma,mb->ab", members.force_density, d, d) / volume


def cell_gradient(structure: Structure, displacement: Array) -> Array:
    """Displacement gradient H (c, 3, 3) of every cell of a lattice, from the mean displacement of its six faces.

    ``displacement`` (n, 3) in m is that of the nodes.

    Raises:
        InputError: the lattice is periodic (the faces there belong to two cells at once).

    Example:
        >>> block = tsg.Tissue().box((2, 2, 2))
        >>> H = tsg.cell_gradient(block, 0.01 * block.nodes)
        >>> H.shape, H[0].diagonal().round(6)
        ((8, 3, 3), array([0.01, 0.01, 0.01]))
    """
    if any(structure.periodic):
        raise InputError("structure: expected a lattice without periodic axes")
    H = np.zeros((len(structure.cells), 3, 3))
    for axis in range(3):
        high, low = (face_nodes(structure, axis, end=end) for end in ("high", "low"))
        share = displacement / (high.shape[1] * structure.height)
        for nodes, sign in ((high, 1.0), (low, -1.0)):
            for node in np.sort(nodes, axis=1).T:  # of all cells at once, and always in one order
                H[:, :, axis] += sign * share[node]
    return H


@dataclass(frozen=True)
class BlockFields:
    """Means over each block of a lattice."""

    midpoint: Array
    """Reference midpoints (b, 3), m."""
    F: Array
    """Deformation gradients (b, 3, 3)."""
    kirchhoff: Array
    """Kirchhoff stress (b, 3, 3), Pa: members' forces times their current vectors."""
    first_piola: Array
    """First Piola stress (b, 3, 3), Pa: members' forces times their reference vectors; in balance row by row."""


def block_fields(
    structure: Structure, displacement: Array, members: MemberState, *, prestress: Array | None = None
) -> BlockFields:
    """Deformation gradient and stress (Pa) of every block (b, 3, 3), from the nodes' ``displacement`` (n, 3) in m.

    A member that two cells share carries in each of them the force at rest that this cell gave it, ``prestress``
    (m, 2) in N in the order of ``member_cells``, and half of what has been added since: so a cell at rest has no
    stress, next to whatever neighbour. Without ``prestress`` its whole force counts half in each, which is the same
    where all cells have one bar force.

    Raises:
        InputError: as :func:`cell_gradient`.
    """
    owned = structure.member_cells >= 0
    own_force = np.zeros(owned.shape) if prestress is None else prestress
    added = (members.force - own_force.sum(axis=1)) / owned.sum(axis=1)
    count = len(structure.blocks)
    current, reference = np.zeros((2, count, 3, 3))
    for side in (0, 1):
        own = owned[:, side]
        block = structure.cell_block[structure.member_cells[own, side]]
        density = (own_force[own, side] + added[own]) / members.length[own]
        force = density[:, None] * members.vector[own]
        np.add.at(current, block, force[:, :, None] * members.vector[own, None, :])
        np.add.at(reference, block, force[:, :, None] * member_vectors(structure)[own, None, :])
    cells_in_block = np.bincount(structure.cell_block, minlength=count)
    height = structure.height
    mean = np.zeros((count, 3, 3))
    np.add.at(mean, structure.cell_block, cell_gradient(structure, displacement))
    mean /= cells_in_block[:, None, None]
    midpoint = np.zeros((count, 3))
    np.add.at(midpoint, structure.cell_block, (structure.cells + 0.5) * height)
    volume = (cells_in_block * height**3)[:, None, None]
    return BlockFields(
        midpoint=midpoint / cells_in_block[:, None],
        F=np.eye(3) + mean,
        kirchhoff=current / volume,
        first_piola=reference / volume,
    )
