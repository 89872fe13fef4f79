"""Radial stress of a ball of cells, block by block, and bar forces that vary along the radius (paper, Section 3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.structure import Structure, unit_of
from tsg_micro.continuum.homogenise import block_fields
from tsg_micro.data.errors import InputError
from tsg_micro.equilibrium.members import MemberState

__all__ = [
    "PROFILES",
    "RadialProfile",
    "RadialStress",
    "ball_radius",
    "bar_force_profile",
    "block_radius",
    "core_over_rim",
    "radial_profile",
    "radial_stress",
    "shell_count",
]

Array = NDArray[np.float64]

PROFILES = ("exponential", "linear", "constant")
_CORE, _RIM = 0.25, 0.75


def bar_force_profile(r: Array, *, profile: str, f_max: float, decay: float) -> Array:
    """Bar force (n,), N, at r/R (n,): f_max at the centre, f_max exp(-k) at r = R, but for the constant profile f_max.

    exponential: f_max exp(-k r/R) (paper, Section 3.3); linear: f_max (1 - (1 - exp(-k)) r/R); k is the decay.

    Raises:
        InputError: the profile is unknown, the force not positive, or the decay negative or not finite.
    """
    if profile not in PROFILES:
        raise InputError(f"profile: expected one of {', '.join(PROFILES)}, got {profile!r}")
    if not (np.isfinite(f_max) and f_max > 0.0):
        raise InputError(f"f_max: expected a positive force in N, got {f_max}")
    if not (np.isfinite(decay) and decay >= 0.0):
        raise InputError(f"decay: expected a number from 0 upwards, got {decay}")
    if profile == "exponential":
        return f_max * np.exp(-decay * r)
    if profile == "linear":
        return f_max * (1.0 - (1.0 - np.exp(-decay)) * r)
    return np.full_like(r, f_max)


def _block_midpoints(structure: Structure) -> Array:
    """Reference midpoints (b, 3) of the blocks, from the midpoint of the body, m."""
    count = np.bincount(structure.cell_block)
    sums = [np.bincount(structure.cell_block, axis + 0.5) for axis in structure.cells.T]
    midpoint = structure.height * np.column_stack(sums) / count[:, None]
    return midpoint - midpoint.mean(axis=0)


def block_radius(structure: Structure, radius: float) -> Array:
    """Reference r/R (b,) of the midpoints of the blocks, R being ``radius`` (m)."""
    return np.linalg.norm(_block_midpoints(structure), axis=1) / radius


@dataclass(frozen=True)
class RadialStress:
    """n . stress . n of every block, n from the body's current midpoint to the block's; tension positive, Pa."""

    kirchhoff: Array
    """(b,), members' forces times current vectors, over the reference volume."""
    cauchy: Array
    """(b,), Kirchhoff stress over J of the block."""
    halves: Array
    """(b,), Cauchy, where a tendon that two blocks share counts half in each, whatever their bar forces."""
    J: Array
    """Current over reference volume of the blocks (b,)."""
    midpoint: Array
    """Current midpoints (b, 3), from the body's midpoint, m."""


def radial_stress(structure: Structure, displacement: Array, members: MemberState, prestress: Array) -> RadialStress:
    """Radial stress of every block of a lattice, with ``prestress`` (m, 2) in N as :func:`block_fields` has it.

    Counted in halves throughout, blocks of different bar force have some before any load.
    """
    halves = block_fields(structure, displacement, members)
    fields = block_fields(structure, displacement, members, prestress=prestress)
    position = np.zeros((len(structure.blocks), 3))
    moved = structure.nodes + displacement
    for side in (0, 1):
        bar = structure.bars & (structure.member_cells[:, side] >= 0)  # the cells' bars stand for their nodes
        block = structure.cell_block[structure.member_cells[bar, side]]
        np.add.at(position, block, moved[structure.members[bar]].mean(axis=1))
    position /= unit_of(structure).bars.sum() * np.bincount(structure.cell_block)[:, None]
    position -= position.mean(axis=0)
    n = position / np.maximum(np.linalg.norm(position, axis=1, keepdims=True), 1e-300)
    J = np.linalg.det(fields.F)
    along = [np.einsum("ba,bac,bc->b", n, stress, n) for stress in (fields.kirchhoff, halves.kirchhoff)]
    return RadialStress(along[0], along[0] / J, along[1] / J, J, position)


@dataclass(frozen=True)
class RadialProfile:
    """Means over shells; shells without a block are left out."""

    r: Array
    """Mean r/R of the blocks of a shell (k,)."""
    mean: Array
    std: Array
    """Standard deviation within the shell (k,), 0 for blocks that are images of each other."""
    count: NDArray[np.int64]


def radial_profile(r: Array, values: Array, *, shells: int) -> RadialProfile:
    """Mean and scatter of ``values`` (b,) in equally thick ``shells`` of r/R from 0 to 1."""
    shell = np.minimum((r * shells).astype(int), shells - 1)
    count = np.bincount(shell, minlength=shells)
    there = count > 0
    n = count[there]
    place, mean, square = (np.bincount(shell, v, minlength=shells)[there] / n for v in (r, values, values**2))
    return RadialProfile(place, mean, np.sqrt(np.maximum(square - mean**2, 0.0)), n)


def core_over_rim(r: Array, values: Array) -> float | None:
    """Mean of ``values`` at r/R < 0.25, or of the innermost blocks if none is, over that at r/R > 0.75; None at 0."""
    core = r < max(_CORE, (1.0 + 1e-9) * r.min())
    rim = r > min(_RIM, (1.0 - 1e-9) * r.max())
    below = float(values[rim].mean())
    return float(values[core].mean()) / below if below else None


def ball_radius(midpoint: Array, edge: float) -> float | None:
    """Radius R (m) of the ball that cubes with these midpoints (b, 3) and ``edge`` (m) make up, None if it is none.

    R is that of a ball of the same volume. Of all bodies of one volume the ball has the least mean square distance
    from its middle, 3/5 R^2; a body within 6 % of it (a cube has 8 % more) is taken for one.
    """
    R = edge * np.cbrt(len(midpoint) * 0.75 / np.pi)
    square = ((midpoint - midpoint.mean(axis=0)) ** 2).sum(axis=1).mean() + 0.25 * edge**2
    return float(R) if square < 1.06 * 0.6 * R**2 else None


def shell_count(radius: float, edge: float) -> int:
    """Number of shells of a profile, each 0.625 blocks of this ``edge`` thick."""
    return max(3, round(1.6 * radius / edge))
