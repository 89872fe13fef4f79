"""The spheroid of the paper's Section 3.3: blocks prestressed towards their core, under pressure or shrunk."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import spheroid_cells
from tsg_micro.cells.prestress import force_density_of_owners, prestressed
from tsg_micro.cells.structure import Structure, member_vectors
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.radial_profiles import (
    RadialProfile,
    RadialStress,
    bar_force_profile,
    block_radius,
    core_over_rim,
    radial_profile,
    radial_stress,
    shell_count,
)
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.table import Column, read_numbers
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver
from tsg_micro.equilibrium.newton import NewtonOptions
from tsg_micro.equilibrium.rigid import rigid_border
from tsg_micro.equilibrium.surface import Surface, enclosed_volume, outer_surface
from tsg_micro.equilibrium.tangent import lowest_stiffness

__all__ = [
    "LOADS",
    "Compression",
    "Spheroid",
    "SpheroidState",
    "build_spheroid",
    "check_spheroid_load",
    "compress_spheroid",
]

Array = NDArray[np.float64]
LOADS = {"pressure": "Pa", "displacement": "1"}
"""Load to the unit of its level: a pressure that follows the surface, or a displacement of the surface to the middle,
over the distance from it."""


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

    def profile(self, values: Array) -> RadialProfile:
        """Mean and scatter of ``values`` (b,) over shells."""
        return radial_profile(self.r, values, shells=self.shells)

    @property
    def shells(self) -> int:
        """Number of shells of a profile, each 0.625 blocks thick."""
        return shell_count(self.radius, 2.0 * self.structure.height)


def build_spheroid(tissue: Tissue, *, radius: float, profile: str, decay: float) -> Spheroid:
    """The body of all blocks within ``radius`` blocks, of this tissue at its centre.

    Towards the rim its bar force follows ``profile``: exponential, linear or constant, or a CSV file.

    Raises:
        InputError: an argument is not valid.

    Example:
        >>> body = tsg.build_spheroid(tsg.Tissue(bar_force=5e-8), radius=2, profile="exponential", decay=2.0)
        >>> (1e9 * np.unique(body.bar_force.round(11))).round(2)
        array([ 9.52, 21.03])
    """
    cell = tissue.cell
    body = tissue.lattice(spheroid_cells(radius))
    R = 2.0 * radius * cell.height
    r = block_radius(body, R)
    if profile.lower().endswith(".csv"):
        force = tissue.bar_force * _read_profile(Path(profile), r)
    else:
        force = bar_force_profile(r, profile=profile, f_max=tissue.bar_force, decay=decay)
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


@dataclass(frozen=True)
class SpheroidState:
    """The equilibrium at one level of the load."""

    level: float
    state: Equilibrium
    stress: RadialStress
    volume: float
    """Enclosed by the surface, m^3."""

    @property
    def mean_pressure(self) -> float:
        """-tr / 3 of the mean Cauchy stress over the enclosed volume, Pa; under a pressure that pressure itself."""
        members = self.state.members
        return float(-(members.force * members.length).sum() / (3.0 * self.volume))


@dataclass(frozen=True)
class Compression:
    """A spheroid and how far its load went."""

    body: Spheroid
    load: str
    records: list[SpheroidState]
    """At rest and at every level that was reached."""
    reason: str
    """Why it ended there."""
    solver: EquilibriumSolver

    def lowest_stiffness(self) -> float:
        """Of the last equilibrium, N/m."""
        return lowest_stiffness(self.solver.tangent())

    def core_over_rim(self, stress: str = "cauchy") -> list[float | None]:
        """Radial ``stress``, a field of RadialStress, of the core over that of the rim, at every level after rest."""
        return [core_over_rim(self.body.r, getattr(record.stress, stress)) for record in self.records[1:]]


def compress_spheroid(
    body: Spheroid,
    load: str,
    levels: Array,
    *,
    linear_solver: str = "auto",
    say: Callable[[str], None] = lambda text: None,
    progress: Callable[[int], None] = lambda done: None,
) -> Compression:
    """Follow the equilibrium of ``body`` from rest through rising ``levels`` (k,) of the load, each one stable.

    A ``pressure`` is in Pa and follows the surface; a ``displacement`` of it is over the distance from the centre.
    ``progress`` is told how many levels are done.

    Where it is lost it ends with what was reached.

    Raises:
        InputError: the load is not known.
    """
    begin = time.perf_counter()
    solver = _solver(body, load, linear_solver)
    say(f"{solver.newton.pattern.size} unknowns, {solver.newton.choice.backend} ({solver.newton.choice.reason})")
    records, reason = [_record(body, 0.0, solver.solve(stable=True))], "the level asked for"
    for start, goal in zip([0.0, *levels[:-1]], levels, strict=True):
        reached, lost = _advance(solver, body, load, (float(start), float(goal)))
        if reached:
            records.append(_record(body, *reached))
            say(_words(load, records, time.perf_counter() - begin))
            progress(len(records) - 1)
        if lost:
            reason = lost
            say(f"stopped: {lost}")
            break
    return Compression(body, load, records, reason, solver)


def _words(load: str, records: list[SpheroidState], seconds: float) -> str:
    """The last level that was reached."""
    last = records[-1]
    return (
        f"{load} {last.level:.4g}: volume {last.volume / records[0].volume:.4f}, {last.state.iterations} iterations, "
        f"{last.state.negative_pivots} negative pivots, {seconds:.0f} s"
    )


def check_spheroid_load(load: str) -> None:
    """Raise InputError where the load is not known."""
    if load not in LOADS:
        raise InputError(f"load: expected one of {', '.join(LOADS)}, got {load!r}")


def _solver(body: Spheroid, load: str, linear_solver: str) -> EquilibriumSolver:
    """A solver of the free body under pressure, or of the one whose surface is prescribed."""
    check_spheroid_load(load)
    options = NewtonOptions(max_iterations=25, smallest_part=1.0 / 16.0, linear_solver=linear_solver)
    fixed = np.zeros(body.structure.nodes.shape, dtype=bool)
    if load == "pressure":
        border = rigid_border(body.structure)
        return EquilibriumSolver(body.structure, fixed=fixed, border=border, surface=body.surface, options=options)
    fixed[body.surface.nodes] = True
    return EquilibriumSolver(body.structure, fixed=fixed, options=options)


def _advance(
    solver: EquilibriumSolver, body: Spheroid, load: str, levels: tuple[float, float]
) -> tuple[tuple[float, Equilibrium] | None, str]:
    """Go from one level to the next: the level reached with its equilibrium, if any is new, and why it was lost."""
    start, goal = levels
    done = [0.0]
    try:
        if load == "pressure":
            return (goal, solver.solve(pressure=goal, stable=True, progress=done.append)), ""
        centred = body.structure.nodes - body.structure.nodes.mean(axis=0)
        moved = np.zeros_like(centred)
        moved[body.surface.nodes] = -goal * centred[body.surface.nodes]
        return (goal, solver.solve(displacement=moved, stable=True, progress=done.append)), ""
    except ConvergenceError as error:
        lost = str(error)
    if done[-1] == 0.0:
        return None, lost
    try:  # the last equilibrium on the way, if it is stable
        return (start + done[-1] * (goal - start), solver.solve(stable=True)), lost
    except ConvergenceError:
        return None, lost


def _record(body: Spheroid, level: float, state: Equilibrium) -> SpheroidState:
    """What is kept of an equilibrium."""
    stress = radial_stress(body.structure, state.displacement, state.members, body.prestress)
    return SpheroidState(level, state, stress, enclosed_volume(body.surface, body.structure.nodes + state.displacement))
