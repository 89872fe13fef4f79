"""The spheroid of the paper's Section 3.3: its blocks, its prestress, its surface, and what is kept of its states."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import lattice, spheroid_cells
from tsg_micro.cells.parameters import CellParameters, check_bar_force
from tsg_micro.cells.prestress import force_density_of_owners, prestressed
from tsg_micro.cells.structure import Structure, member_vectors
from tsg_micro.continuum.radial_profiles import RadialStress, bar_force_profile, block_radius, radial_stress
from tsg_micro.data.errors import InputError
from tsg_micro.data.measured import Column, read_numbers
from tsg_micro.equilibrium.load_path import Equilibrium
from tsg_micro.equilibrium.surface import Surface, enclosed_volume, outer_surface

__all__ = ["Record", "Spheroid", "build_spheroid", "record_state"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spheroid:
    """The prestressed body."""

    structure: Structure
    surface: Surface
    radius: float
    """R, m."""
    r: Array
    """Reference r/R of the blocks (b,)."""
    bar_force: Array
    """Of the blocks (b,), N."""
    prestress: Array
    """Force at rest that each of its cells gives a member (m, 2), N."""

    @property
    def height(self) -> float:
        """Of a cell, m."""
        return float(self.structure.size[0] / (np.ptp(self.structure.cells[:, 0]) + 1))

    @property
    def shells(self) -> int:
        """Number of shells of a profile, each 0.625 blocks thick."""
        return max(3, round(0.8 * self.radius / self.height))


@dataclass(frozen=True)
class Record:
    """The equilibrium at one level of the load."""

    level: float
    state: Equilibrium
    stress: RadialStress
    volume: float
    """Enclosed by the surface, m^3."""


def build_spheroid(*, radius: float, f_max: float, profile: str, decay: float, cell: CellParameters) -> Spheroid:
    """The body of all blocks within ``radius`` blocks, its bar force by ``profile``: a name, or a CSV file.

    Raises:
        InputError: an argument is not valid.
    """
    body = lattice(spheroid_cells(radius), cell)
    R = 2.0 * radius * cell.height
    r = block_radius(body, R)
    if profile.lower().endswith(".csv"):
        check_bar_force(f_max, cells=1, EA_bar=cell.EA_bar)
        force = f_max * _read_profile(Path(profile), r)
    else:
        force = bar_force_profile(r, profile=profile, f_max=f_max, decay=decay)
    of_cells = force[body.cell_block]
    length = np.linalg.norm(member_vectors(body), axis=1)
    prestress = force_density_of_owners(body, cell, of_cells) * length[:, None]
    return Spheroid(prestressed(body, cell, of_cells), outer_surface(body), R, r, force, prestress)


def _read_profile(path: Path, r: Array) -> Array:
    """f/f_max at r (b,), from the columns r_over_R and f_over_fmax, straight between the points and level beyond."""
    names = ("r_over_R", "f_over_fmax")
    columns = read_numbers(path, {name: Column(name, "1") for name in names})
    at, value = (columns[name] for name in names)
    if (np.diff(at) <= 0.0).any() or at[0] < 0.0:
        raise InputError(f"profile {path}: expected r_over_R from 0 upwards, rising from line to line")
    if not ((value > 0.0) & (value <= 1.0)).all():
        raise InputError(
            f"profile {path}: expected f_over_fmax above 0 and at most 1, got {value.min()} to {value.max()}"
        )
    return np.interp(r, at, value)


def record_state(body: Spheroid, level: float, state: Equilibrium) -> Record:
    """What is kept of an equilibrium."""
    stress = radial_stress(body.structure, state.displacement, state.members, body.prestress)
    return Record(level, state, stress, enclosed_volume(body.surface, body.structure.nodes + state.displacement))
