"""A body that is held and loaded, on a mesh; there is no material in it."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dd_macro.parallel import total
from dd_macro.scene.boundary import Displacement, free_motions, prescribed_displacement, side_dofs
from dd_macro.scene.loads import Load, nodal_forces
from dd_macro.scene.pressure import Following
from dd_macro.scene.regions import Regions
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.display import Displayed
from tsg_micro.data.errors import InputError

__all__ = ["Problem"]

Array = NDArray[np.float64]
_BALANCED = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Problem(Displayed):
    """Mesh and spaces, what is held, and what pulls; checked when made, which is collective.

    ``fixed`` is the mask of the prescribed displacement components, ``prescribed`` their values in m, and ``forces`` in
    N the f of the equations at rest, all of the unknowns that this rank owns: (3 * nodes,), or more
    (EnhancedStrainOperator); they are of the part ``factor`` of the load. Loads that follow the body (Following) do so
    where strain is finite. ``free`` bodies have the rigid motions that their supports leave, ``motions``
    (k, 3 * nodes), held in the mean; their loads must be in balance.

    Raises:
        InputError: on construction, where supports or loads are not valid, a rigid-body motion is left that is not
            ``free``, or the loads of a free body are not in balance.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))])
        >>> law = dd.LinearLaw(1e3 * np.eye(6))
        >>> solution = dd.LawMethod().prepare(problem, dd.Material(law=law)).solve()
        >>> bool(abs(solution.reaction("top") + solution.reaction("bottom")).max() < 1e-15)
        True
    """

    operator: StrainOperator
    supports: Sequence[Displacement]
    loads: Sequence[Load] = ()
    regions: Regions | None = None
    """Of cells whose material differs; None where it is one."""
    free: bool = False
    factor: float = field(init=False, default=1.0)
    fixed: NDArray[np.bool_] = field(init=False, repr=False)
    prescribed: Array = field(init=False, repr=False)
    forces: Array = field(init=False, repr=False)
    motions: Array = field(init=False, repr=False)
    whole: Problem | None = field(init=False, repr=False, default=None)
    """That under the whole load; None where it is this one."""

    def __post_init__(self) -> None:
        _check_kinds(self)
        fixed, prescribed = prescribed_displacement(self.operator, self.supports)
        motions = free_motions(self.operator, fixed, allowed=self.free)
        forces = nodal_forces(self.operator, self.loads)
        if len(motions):
            _check_balance(self.operator, motions, forces)
        found = {"fixed": fixed, "prescribed": prescribed, "forces": forces, "motions": motions}
        for name, array in found.items():
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def _display(self) -> tuple[str, dict[str, object]]:
        operator = self.operator
        under = "" if self.factor == 1.0 else f", under {self.factor:g} of the load"
        return f"Problem: {operator.domain.global_cells} hexahedra, {operator.theory} strain{under}", {
            "unknowns": operator.global_dofs,
            "supports": ", ".join(
                f"{one.name} in {' '.join('xyz'[i] for i in one.components)}" for one in self.supports
            ),
            "loads": ", ".join(type(load).__name__ for load in self.loads),
            "regions": "" if self.regions is None else len(self.regions.places),
            "free": "rigid motions are held in the mean" if self.free else "",
        }

    def at(self, factor: float) -> Problem:
        """The same under the part ``factor`` of the whole load."""
        whole = self.whole or self
        if factor == 1.0:
            return whole
        scaled = copy.copy(whole)
        parts = {"prescribed": factor * whole.prescribed, "forces": factor * whole.forces}
        for name, value in {"factor": factor, "whole": whole, **parts}.items():
            object.__setattr__(scaled, name, value)
        return scaled

    @property
    def following(self) -> tuple[Following, ...]:
        """The loads whose forces depend on the displacement."""
        if self.operator.theory == "small":
            return ()
        return tuple(load for load in self.loads if isinstance(load, Following))

    def forces_at(self, u: Array) -> Array:
        """f in N of the unknowns where these are u, in m; collective."""
        following = self.following
        if not following:
            return self.forces
        forces = np.array(self.forces)
        nodal = forces[: 3 * self.operator.owned_nodes]
        for load in following:
            nodal += self.factor * (load.forces_at(self.operator, u) - self._at_rest(load))
        return forces

    def add_load_stiffness(self, u: Array, matrix: PETSc.Mat) -> None:
        """Add minus the derivative of the forces by u to the assembled nodal ``matrix``; collective."""
        following = self.following
        for load in following:
            load.add_stiffness(self.operator, u, matrix, self.factor)
        if following:
            matrix.assemble()

    def _at_rest(self, load: Following) -> Array:
        return load.forces_at(self.operator, np.zeros(3 * self.operator.owned_nodes))

    @property
    def region_of_points(self) -> NDArray[np.int64]:
        """The region of every quadrature point (n,), 0 where there are no regions."""
        if self.regions is None:
            return np.zeros(len(self.operator.weights), dtype=np.int64)
        return self.regions.points(self.operator.points_per_cell)

    def out_of_balance(self, stress: Array, u: Array | None = None) -> Array:
        """Internal minus external forces in N on the unknowns, of the stress of the equations, (n, 6) or (n, 9).

        Loads that follow the body are where u (of all unknowns, in m) has moved them, at rest if None.
        """
        return self.operator.force(stress) - (self.forces if u is None else self.forces_at(u))

    def residual(self, stress: Array, u: Array | None = None, *, floor: float = 0.0) -> float:
        """Norm of :meth:`out_of_balance` on the free components, relative to that of all nodal forces.

        It relates to ``floor`` (N) at least: a body that is unloaded has no forces but round-off.
        """
        force, loads = self.operator.force(stress), self.forces if u is None else self.forces_at(u)
        out = np.where(self.fixed, 0.0, force - loads)
        squares = total(self.operator.comm, [out @ out, force @ force + loads @ loads])
        return float(np.sqrt(squares[0] / (squares[1] + floor**2))) if squares[1] != 0 else 0.0

    def support_force(self, side: str | tuple[str, ...], out_of_balance: Array) -> Array:
        """Force (3,) in N that the supports of ``side`` exert on the body.

        Raises:
            InputError: no such side.
        """
        nodal = out_of_balance[: 3 * self.operator.owned_nodes].reshape(-1, 3)
        return total(self.operator.comm, nodal[side_dofs(self.operator, side)].sum(axis=0))


def _check_kinds(problem: Problem) -> None:
    """Raise InputError where an argument is of another kind, as one support in place of a list of them."""
    if not isinstance(problem.operator, StrainOperator):
        raise InputError(
            f"operator: expected a StrainOperator, as of dd.StrainOperator(mesh), got {type(problem.operator).__name__}"
        )
    for name, given, wanted in (
        ("supports", problem.supports, "dd.Displacement"),
        ("loads", problem.loads, "loads, as dd.Traction"),
    ):
        if not isinstance(given, Sequence):
            raise InputError(f"{name}: expected a list of {wanted}, got {type(given).__name__}")
        for one in given:
            if not (isinstance(one, Displacement) if name == "supports" else hasattr(one, "nodal_forces")):
                raise InputError(f"{name}: expected a list of {wanted}, got {type(one).__name__} in it")


def _check_balance(operator: StrainOperator, motions: Array, forces: Array) -> None:
    """Raise InputError, on all ranks, where forces do work on the free rigid motions."""
    nodal = forces[: 3 * operator.owned_nodes]
    work = total(operator.comm, np.append(motions @ nodal, nodal @ nodal))
    if np.linalg.norm(work[:-1]) > _BALANCED * np.sqrt(work[-1]):
        x = operator.node_coordinates()
        each = nodal.reshape(-1, 3)
        force = total(operator.comm, each.sum(axis=0))
        moment = total(operator.comm, np.cross(x, each).sum(axis=0))
        numbers = " ".join(f"{value:.3g}" for value in force), " ".join(f"{value:.3g}" for value in moment)
        raise InputError(
            "loads: expected some in balance on a body that is free in space, got a resultant of "
            f"({numbers[0]}) N and a moment of ({numbers[1]}) N m; hold a side of it"
        )
