"""Self-stress of a pin-jointed structure, and rest lengths that put it there.

Force densities q with A_eq q = 0 are the null space of the equilibrium matrix, found by SVD for structures of a
moderate size. A lattice of cells is prestressed by the sum of its cells' own states, each scaled to the bar force f_b
of its cell; that is exact for any number of cells.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsg_micro.cells.parameters import CellParameters, check_bar_force
from tsg_micro.cells.structure import Structure, equilibrium_matrix, from_arrays, member_vectors, unit_of
from tsg_micro.cells.unit_cell import UnitCell
from tsg_micro.data.errors import InputError

__all__ = [
    "SelfStress",
    "force_density_of_cells",
    "force_density_of_owners",
    "out_of_balance",
    "prestressed",
    "self_stress",
    "with_bar_force",
    "with_force_density",
    "with_self_stress",
]

Array = NDArray[np.float64]
_MOST_MEMBERS = 4000


@dataclass(frozen=True)
class SelfStress:
    """Null spaces of the equilibrium matrix, by SVD (paper, Section 2.2)."""

    rank: int
    states: Array
    """Orthonormal force densities V_2 (m, s)."""
    mechanisms: int
    """Internal mechanisms: 3n - rank less the rigid motions (6, or 3 where the structure is periodic)."""
    singular_values: Array
    """Of A_eq, largest first."""


def self_stress(structure: Structure) -> SelfStress:
    """Self-stress states and mechanisms of ``structure`` in its reference geometry.

    Raises:
        InputError: more members than a dense SVD is meant for.

    Example:
        >>> found = tsg.self_stress(tsg.Tissue().box((1, 1, 1)))
        >>> found.states.shape[1], found.mechanisms
        (1, 19)
    """
    if len(structure.members) > _MOST_MEMBERS:
        raise InputError(
            f"self_stress: expected at most {_MOST_MEMBERS} members for a dense SVD, got {len(structure.members)}"
        )
    _, values, v = np.linalg.svd(equilibrium_matrix(structure).toarray(), full_matrices=True)
    rank = int((values > values[0] * 1e-10).sum())
    rigid = 3 if any(structure.periodic) else 6
    return SelfStress(rank, v[rank:].T, structure.nodes.size - rank - rigid, values)


def with_bar_force(states: Array, structure: Structure, bar_force: float) -> Array:
    """Force densities V_2 z (m,), N/m, whose bars all carry the compression ``bar_force`` (paper, Section 2.2).

    Raises:
        InputError: no combination of the states gives every bar that force.

    Example:
        >>> cell = tsg.Tissue().box((1, 1, 1))
        >>> q = tsg.with_bar_force(tsg.self_stress(cell).states, cell, 1e-8)
        >>> force = q * np.linalg.norm(tsg.member_vectors(cell), axis=1)
        >>> (1e9 * force[cell.bars]).round(6)[:2]
        array([-10., -10.])
    """
    check_bar_force(bar_force, cells=1, EA_bar=np.inf)
    bars = structure.bars
    wanted = -bar_force / np.linalg.norm(member_vectors(structure)[bars], axis=1)
    z, *_ = np.linalg.lstsq(states[bars], wanted, rcond=None)
    if not np.allclose(states[bars] @ z, wanted, rtol=1e-8, atol=0.0):
        raise InputError("states: expected self-stress states that can give all bars one force, got none that does")
    return np.asarray(states @ z)


def with_self_stress(unit: UnitCell) -> UnitCell:
    """A cell of which no closed form is known, with the self-stress that the SVD finds.

    Raises:
        InputError: no state gives all its bars one force.
    """
    one = np.ones(len(unit.members))
    structure = from_arrays(unit.nodes, unit.members, kind=unit.kind, EA=one, rest_length=one)
    bar_length = float(np.linalg.norm(member_vectors(structure)[unit.bars], axis=1).mean())
    q = with_bar_force(self_stress(structure).states, structure, bar_length)
    return dataclasses.replace(unit, force_density=q, bar_length=bar_length)


def force_density_of_cells(structure: Structure, parameters: CellParameters, bar_force: ArrayLike) -> Array:
    """Self-stress (m,), N/m: the sum over cells of their own state, scaled to their bar force f_b (N).

    Raises:
        InputError: ``bar_force`` is not a positive number or one per cell.
    """
    return np.asarray(force_density_of_owners(structure, parameters, bar_force).sum(axis=1))


def force_density_of_owners(structure: Structure, parameters: CellParameters, bar_force: ArrayLike) -> Array:
    """What each of the one or two cells of a member contributes to its self-stress (m, 2), N/m, 0 for no cell.

    Raises:
        InputError: as :func:`force_density_of_cells`.
    """
    f = check_bar_force(bar_force, cells=len(structure.cells), EA_bar=parameters.EA_bar)
    unit = unit_of(structure)
    state = np.append(unit.force_density, 0.0)
    scale = np.append(f / (unit.bar_length * parameters.height / 2.0), 0.0)  # the last one stands for "no cell"
    return np.asarray(state[structure.member_places] * scale[structure.member_cells])


def out_of_balance(structure: Structure, force_density: Array) -> float:
    """Largest force, N, that force densities (m,), N/m, leave at a node: round-off, if they are a self-stress."""
    return float(np.abs(equilibrium_matrix(structure) @ force_density).max())


def with_force_density(structure: Structure, force_density: Array) -> Structure:
    """``structure`` with the rest lengths its member law gives for t0 = q l: it carries q (m,), N/m, where it stands.

    Raises:
        InputError: a force that its member cannot carry, as a compression as large as its stiffness.
    """
    length = np.linalg.norm(member_vectors(structure), axis=1)
    rest_length = structure.law.rest_length(length, force_density * length, structure.material)
    if not (np.isfinite(rest_length) & (rest_length > 0.0)).all():
        raise InputError("force_density: expected forces that every member can carry by its law")
    return dataclasses.replace(structure, rest_length=rest_length)


def prestressed(structure: Structure, parameters: CellParameters, bar_force: ArrayLike) -> Structure:
    """A lattice with the rest lengths that its bar force f_b (N; one, or one per cell) asks for.

    Raises:
        InputError: ``bar_force`` is not a positive number or one per cell.

    Example:
        >>> parameters = tsg.CellParameters()
        >>> bare = tsg.lattice(tsg.box_cells(2, 2, 2), parameters)
        >>> held = tsg.prestressed(bare, parameters, 1e-8)
        >>> bool((held.rest_length[held.bars] > bare.rest_length[held.bars]).all())
        True
    """
    return with_force_density(structure, force_density_of_cells(structure, parameters, bar_force))
