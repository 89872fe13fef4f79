"""A body of blocks with its supports and loads, followed from rest along factors of the load.

What acts: displacements that are prescribed, dead nodal forces, and one pressure on the whole outer surface. That one
follows the surface and is conservative (tsg_micro.equilibrium.surface). On a part of the surface it would not be, so
there a pressure is a dead traction along the normals at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tsg_micro.bodies.voxel_body import BlockBody
from tsg_micro.cells.structure import Structure
from tsg_micro.data.errors import InputError
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver
from tsg_micro.equilibrium.members import MACRO, MemberState
from tsg_micro.equilibrium.newton import NewtonOptions
from tsg_micro.equilibrium.rigid import free_motions, rigid_border, rigid_motions
from tsg_micro.equilibrium.surface import enclosed_volume, outer_surface

__all__ = ["LoadedBody", "VoxelLoads"]

Array = NDArray[np.float64]
_BALANCED = 1e-6
"""Of all forces, what their resultant may be on a body that is free."""
_HELD = 1e-9


@dataclass(frozen=True)
class VoxelLoads:
    """What acts on a body at the factor 1."""

    fixed: NDArray[np.bool_]
    """Which displacements are prescribed (n, 3)."""
    displacement: Array
    """Their values (n, 3), m."""
    force: Array
    """Dead nodal forces (n, 3), N."""
    pressure: float = 0.0
    """On the whole outer surface, which it follows, Pa, positive from outside."""


class LoadedBody:
    """A body and where it stands on the path of its load; it begins at rest, and every equilibrium is stable.

    With ``free`` the rigid motions that the supports leave free are held by means over all nodes, which need no force
    as long as the loads have no resultant along them.
    """

    def __init__(self, body: BlockBody, loads: VoxelLoads, *, free: bool = False, linear_solver: str = "auto") -> None:
        """Raises InputError: a body that is free to move, or in parts, or loads that would move it, or bad shapes."""
        structure = body.structure
        _check_parts(structure, loads.fixed)
        motions = free_motions(structure, loads.fixed)
        if len(motions) and not free:
            raise InputError(
                f"supports: expected no rigid motion left free, got {len(motions)} of 6; hold more, or declare it free"
            )
        _check_balance(structure, loads.force, motions)
        self.body, self.loads = body, loads
        self.surface = outer_surface(structure) if loads.pressure else None
        self.solver = EquilibriumSolver(
            structure,
            fixed=loads.fixed,
            border=rigid_border(structure, loads.fixed) if len(motions) else None,
            surface=self.surface,
            options=NewtonOptions(linear_solver=linear_solver),
        )

    @property
    def dofs(self) -> int:
        """Number of unknowns."""
        return self.solver.newton.pattern.size

    def resume(self, displacement: Array, factor: float) -> None:
        """Go to an equilibrium (n, 3) that was reached before, at this factor of the load."""
        self.solver.move_to(np.append(displacement, np.zeros(MACRO)), factor * self.loads.force.ravel())
        self.solver.system.pressure = factor * self.loads.pressure

    def load(self, factor: float) -> Equilibrium:
        """Follow the equilibrium to this factor of displacements, forces and pressure.

        Raises:
            ConvergenceError: the equilibrium was lost.
        """
        return self.solver.solve(
            displacement=factor * self.loads.displacement,
            force=factor * self.loads.force,
            pressure=None if self.surface is None else factor * self.loads.pressure,
            stable=True,
        )

    @property
    def displacement(self) -> Array:
        """Of the nodes (n, 3), where the body stands, m."""
        return self.solver.y[:-MACRO].reshape(-1, 3)

    @property
    def members(self) -> MemberState:
        """Of all members, where the body stands."""
        return self.solver.system.state(self.solver.y)

    def forces_of_supports(self) -> Array:
        """Forces (n, 3) that supports put on the nodes where the body stands, N; round-off at nodes without one."""
        system = self.solver.system
        gradient = system.gradient(system.state(self.solver.y))[: system.nodal_size]
        return np.asarray((gradient - self.solver.force).reshape(-1, 3))

    def enclosed_volume_change(self) -> float | None:
        """Of the volume inside the surface that a pressure follows, over that at rest; None where there is none."""
        if self.surface is None:
            return None
        rest = self.body.structure.nodes
        return enclosed_volume(self.surface, rest + self.displacement) / enclosed_volume(self.surface, rest) - 1.0

    def stored_energy(self) -> float:
        """Of the members, where the body stands, J."""
        system = self.solver.system
        return system.law.energy(self.members.length, system.rest_length, system.material)


def _check_parts(structure: Structure, fixed: NDArray[np.bool_]) -> None:
    """Raise InputError where the body is in several parts of which one is free to move."""
    n = len(structure.nodes)
    i, j = structure.members.T
    parts, part = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
    if parts == 1:
        return
    modes = rigid_motions(structure)
    for number in range(parts):
        own = part == number
        seen = (modes[:, own] * fixed[own]).reshape(6, -1)
        size = (modes[:, own] ** 2).reshape(6, -1)
        if np.linalg.matrix_rank(seen @ seen.T / size.sum(), tol=_HELD, hermitian=True) < 6:
            raise InputError(f"blocks: expected one connected body, or all parts held, got {parts} parts, one not held")


def _check_balance(structure: Structure, force: Array, motions: Array) -> None:
    """Raise InputError where dead forces (n, 3) push the body along its free motions (k, 6)."""
    X = structure.nodes - structure.nodes.mean(axis=0)
    gyration = np.sqrt((X**2).sum(axis=1).mean())
    along = motions.T @ (motions @ np.tensordot(rigid_motions(structure), force, axes=2))
    if (np.abs(along) > _BALANCED * np.abs(force).sum()).any():
        push, turn = (", ".join(f"{value:.3g}" for value in part) for part in (along[:3], gyration * along[3:]))
        raise InputError(
            "loads: expected no resultant along what the supports leave free, "
            f"got a force of ({push}) N and a moment of ({turn}) N m about the middle of the body"
        )
