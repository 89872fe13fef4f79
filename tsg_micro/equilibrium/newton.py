"""Newton's method on the exact energy at one load: line search, elongation limit, descent where indefinite.

The unknowns are the free nodal displacements x and a small border z: free macroscopic unknowns, and multipliers of
linear constraints A y = b. Only the nodal matrix K is factorised; the border is eliminated through its Schur
complement, and the inertia of the whole is that of K plus that of the complement.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from tsg_micro.data.errors import ConvergenceError
from tsg_micro.equilibrium.balance import Balance, times
from tsg_micro.equilibrium.iteration import Converged, Iteration, NewtonOptions
from tsg_micro.equilibrium.line_search import leave_saddle, line_search
from tsg_micro.equilibrium.linear_solvers import Choice, Factor, SymmetricSolver, choose_backend, make_solver
from tsg_micro.equilibrium.members import MACRO, MemberState, MemberSystem, NodalPattern
from tsg_micro.equilibrium.older_factor import corrected, newton_step
from tsg_micro.equilibrium.tangent import Border, Tangent, lowest_ritz

__all__ = ["Converged", "Iteration", "NewtonOptions", "NewtonSolver"]

Array = NDArray[np.float64]
_MOST_MODES, _LANCZOS_STEPS = 12, 60
_LARGE = 20_000
"""Unknowns from which a factorisation costs so much more than a solve that older ones pay."""
_LOOSE, _CLOSE, _FALL = 0.1, 5e-3, 0.3
"""Error of a step far from the equilibrium; residual from which the tangent is nearly that of the equilibrium; to what
part the residual falls in an iteration with an older factor, or there will be a new one."""
_ROUNDINGS = 4.0
_SENSELESS = 1e-3
"""Of the mean member force; an equilibrium that is known no better is none."""
_PATIENCE = 25
"""Iterates within round-off before the best of them is taken; most often one is within the tolerance by then."""


class NewtonSolver:
    """Newton for one set of free unknowns: its pattern, ordering and history live on between loads."""

    def __init__(
        self, system: MemberSystem, free: NDArray[np.bool_], *, border: Border | None, options: NewtonOptions
    ) -> None:
        self.system = system
        self.free = np.flatnonzero(free)
        self.border = border or Border(np.zeros((MACRO, 0)), np.zeros((0, system.size)))
        self.options = options
        self.pattern = NodalPattern(system.structure, free, system.pairs)
        self.choice: Choice = choose_backend(self.pattern.size, options.linear_solver)
        self.solver: SymmetricSolver = make_solver(self.pattern.indptr, self.pattern.indices, self.choice.backend)
        self.factorisations = 0
        self._older: Tangent | None = None
        m = system.nodal_size
        self.balance = Balance(system, self.free, self.border, options.tolerance)
        self._macro_directions = np.zeros((system.size, self.border.macro.shape[1]))
        self._macro_directions[m:] = self.border.macro

    def matrix(self, state: MemberState, *, shift: float = 0.0) -> Array:
        """Upper triangle (nnz,) of the nodal tangent at ``state``, with ``shift`` added to its diagonal, N/m."""
        pairs = self.system.pair_blocks(state) if len(self.system.pairs) else None
        values = self.pattern.assemble(self.system.member_blocks(state), pairs)
        if shift:
            values[self.pattern.diagonal] += shift
        if self.border.held is not None:
            held = np.searchsorted(self.free, self.border.held)
            values[self.pattern.diagonal[held]] += 1e-8 * np.abs(values[self.pattern.diagonal]).mean(axis=0)
        return values

    def factorise(self, values: Array) -> Factor:
        """The factor of a nodal tangent with these values (nnz,); no earlier one holds any more.

        Raises:
            ConvergenceError: it has none.
        """
        self._older = None
        self.factorisations += 1
        return self.solver.factorise(values)

    def tangent(self, state: MemberState, *, shift: float = 0.0) -> Tangent:
        """Factor the tangent at ``state``, with ``shift`` added to its diagonal.

        Raises:
            ConvergenceError: it has no finite factor.
        """
        values = self.matrix(state, shift=shift)
        factor = self.factorise(values)
        tangent = self._bordered(state, values, factor)
        if self.pattern.size >= _LARGE and tangent.negative_pivots == 0 and not shift:
            self._older = tangent
        return tangent

    def _last_tangent(self, state: MemberState) -> Tangent:
        """The tangent at an equilibrium, from the last factor where that is of a state nearby."""
        if self._older is not None:
            values = self.matrix(state)
            factor = corrected(self._older.factor, sp.csr_array((values, self.pattern.indices, self.pattern.indptr)))
            if factor is not None:
                return self._bordered(state, values, factor)
        return self.tangent(state)

    def _bordered(self, state: MemberState, values: Array, factor: Factor) -> Tangent:
        """The tangent at ``state`` whose nodal part has these values and this factor."""
        coupling, schur = self.coupling(state)
        if self.border.size == 0:
            return Tangent(factor, coupling, coupling, schur, factor.negative_pivots)
        solved = factor.solve(coupling)
        schur -= coupling.T @ solved
        if not np.isfinite(schur).all():
            raise ConvergenceError("equilibrium: the tangent is not finite")
        return Tangent(factor, coupling, solved, schur, factor.negative_pivots + int(self.more_negative(schur, values)))

    def coupling(self, state: MemberState) -> tuple[Array, Array]:
        """Border columns (nx, k) and block (k, k) of the bordered tangent, free entries of H first."""
        k, m, size = self.border.macro.shape[1], self.system.nodal_size, self.border.size
        many, a = state.length.shape[1:], self.border.constraint
        coupling, block = np.zeros((self.pattern.size, size, *many)), np.zeros((size, size, *many))
        to_all = (None,) * len(many)
        if k:
            product = self.system.macro_product(state, self._macro_directions[(..., *to_all)])
            coupling[:, :k] = product[self.free]
            block[:k, :k] = (self.border.macro.T[(..., None, *to_all)] * product[m:]).sum(axis=1)
        coupling[:, k:] = a[:, self.free].T[(..., *to_all)]
        block[k:, :k] = (a[:, m:] @ self.border.macro)[(..., *to_all)]
        block[:k, k:] = np.swapaxes(block[k:, :k], 0, 1)
        return coupling, block

    def more_negative(self, schur: Array, values: Array) -> NDArray[np.int64]:
        """Negative eigenvalues (...) that Schur complements (..., k, k) of the border add to those of K (nnz, ...).

        On the constrained unknowns: each multiplier takes one negative eigenvalue of the bordered matrix. Rows are in J
        and in m/N; on one scale, which keeps the signs, rounding of the large ones does not make the small ones.
        """
        constraints = len(self.border.constraint)
        stiffness = np.sqrt(np.abs(values[self.pattern.diagonal]).mean(axis=0))[..., None]
        scale = np.repeat(stiffness, self.border.size, axis=-1)
        free = self.border.macro.shape[1]
        scale[..., :free] = 1.0 / (stiffness * self.system.structure.size.max())
        scaled = scale[..., :, None] * schur * scale[..., None, :]
        return np.asarray((np.linalg.eigvalsh(scaled) < 0.0).sum(axis=-1) - constraints)

    def _round_off(self, y: Array, state: MemberState) -> float:
        """Residual that rounding of positions alone makes, in mean member forces; 0 where that says nothing any more.

        A member's force EA (l - l0) / l0 is off by eps EA, times what its nodes have moved over its length.
        """
        moved = 1.0 + np.abs(y[: self.system.nodal_size]).max() / state.length
        scale = np.abs(state.force).mean()
        largest = float((self.system.structure.EA * moved).max())
        part = _ROUNDINGS * np.finfo(float).eps * largest / scale if scale > 0.0 else 1.0
        return part if part < _SENSELESS else 0.0

    def out_of_balance(self, y: Array, state: MemberState, force: Array) -> tuple[Array, Array, float]:
        """Forces on the free nodal unknowns (N) and on the border, and their measure, with the best multipliers."""
        none = np.zeros(len(self.border.constraint))
        nodal, rest, _ = self.balance.residual(y, self.system.gradient(state), force, none)
        return nodal, rest, float(self.balance.measure(nodal, rest, state))

    def solve(
        self, y: Array, force: Array, *, load: float, history: list[Iteration], stable: bool = False
    ) -> Converged:
        """Equilibrium near ``y`` (3n + 9,) under nodal forces (3n,); prescribed entries of y stay as they are.

        Where the tangent is indefinite the iteration leaves along its lowest mode, downhill in energy. With
        ``stable`` that holds for equilibria too: one whose tangent has negative pivots is left, unless the motion is
        neutral, that is, changes no energy.

        Stiff members under little force have residuals above the tolerance by round-off alone: there the best of
        ``_PATIENCE`` iterates within round-off is the equilibrium, and its residual says so.

        Raises:
            ConvergenceError: not within ``max_iterations``, or a step that could not be shortened enough.
        """
        system, most = self.system, self.options.max_elongation
        y = y.copy()
        multipliers = np.zeros(len(self.border.constraint))
        state = system.state(y)
        gradient = system.gradient(state)
        best, within, before, last = None, 0, self._older, np.inf
        for iteration in range(self.options.max_iterations + 1):
            nodal, rest, multipliers = self.balance.residual(y, gradient, force, multipliers)
            residual = float(self.balance.measure(nodal, rest, state))
            if not np.isfinite(residual):
                raise ConvergenceError("equilibrium: the residual is not finite", history)
            settled = residual <= self.options.tolerance
            if not settled and residual <= self._round_off(y, state):
                within += 1
                if best is None or residual < best.residual:
                    best = Converged(y, state, gradient, multipliers, residual, iteration, None)
                settled = within > _PATIENCE or iteration == self.options.max_iterations
                if settled:
                    y, state, gradient, multipliers = best.y, best.state, best.gradient, best.multipliers
                    residual = best.residual
            pull = np.append(force, np.zeros(MACRO)) - self.border.constraint.T @ multipliers
            if settled:
                tangent = self._last_tangent(state) if stable else None
                modes = self._unstable_modes(tangent) if tangent else []
                left = leave_saddle(system, y, modes, pull, max_elongation=most)
                if left is y:
                    return Converged(y, state, gradient, multipliers, residual, iteration, tangent)
                assert tangent is not None
                history.append(Iteration(load, residual, 0.0, 0.0, tangent.negative_pivots, system.energy(state)))
                y, best, within = left, None, 0
            elif iteration < self.options.max_iterations:
                due = stable and self._older is before  # a factorisation, of an iterate near the equilibrium
                if (due and residual <= _CLOSE) or residual > _FALL * last:
                    self._older = None
                last = residual
                goal = _CLOSE if due else self.options.tolerance
                error = min(_LOOSE, max(residual, 0.3 * goal / residual))
                step, slope, modes, record = self._descent(state, gradient - pull, (nodal, rest), error)
                if slope < 0.0:
                    length = line_search(system, y, step, pull, state, slope, max_elongation=most)
                    history.append(Iteration(load, residual, length, *record, system.energy(state)))
                    y = leave_saddle(system, y + length * step, modes, pull, max_elongation=most)
                elif best is None:
                    raise ConvergenceError(
                        f"equilibrium: no descent at a residual of {residual:.2e} mean member forces", history
                    )
                else:  # the energy does not tell the iterates apart any more
                    y, within = best.y, _PATIENCE
            state = system.state(y)
            gradient = system.gradient(state)
        raise ConvergenceError(
            f"equilibrium: residual {residual:.2e} mean member forces after {self.options.max_iterations} iterations, "
            f"expected {self.options.tolerance:.1e}",
            history,
        )

    def _descent(
        self, state: MemberState, gradient: Array, residual: tuple[Array, Array], error: float
    ) -> tuple[Array, float, list[tuple[Array, float]], tuple[float, int]]:
        """Newton step, slope along it, unstable modes, and (shift, negative pivots) of the tangent.

        ``gradient`` is that of the energy less the work of loads and constraints. A few unstable modes are turned
        downhill one by one; of many the tangent is shifted until it has none, and so it is where the modes were not
        found well enough for the step to descend. A step that an older factor gives, with this relative ``error``, has
        met no mode.
        """
        nodal, rest = residual
        if self._older is not None:
            found = newton_step(self.system, self.border, self.free, self._older, state, residual, within=error)
            if found is not None and float(gradient @ (step := self.spread(*found))) < 0.0:
                return step, float(gradient @ step), [], (0.0, 0)
        for most in (_MOST_MODES, 0):
            tangent, shift, negative = self._tangent_for_step(state, most)
            modes = self._unstable_modes(tangent)
            step = self.spread(*tangent.solve(nodal, rest))
            for mode, stiffness in modes:
                step += 2.0 * (nodal @ mode[self.free] + rest @ self._border_part(mode)) / abs(stiffness) * mode
            slope = float(gradient @ step)
            if slope < 0.0 or not negative:
                break
        return step, slope, modes, (shift, negative)

    def spread(self, dx: Array, dz: Array) -> Array:
        """Values on the free unknowns as a vector of all unknowns (3n + 9,)."""
        step = np.zeros((self.system.size, *dx.shape[1:]))
        step[self.free] = dx
        step[self.system.nodal_size :] = times(self.border.macro, dz[: self.border.macro.shape[1]])
        return step

    def _border_part(self, step: Array) -> Array:
        """What :meth:`spread` made of the border's free macroscopic unknowns; 0 for the multipliers."""
        macro = self.border.macro.T @ step[self.system.nodal_size :]
        return np.concatenate([macro, np.zeros(len(self.border.constraint))])

    def _unstable_modes(self, tangent: Tangent) -> list[tuple[Array, float]]:
        """Modes (3n + 9,) of negative stiffness (N/m), lowest first, by Lanczos on the factor that is there."""
        count, n = min(tangent.negative_pivots, _MOST_MODES), len(self.free)
        if count == 0:
            return []
        none = np.zeros(self.border.size)
        values, vectors = lowest_ritz(lambda x: tangent.solve(x, none)[0], n, min(n, _LANCZOS_STEPS))
        modes = []
        for value, x in zip(values[:count], vectors.T[:count], strict=True):
            if value < 0.0:
                modes.append((self.spread(x, tangent.solve(x, none)[1] / value), 1.0 / value))
        return sorted(modes, key=lambda mode: mode[1])

    def _tangent_for_step(self, state: MemberState, most: int) -> tuple[Tangent, float, int]:
        """The tangent, shifted until it has no negative pivots if it has more than ``most``; the shift; the pivots."""
        tangent, shift = self.tangent(state), 0.0
        negative = tangent.negative_pivots
        scale = 0.05 * np.abs(state.force_density).mean()
        while tangent.negative_pivots > (0 if shift else most):
            shift = 4.0 * shift or scale
            if shift > 1e8 * scale:
                raise ConvergenceError(f"equilibrium: the tangent stays indefinite with a shift of {shift:.2e} N/m")
            tangent = self.tangent(state, shift=shift)
        return tangent, shift, negative
