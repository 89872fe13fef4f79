"""Static equilibrium along a load path: adaptive steps, predictor, and a result that says how it went."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.structure import Structure
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.equilibrium.limit_point import LoadLine, find_limit
from tsg_micro.equilibrium.linear_solvers import Choice
from tsg_micro.equilibrium.members import MACRO, MemberState, MemberSystem
from tsg_micro.equilibrium.newton import Converged, Iteration, NewtonOptions, NewtonSolver
from tsg_micro.equilibrium.pressure import PressurisedSystem
from tsg_micro.equilibrium.surface import Surface
from tsg_micro.equilibrium.tangent import Border, Tangent

__all__ = ["Equilibrium", "EquilibriumSolver"]

Array = NDArray[np.float64]
_FEW = 5


@dataclass(frozen=True)
class Equilibrium:
    """A converged state and how it was reached."""

    displacement: Array
    """Nodal displacements (n, 3), m."""
    H: Array
    """Macroscopic displacement gradient (3, 3) of a periodic structure."""
    members: MemberState
    """Lengths, vectors and forces of all members."""
    energy: float
    """Stored energy, J."""
    reaction: Array
    """Forces (n, 3) that supports and constraints put on the nodes, N (round-off where there are none)."""
    macro_force: Array
    """Derivative of the energy by H (3, 3), J: V0 P for a body that is periodic along all three axes."""
    residual: float
    """Largest out-of-balance force over the mean member force."""
    iterations: int
    factorisations: int
    load_steps: int
    negative_pivots: int | None
    """Unstable directions at this state; None where its tangent was not factorised."""
    slack: int
    """Tendons without tension that are allowed to go slack."""
    solver: Choice
    history: tuple[Iteration, ...]
    """Every iteration of the load steps."""


class EquilibriumSolver:
    """Follows the equilibrium of one structure from load to load; starts at its reference geometry.

    ``fixed`` (n, 3) marks the displacements that are prescribed; all others are unknown. The macroscopic
    displacement gradient H is prescribed but for the directions in ``border``; it moves the members as ``levers`` say
    (:class:`MemberSystem`). A pressure can act on a closed ``surface``.
    """

    def __init__(
        self,
        structure: Structure,
        *,
        fixed: NDArray[np.bool_],
        border: Border | None = None,
        slack: bool = False,
        surface: Surface | None = None,
        levers: Array | None = None,
        options: NewtonOptions | None = None,
    ) -> None:
        """Raises InputError: ``fixed`` has another shape than the nodes, fixes all, or nothing where no border does."""
        fixed = np.asarray(fixed, dtype=bool)
        if fixed.shape != structure.nodes.shape:
            raise InputError(f"fixed: expected shape {structure.nodes.shape}, got {fixed.shape}")
        if fixed.all() or not (fixed.any() or (border is not None and len(border.constraint))):
            raise InputError("fixed: expected some displacements to be prescribed and some to be free")
        self.structure = structure
        self.system = (
            MemberSystem(structure, slack=slack, levers=levers)
            if surface is None
            else PressurisedSystem(structure, surface, slack=slack)
        )
        self.newton = NewtonSolver(self.system, ~fixed.ravel(), border=border, options=options or NewtonOptions())
        self.y = np.zeros(self.system.size)
        self.force = np.zeros(self.system.nodal_size)
        self._fixed = np.append(fixed.ravel(), np.ones(MACRO, dtype=bool))
        self._tangent: Tangent | None = None
        self._expected: Array | None = None

    def move_to(self, y: Array, force: Array) -> None:
        """Go to the unknowns ``y`` and nodal forces of an equilibrium that was reached before."""
        self.y, self.force, self._tangent = y.copy(), force.copy(), None

    def tangent(self) -> Tangent:
        """The factorised tangent of the present state; valid until the next solve."""
        if self._tangent is None:
            self._tangent = self.newton.tangent(self.system.state(self.y))
        return self._tangent

    def expect(self, change: Array) -> None:
        """The next solve's load changes all unknowns by ``change`` (3n + 9,) along the tangent: no need to find out."""
        self._expected = change

    def solve(
        self,
        *,
        displacement: Array | None = None,
        H: Array | None = None,
        force: Array | None = None,
        pressure: float | None = None,
        steps: int = 1,
        stable: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> Equilibrium:
        """Follow the equilibrium to prescribed displacements (n, 3) in m, H (3, 3), nodal forces (n, 3) in N, and to a
        ``pressure`` in Pa that follows the surface.

        What is not given keeps its present value. The load moves along a straight line, in ``steps`` parts at first:
        a part that does not converge is halved, parts that converge fast grow. The first guess of a part goes along
        the tangent (see :meth:`expect`), later ones along the last part. With ``stable`` the tangent of the result is
        factorised and has no negative pivots but for motions that change no energy, and :meth:`tangent` costs nothing
        more; without it the last equilibrium is not checked, though iterates that are out of balance leave unstable
        states all the same.

        Raises:
            InputError: a shape or a value is not valid.
            ConvergenceError: ``smallest_part`` of a part did not converge; the solver stays at its last equilibrium,
                and the text says whether the path turns back there, at a limit point of the load.
        """
        expected, self._expected = self._expected, None
        if steps < 1:
            raise InputError(f"steps: expected at least 1, got {steps}")
        goal, goal_force = self._goal(displacement, H, force)
        change, change_force = np.where(self._fixed, goal - self.y, 0.0), goal_force - self.force
        start_force, start_pressure = self.force, self.system.pressure
        change_pressure = self._goal_pressure(pressure) - start_pressure
        history: list[Iteration] = []
        before = self.newton.factorisations
        load, part, accepted = 0.0, 1.0 / steps, 0
        rate = None if expected is None else np.where(self._fixed, change, expected)
        while True:
            part = part if load + part < 1.0 - 1e-9 else 1.0 - load
            if rate is None:
                rate = self._tangent_rate(self.y, self.tangent(), change, change_force, change_pressure)
            try:
                self.system.pressure = start_pressure + (load + part) * change_pressure
                result = self.newton.solve(
                    self.y + part * rate,
                    start_force + (load + part) * change_force,
                    load=load + part,
                    history=history,
                    stable=stable and load + part >= 1.0,
                )
            except ConvergenceError as error:
                self._tangent, rate, part = None, None, 0.5 * part
                self.system.pressure = start_pressure + load * change_pressure
                if part < self.newton.options.smallest_part / steps:
                    line = self._line(start_force, change_force, start_pressure, change_pressure, change)
                    limit = find_limit(self.newton, line, self.y, load, 2.0 * part)
                    self.system.pressure, self._tangent = start_pressure + load * change_pressure, None
                    turn = (
                        "no limit point was found"
                        if limit is None
                        else f"the path turns back at {limit:.2%}, a limit point"
                    )
                    text = (
                        f"stopped at {load:.2%} of the load, where a part of {2.0 * part:.1e} failed ({turn}); {error}"
                    )
                    raise ConvergenceError(text, history) from None
                continue
            rate = (result.y - self.y) / part
            self.y, self._tangent = result.y, result.tangent
            load, accepted = load + part, accepted + 1
            self.force = start_force + load * change_force
            if progress:
                progress(load)
            if load >= 1.0:
                break
            if result.iterations <= _FEW:
                part = min(1.5 * part, 1.0)
        return self._reached(result, before, accepted, history)

    def _reached(self, result: Converged, before: int, accepted: int, history: list[Iteration]) -> Equilibrium:
        """The equilibrium where the solver is now, after ``accepted`` parts; it had made ``before`` factorisations."""
        negative = result.tangent.negative_pivots if result.tangent else None
        m = self.system.nodal_size
        balance = result.gradient + self.newton.border.constraint.T @ result.multipliers
        return Equilibrium(
            displacement=self.y[:m].reshape(-1, 3).copy(),
            H=self.y[m:].reshape(3, 3).copy(),
            members=result.state,
            energy=self.system.energy(result.state),
            reaction=(result.gradient[:m] - self.force).reshape(-1, 3),
            macro_force=balance[m:].reshape(3, 3),
            residual=result.residual,
            iterations=len(history),
            factorisations=self.newton.factorisations - before,
            load_steps=accepted,
            negative_pivots=negative,
            slack=int((result.state.stiffness == 0.0).sum()),
            solver=self.newton.choice,
            history=tuple(history),
        )

    def _goal(self, displacement: Array | None, H: Array | None, force: Array | None) -> tuple[Array, Array]:
        """Prescribed values and forces to reach, checked."""
        m, goal, goal_force = self.system.nodal_size, self.y.copy(), self.force
        shape = self.structure.nodes.shape
        for name, value, expected in (("displacement", displacement, shape), ("force", force, shape), ("H", H, (3, 3))):
            if value is not None and (np.shape(value) != expected or not np.isfinite(value).all()):
                raise InputError(f"{name}: expected finite numbers of shape {expected}, got shape {np.shape(value)}")
        if displacement is not None:
            goal[:m] = np.asarray(displacement, dtype=float).ravel()
        if H is not None:
            if not np.linalg.det(np.eye(3) + H) > 0.0:
                raise InputError("H: expected det(1 + H) > 0, the body would be turned inside out")
            goal[m:] = np.asarray(H, dtype=float).ravel()
        if force is not None:
            goal_force = np.asarray(force, dtype=float).ravel()
        return goal, goal_force

    def _goal_pressure(self, pressure: float | None) -> float:
        """Pressure to reach, checked."""
        if pressure is None:
            return self.system.pressure
        if not np.isfinite(pressure) or not isinstance(self.system, PressurisedSystem):
            raise InputError(f"pressure: expected a finite number, and a surface for it to act on, got {pressure}")
        return float(pressure)

    def _line(self, start: Array, force: Array, start_pressure: float, pressure: float, change: Array) -> LoadLine:
        """The load as it grows from its start."""

        def press(s: float) -> None:
            self.system.pressure = start_pressure + s * pressure

        return LoadLine(start, force, lambda y, tangent: self._tangent_rate(y, tangent, change, force, pressure), press)

    def _tangent_rate(
        self, y: Array, tangent: Tangent, change: Array, change_force: Array, change_pressure: float
    ) -> Array:
        """Derivative of all unknowns by the load at the unknowns ``y``, where the tangent is ``tangent``."""
        if not (change_pressure or change.any() or change_force.any()):
            return change
        newton, m, border = self.newton, self.system.nodal_size, self.newton.border
        state = self.system.state(y)
        product = self.system.tangent_product(state, change[:, None])[:, 0]
        if change_pressure and isinstance(self.system, PressurisedSystem):
            product += change_pressure * self.system.volume_gradient(state)
        nodal = (change_force - product[:m])[newton.free]
        rest = np.concatenate([-border.macro.T @ product[m:], -border.constraint @ change])
        dx, dz = tangent.solve(nodal, rest)
        rate = change.copy()
        rate[newton.free] = dx
        rate[m:] += border.macro @ dz[: border.macro.shape[1]]
        return rate
