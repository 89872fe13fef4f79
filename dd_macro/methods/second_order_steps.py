"""One step of the second-order solve: from given tangent spaces to the nearest state of the constraint set.

Alternating projections onto constraint set and tangent spaces lower 1/2 |z - P z|^2, P the projection onto the tangent
spaces: a quadratic function on the constraint set, and they are its steepest descent with step 1. Conjugate gradients
take the same projections, one matrix for all of them, lower the distance in every step too, and need about the root of
their number. Local tangents are solved with K = sum w B^T sym(D_i) B, factorised anew in every step.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro.material.tangent_spaces import SpaceProjection, TangentSpaces
from dd_macro.methods.finite_projection import state_on
from dd_macro.methods.points import Iteration
from dd_macro.methods.projection import MechanicalState, Projection
from dd_macro.parallel import total
from dd_macro.scene.kinematics import Kinematics
from dd_macro.scene.linear import LinearSolver
from tsg_micro.data.errors import ConvergenceError

__all__ = ["AlternatingStep", "FiniteTangentStep", "LocalTangentStep", "Step", "StepRecord"]

Array = NDArray[np.float64]
_log = logging.getLogger(__name__)

_FORCING = 0.1  # part of the distance that alternating projections leave before the data are looked up again
_BALANCE, _ROUGH = 1e-10, 1e-4  # out-of-balance force of a solution, and of one on the way, relative to all forces
_INEXACT = 1e-3  # of Newton's direction, where an older factorisation finds it
_CORRECTIONS = 50
_HALVINGS = 8


class StepRecord:
    """The iterations so far, and lengths in the metric of the scene.

    Args:
        projection: the scene.
        max_iterations: one more is an error.
        progress: called with the number of the iteration and its record.
    """

    def __init__(
        self, projection: Projection, max_iterations: int, progress: Callable[[int, Iteration], None] | None
    ) -> None:
        self.projection, self.max_iterations, self._progress = projection, max_iterations, progress
        self.history: list[Iteration] = []

    def size(self, strain: Array, stress: Array) -> float:
        """Length in sqrt(J) of a field of strain (n, 6) and stress (n, 6) in Pa."""
        operator = self.projection.operator
        squares = self.projection.metric.squares(strain, stress)
        return float(np.sqrt(total(operator.comm, operator.weights @ squares)))

    def add(self, distance: float, changed: int, search: float, clock: float) -> None:
        """One iteration; ``search`` in seconds, ``clock`` when it began.

        Raises:
            ConvergenceError: there were ``max_iterations`` already.
        """
        history = self.history
        if len(history) >= self.max_iterations:
            raise ConvergenceError(
                f"second-order iteration: expected convergence within {self.max_iterations} iterations; "
                f"{history[-1].changed} data changed in the last one, distance {history[-1].distance:.4g} sqrt(J)"
            )
        history.append(Iteration(1.0, distance, changed, search, time.perf_counter() - clock))
        _log.info("iteration %d: distance %.6e, %d changed", len(history), distance, changed)
        if self._progress is not None:
            self._progress(len(history), history[-1])


class Step(Protocol):
    """From state z to the state nearest to ``spaces``; ``changed`` data and ``search`` seconds are for the record.

    ``exact``: it goes to within a thousandth of the way at least, all of it where ``final``. ``linear`` is the last
    solver of local tangents.
    """

    exact: bool
    record: StepRecord
    linear: LinearSolver | None

    def __call__(
        self, z: MechanicalState, spaces: TangentSpaces, *, changed: int, search: float, final: bool
    ) -> MechanicalState:
        """The new state.

        Raises:
            ConvergenceError: it was not found.
        """


class AlternatingStep:
    """Projections in turn, as conjugate gradients; ``tolerance`` of the gradient is relative to the state."""

    exact = False

    def __init__(self, record: StepRecord, tolerance: float) -> None:
        self.record, self.tolerance = record, tolerance
        self.linear: LinearSolver | None = None

    def __call__(
        self, z: MechanicalState, spaces: TangentSpaces, *, changed: int, search: float, final: bool
    ) -> MechanicalState:
        """The state where the distance is least, or is a tenth of what it was if not ``final``."""
        record, projection = self.record, self.record.projection
        clock = time.perf_counter()
        onto = SpaceProjection(spaces, projection.metric)
        z = projection.project(*onto.closest(z.strain, z.stress))  # on the constraint set, wherever it came from
        e, s = z.strain, z.stress
        near = onto.closest(e, s)
        off_e, off_s = e - near[0], s - near[1]
        begin = distance = record.size(off_e, off_s)
        goal = self.tolerance * record.size(e, s)
        record.add(distance, changed, search, clock)
        p_e, p_s, before = np.zeros_like(e), np.zeros_like(s), np.inf
        while True:
            clock = time.perf_counter()
            z = projection.project(e - off_e, s - off_s)
            down_e, down_s = z.strain - e, z.stress - s  # the negative gradient
            slope = record.size(down_e, down_s) ** 2
            if slope <= goal**2 or not (final or distance > _FORCING * begin):
                return z
            p_e, p_s = down_e + slope / before * p_e, down_s + slope / before * p_s
            along_e, along_s = onto.along(p_e, p_s)
            turn_e, turn_s = p_e - along_e, p_s - along_s
            step = slope / record.size(turn_e, turn_s) ** 2
            e, s, off_e, off_s = e + step * p_e, s + step * p_s, off_e + step * turn_e, off_s + step * turn_s
            before, distance = slope, record.size(off_e, off_s)
            record.add(distance, 0, 0.0, clock)


class LocalTangentStep:
    """Equilibrium on the tangent spaces; PETSc options of the solver have the prefix ``dd_tangent_``.

    The matrix is symmetric: the skew part of tangents, as those of the Cauchy stress have, and the round-off go into
    corrections that need no new factorisation. The first one is that of the projection, as long as it will do.
    """

    exact = True

    leave = 0.0
    """Part of the out-of-balance force that a step on the way may leave; not less than is rough anyway."""

    def __init__(self, record: StepRecord) -> None:
        self.record = record
        self.linear: LinearSolver | None = None
        self._spaces: TangentSpaces | None = None

    def __call__(
        self, z: MechanicalState, spaces: TangentSpaces, *, changed: int, search: float, final: bool
    ) -> MechanicalState:
        """The state in equilibrium, if not ``final`` nearly; the record has the distance of the last to the spaces."""
        clock = time.perf_counter()
        scene, op = self.record.projection, self.record.projection.operator
        near = SpaceProjection(spaces, scene.metric).closest(z.strain, z.stress)
        distance = self.record.size(z.strain - near[0], z.stress - near[1])
        del near
        if self.linear is None or op.comm.allreduce(spaces is not self._spaces, MPI.LOR):
            self._spaces = spaces
            self._factorise(spaces.tangents, z.u, spaces.own)
        assert self.linear is not None
        u, strain, left, enough = z.u, z.strain, np.inf, _BALANCE if final else _ROUGH
        for correction in range(_CORRECTIONS):
            stress = spaces.stress_at(strain)
            residual = scene.residual(stress, u)
            if correction == 0 and not final:
                enough = max(_ROUGH, self.leave * residual)
            if correction > 0 and residual <= enough:
                self.record.add(distance, changed, search, clock)
                return MechanicalState(u, np.zeros_like(u), strain, stress)
            if correction > 1 and residual > left:
                break
            left = residual
            u = u + self.linear.solve(
                scene.problem.forces - op.force(stress), within=0.3 * enough / max(residual, enough)
            )
            strain = op.strain(u)
        raise ConvergenceError(
            f"local tangents: expected equilibrium, got an out-of-balance force of {residual:.3g} of all forces; the "
            "matrix is near singular, or the tangents are far from symmetric"
        )

    def _factorise(self, tangent: Array, u: Array, own: NDArray[np.int64] | None = None) -> LinearSolver:
        """The solver of the symmetric part of the moduli ``tangent``, (k, 6, 6) of which each point has its ``own``
        (n,), or of all points, (n, 6, 6) or (n, 9, 9), and of the loads at u.
        """
        problem, older = self.record.projection.problem, None
        if self.linear is None:
            older = self.record.projection.give()
            older = older if older is not None and older.direct else None  # levels of GAMG go before others are made
        stiffness = problem.operator.stiffness() if self.linear is None else self.linear.stiffness
        problem.add_load_stiffness(u, stiffness.assemble(0.5 * (tangent + tangent.swapaxes(1, 2)), own))
        if self.linear is None:
            self.linear = LinearSolver(problem, stiffness, prefix="dd_tangent_", definite=False, older=older)
        else:
            self.linear.update(keep=True)
        return self.linear


class FiniteTangentStep(LocalTangentStep):
    """Equilibrium in finite strain on the tangent spaces, T = T_i + D_i (U - U_i): Newton's method.

    If not ``final`` it is one iteration; one that does not lower the out-of-balance force is halved.
    """

    exact = False

    def __init__(self, record: StepRecord) -> None:
        super().__init__(record)
        self.scene = record.projection
        self._last: tuple[Array, Kinematics] | None = None

    def __call__(
        self, z: MechanicalState, spaces: TangentSpaces, *, changed: int, search: float, final: bool
    ) -> MechanicalState:
        """The state after one iteration, or in equilibrium; its stress is that of the tangent spaces."""
        record, clock = self.record, time.perf_counter()
        near = SpaceProjection(spaces, self.scene.metric).closest(z.strain, z.stress)
        distance, scene = record.size(z.strain - near[0], z.stress - near[1]), self.scene
        state, found, residual = self._on(spaces, z.u)
        for _ in range(_CORRECTIONS):
            if final and residual <= _BALANCE:
                return state
            linear = self._factorise(found.nominal_tangent(state.stress, spaces.tangent), state.u)
            within = min(_INEXACT, max(residual, 0.3 * _BALANCE / max(residual, _BALANCE)))
            step = linear.solve(-scene.problem.out_of_balance(state.nominal_stress, state.u), within=within)
            for part in 0.5 ** np.arange(_HALVINGS):
                trial, found, out = self._on(spaces, state.u + part * step)
                if out <= (1 - 1e-4 * part) * residual or out <= _BALANCE:
                    break
            else:
                break
            state, residual = trial, out
            record.add(distance, changed, search, clock)
            if not final:
                return state
            distance, changed, search, clock = 0.0, 0, 0.0, time.perf_counter()
        raise ConvergenceError(
            f"local tangents in finite strain: expected equilibrium, got an out-of-balance force of {residual:.3g} of "
            "all forces"
        )

    def _on(self, spaces: TangentSpaces, u: Array) -> tuple[MechanicalState, Kinematics, float]:
        """State of the nodal u on the tangent spaces, its kinematics, and the out-of-balance force, inf inside out."""
        scene = self.scene
        if self._last is None or self._last[0] is not u:  # a step starts where the last one ended
            self._last = u, scene.operator.local(scene.operator.strain(u))
        found = self._last[1]
        stress = spaces.stress_at(found.strain)
        state = state_on(u, found, stress)
        residual = scene.residual(state.nominal_stress, u)
        return state, found, np.inf if scene.operator.comm.allreduce(found.inside_out, MPI.LOR) else residual
