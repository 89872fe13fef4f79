"""Newton's method on the macroscale with a constitutive law at every quadrature point: the reference model.

    sum w B^T sigma(B u) = f,      u as prescribed
    (sum w B^T T B) du   = f - sum w B^T sigma,      T = d sigma / d epsilon at every quadrature point
A load step starts with the linear answer to the change of load; what is left is solved at fixed load. A step that
does not lower the out-of-balance force is halved, a load step that does not converge is halved too.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro.material.laws import Law
from dd_macro.material.regional import RegionalLaw
from dd_macro.methods.finite_projection import state_on
from dd_macro.methods.reference import NewtonIteration, ReferenceOptions, ReferenceResult
from dd_macro.parallel import one_thread, total
from dd_macro.scene.boundary import Displacement
from dd_macro.scene.kinematics import Kinematics
from dd_macro.scene.linear import LinearSolver
from dd_macro.scene.loads import Load
from dd_macro.scene.problem import Problem
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.errors import ConvergenceError, InputError

__all__ = ["equilibrium", "solve_law"]

Array = NDArray[np.float64]
_log = logging.getLogger(__name__)

_LEAST_FORCE = 1e-2  # of the largest stresses so far, as forces: what the residual relates to where nothing reacts


@dataclass(frozen=True)
class _State:
    """A trial: u, what the law gives, the out-of-balance force, its norm on free components in N, and relative."""

    load: float
    u: Array
    found: Kinematics
    stress: Array
    tangent: Array
    out_of_balance: Array
    norm: float
    residual: float


def solve_law(
    operator: StrainOperator,
    law: Law,
    conditions: Sequence[Displacement],
    tractions: Sequence[Load] = (),
    *,
    steps: int = 1,
    options: ReferenceOptions | None = None,
    progress: Callable[[NewtonIteration], None] | None = None,
) -> ReferenceResult:
    """:func:`equilibrium` of a body that is held by ``conditions`` and loaded by ``tractions``; raises as that does."""
    problem = Problem(operator, conditions, tractions)
    return equilibrium(problem, law, steps=steps, options=options, progress=progress)


@one_thread
def equilibrium(
    problem: Problem,
    law: Law,
    *,
    steps: int = 1,
    start: tuple[float, Array] | None = None,
    options: ReferenceOptions | None = None,
    progress: Callable[[NewtonIteration], None] | None = None,
) -> ReferenceResult:
    """Equilibrium of the body whose material is ``law``, the load applied in ``steps`` equal parts.

    ``start`` is the part of the load at which the unknowns u (in m) are in equilibrium; at rest if None.

    The law is called on every rank with the strains of that rank's quadrature points, always in the same order; it
    may raise ConvergenceError, on one rank alone too. The linear solver is dd_macro.scene.linear.LinearSolver, its
    PETSc options have the prefix ``ref_``. ``progress`` is called on every rank after each linear solve.

    Raises:
        InputError: a bad number of steps.
        ConvergenceError: a load step did not converge although it was halved ``max_cuts`` times; it has the history.
    """
    if steps < 1:
        raise InputError(f"steps: expected at least 1, got {steps}")
    scene = _Newton(problem, law, options or ReferenceOptions())
    scene.progress = progress
    goal_load, problem = problem.factor, scene.problem
    load, u = (0.0, np.zeros(problem.operator.owned_dofs)) if start is None else start
    begin, done, size, load_steps, cuts = load, 0.0, 1.0 / steps, 0, 0
    try:
        state = scene.evaluate(u, load)
        while done < 1.0 - 1e-12:
            part = min(done + size, 1.0)
            goal = begin + part * (goal_load - begin)
            try:
                state = scene.advance(state, goal)
            except ConvergenceError:
                cuts, size = cuts + 1, 0.5 * size
                if cuts > scene.options.max_cuts:
                    raise
                _log.info("load step to %.4g: cut", goal)
                continue
            load, done, load_steps = goal, part, load_steps + 1
    except ConvergenceError as error:
        raise ConvergenceError(f"Newton's method, from load {load:.4g}: {error}", scene.history) from None
    z = state_on(state.u, state.found, state.stress)
    points = len(z.strain)
    support = law.support(z.strain) if isinstance(law, RegionalLaw) else None
    return ReferenceResult(
        problem=problem.at(goal_load),
        metric=None,
        mechanical=z,
        material_strain=z.strain,
        material_stress=z.stress,
        index=np.full(points, -1, dtype=np.int64),
        local_distance=np.zeros(points),
        distance=0.0,
        normalised_distance=0.0,
        converged=True,
        reason="a law at every point",
        tangent=state.tangent,
        reactions={c.name: problem.support_force(c.side, state.out_of_balance) for c in problem.supports},
        residual=state.residual,
        iterations=len(scene.history),
        load_steps=load_steps,
        solver=scene.linear.name,
        linear=scene.linear,
        history=tuple(scene.history),
        support=support,
    )


class _Newton:
    """What stays during the iteration: the problem, the matrix and its solver, the history."""

    def __init__(self, problem: Problem, law: Law, options: ReferenceOptions) -> None:
        self.problem, self.law, self.options = problem.at(1.0), law, options
        self.operator = problem.operator
        self.matrix = problem.operator.stiffness()
        self._linear: LinearSolver | None = None
        self._gross = 0.0
        self.history: list[NewtonIteration] = []
        self.progress: Callable[[NewtonIteration], None] | None = None

    @property
    def linear(self) -> LinearSolver:
        """The solver, which is there from the first tangent on."""
        assert self._linear is not None
        return self._linear

    def advance(self, state: _State, load: float) -> _State:
        """Equilibrium at ``load``, from ``state`` in equilibrium (or at rest).

        Raises:
            ConvergenceError: it was not found.
        """
        tangent = self._factorise(state)
        jump = (load - state.load) * self.problem.prescribed
        change = np.einsum("nij,nj->ni", tangent, self.operator.strain(jump))
        predicted = state.found.nominal_stress(state.stress) + change
        loads = self.problem.at(load).forces_at(state.u)
        step = jump + self.linear.solve(loads - self.operator.force(predicted))
        state = self._record(self.evaluate(state.u + step, load), 1.0)
        for _ in range(self.options.max_iterations):
            if state.residual <= self.options.tolerance:
                return state
            self._factorise(state)
            state = self._search(state, self.linear.solve(-state.out_of_balance))
        if state.residual <= self.options.tolerance:
            return state
        raise ConvergenceError(
            f"expected a residual of {self.options.tolerance:.3g} at load {load:.4g} within "
            f"{self.options.max_iterations} iterations, got {state.residual:.3g}"
        )

    def evaluate(self, u: Array, load: float) -> _State:
        """The state of displacement u (3 * nodes,) at ``load``.

        Raises:
            ConvergenceError: on all ranks, where the law fails on some or gives no finite numbers.
        """
        op = self.operator
        found = op.local(op.strain(u))
        points = len(op.weights)
        stress, tangent, message = np.zeros((points, 6)), np.zeros((points, 6, 6)), None
        try:
            if found.inside_out:
                raise ConvergenceError("expected det F > 0, got less")
            stress, tangent = self.law.stress_and_tangent(found.strain)
            if not (np.isfinite(stress).all() and np.isfinite(tangent).all()):
                message = "it gives numbers that are not finite"
        except Exception as error:  # whatever it is, the other ranks wait for word of it
            message = str(error) if isinstance(error, ConvergenceError) else f"{type(error).__name__}: {error}"
        first = op.comm.allreduce(op.comm.size if message is None else op.comm.rank, op=MPI.MIN)
        if first < op.comm.size:
            raise ConvergenceError(f"the law fails at load {load:.4g}: {op.comm.bcast(message, root=first)}")
        loads = self.problem.at(load).forces_at(u)
        nominal = found.nominal_stress(stress)
        out = op.force(nominal) - loads
        free, held = np.where(self.problem.fixed, 0.0, out), np.where(self.problem.fixed, out, 0.0)
        at_points = op.weights ** (2 / 3) * np.linalg.norm(nominal, axis=1)
        squares = total(op.comm, [free @ free, held @ held + loads @ loads, at_points @ at_points])
        norm, reacting, gross = (float(value) for value in np.sqrt(squares))
        self._gross = max(self._gross, gross)
        scale = max(reacting, _LEAST_FORCE * self._gross)
        return _State(load, u, found, stress, tangent, out, norm, norm / scale if norm != 0 else 0.0)

    def _search(self, state: _State, direction: Array) -> _State:
        """The first of the steps 1, 1/2, 1/4, ... along ``direction`` that lowers the out-of-balance force."""
        for halvings in range(self.options.max_halvings + 1):
            step = 0.5**halvings
            try:
                trial = self.evaluate(state.u + step * direction, state.load)
            except ConvergenceError:
                if halvings == self.options.max_halvings:
                    raise
                continue
            if trial.norm <= (1.0 - 1e-4 * step) * state.norm:
                return self._record(trial, step)
        raise ConvergenceError(
            f"no part of the Newton step lowers the residual {state.residual:.3g} at load {state.load:.4g}"
        )

    def _record(self, state: _State, step: float) -> _State:
        self.history.append(NewtonIteration(state.load, step, state.residual, self.linear.negative_pivots))
        _log.info("load %.4g, step %.4g: residual %.3e", state.load, step, state.residual)
        if self.progress:
            self.progress(self.history[-1])
        return state

    def _factorise(self, state: _State) -> Array:
        """Take the tangent at ``state``, and return its moduli (n, 6, 6) or (n, 9, 9) in Pa."""
        moduli = state.found.nominal_tangent(state.stress, state.tangent)
        self.problem.at(state.load).add_load_stiffness(state.u, self.matrix.assemble(moduli))
        if self._linear is None:
            self._linear = LinearSolver(self.problem, self.matrix, prefix="ref_", definite=False)
        else:
            self._linear.update()
        return moduli
