"""Newton's method for many states of one structure at once, as far as it is plain.

The iteration is that of :class:`NewtonSolver`, number for number: all is done on arrays whose last axis is that of the
states, but for the factorisations, which go one by one. A state that needs more than steps along Newton's direction at
a stable tangent (a shift, a turn away from a saddle, a longer line search, iterates within round-off) is left out; it
is for NewtonSolver, from its start.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import ConvergenceError
from tsg_micro.equilibrium.balance import times
from tsg_micro.equilibrium.line_search import elongation_limit
from tsg_micro.equilibrium.members import MemberState
from tsg_micro.equilibrium.newton import NewtonSolver

__all__ = ["Settled", "bordered", "settle", "solve_each"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Settled:
    """Equilibria of b states; arrays have a last axis of b."""

    number: Index
    """Which of the states that were asked for (b,)."""
    y: Array
    """All unknowns (3n + 9, b)."""
    members: MemberState
    gradient: Array
    """Derivative of the energy by y (3n + 9, b)."""
    multipliers: Array
    """Of the constraints (c, b)."""
    iterations: Index
    """Newton iterations (b,)."""

    def take(self, which: NDArray[np.bool_] | Index) -> Settled:
        """Those of the states."""
        arrays = {name: getattr(self, name)[..., which] for name in _ARRAYS}
        return Settled(**arrays, members=self.members.map(lambda part: part[..., which]))

    def each(self) -> Iterator[MemberState]:
        """The members of every state."""
        parts = (np.moveaxis(getattr(self.members, field.name), -1, 0).copy() for field in fields(MemberState))
        return itertools.starmap(MemberState, zip(*parts, strict=True))


_ARRAYS = [field.name for field in fields(Settled) if field.name != "members"]


def _members(array: Callable[[str], Array]) -> MemberState:
    return MemberState(*(array(field.name) for field in fields(MemberState)))


def settle(newton: NewtonSolver, y: Array) -> Settled:
    """Equilibria near ``y`` (3n + 9, b) without nodal forces: those of the states that plain iterations reach.

    Prescribed entries of y stay as they are.
    """
    system, b = newton.system, y.shape[1]
    here, done = _at(newton, np.arange(b), y, np.zeros((len(newton.border.constraint), b)), np.zeros(b, np.int64)), []
    for _ in range(newton.options.max_iterations + 1):
        force = np.zeros((system.nodal_size, 1))
        nodal, rest, multipliers = newton.balance.residual(here.y, here.gradient, force, here.multipliers)
        here = replace(here, multipliers=multipliers)
        measure = newton.balance.measure(nodal, rest, here.members)
        settled = measure <= newton.options.tolerance
        done.append(here.take(settled))
        on = ~settled & np.isfinite(measure)
        if not on.any():
            break
        here = _step(newton, here.take(on), nodal[:, on], rest[:, on])
        if not len(here.number):
            break
    joined = {name: np.concatenate([getattr(part, name) for part in done], axis=-1) for name in _ARRAYS}
    members = _members(lambda name: np.concatenate([getattr(part.members, name) for part in done], axis=-1))
    return Settled(**joined, members=members)


def _at(newton: NewtonSolver, number: Index, y: Array, multipliers: Array, iterations: Index) -> Settled:
    """Members and gradient at y, be it in balance or not."""
    members = newton.system.state(y)
    return Settled(number, y, members, newton.system.gradient(members), multipliers, iterations)


def _step(newton: NewtonSolver, here: Settled, nodal: Array, rest: Array) -> Settled:
    """The next iterate of those states whose whole step, as far as the elongation limit allows, is a good one."""
    coupling, block = (np.moveaxis(part, -1, 0).copy() for part in newton.coupling(here.members))
    solved, values, negative = solve_each(newton, here.members, np.dstack([coupling, nodal.T]))
    schur, negative = bordered(newton, coupling, block, solved[:, :, :-1], values, negative)
    good = negative == 0
    if not good.any():
        return here.take(good)
    here, rest, schur = here.take(good), rest.T[good, :, None], schur[good]
    x, solved, coupling = solved[good, :, -1:], solved[good, :, :-1], coupling[good]
    z = np.linalg.solve(schur, rest - np.swapaxes(coupling, 1, 2) @ x) if schur.size else rest
    step = newton.spread((x - solved @ z)[:, :, 0].T, z[:, :, 0].T)
    pull = -times(newton.border.constraint.T, here.multipliers)
    slope = ((here.gradient - pull) * step).sum(axis=0)
    most = newton.options.max_elongation
    length = np.minimum(1.0, elongation_limit(newton.system, step, here.members, max_elongation=most))
    after = _at(newton, here.number, here.y + length * step, here.multipliers, here.iterations + 1)
    ahead = ((after.gradient - pull) * step).sum(axis=0)
    return after.take((slope < 0.0) & (ahead <= 0.5 * np.abs(slope)))


def bordered(
    newton: NewtonSolver, coupling: Array, block: Array, solved: Array, values: Array, negative: Index
) -> tuple[Array, Index]:
    """Schur complements (b, k, k) of the border, and negative pivots (b,) of border and K together.

    ``solved`` is K^-1 times the ``coupling`` (b, nx, k), ``block`` that of the border, ``negative`` are K's pivots; -1
    where there is no finite factor.
    """
    if not newton.border.size:
        return block, negative
    schur = block - np.swapaxes(coupling, 1, 2) @ solved
    finite = (negative >= 0) & np.isfinite(schur).all(axis=(1, 2))
    schur[~finite] = np.eye(newton.border.size)
    return schur, np.where(finite, negative + newton.more_negative(schur, values), -1)


def solve_each(newton: NewtonSolver, members: MemberState, columns: Array) -> tuple[Array, Array, Index]:
    """K^-1 times ``columns`` (b, nx, r) at every one of b states, K's values (nnz, b), its negative pivots (b,).

    Where K has no factor the pivots are -1.
    """
    values = newton.matrix(members)
    rows, solved, negative = np.ascontiguousarray(values.T), np.zeros(columns.shape), np.full(len(columns), -1)
    for k, row in enumerate(rows):
        try:
            factor = newton.factorise(row)
            solved[k] = factor.solve(columns[k])
        except ConvergenceError:
            continue
        negative[k] = factor.negative_pivots
    return solved, values, negative
