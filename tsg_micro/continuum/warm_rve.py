"""An RVE that goes from known states to others: many at once where that is plain, else one by one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tsg_micro.continuum.rve import RVE
from tsg_micro.continuum.rve_tangent import condensed, strain_columns, support_stress, support_tangent
from tsg_micro.continuum.warm_states import Effort, WarmStates
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import from_mandel, to_mandel
from tsg_micro.equilibrium.balance import times
from tsg_micro.equilibrium.newton_many import Settled, bordered, settle, solve_each

__all__ = ["WarmRVE"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_AT_ONCE = 22_000
"""Unknowns of a batch; with more it is no faster."""


class WarmRVE:
    """An RVE that goes from any known states to others; ``effort`` counts what it did."""

    def __init__(self, rve: RVE) -> None:
        """``rve`` is moved about.

        Raises:
            ConvergenceError: it has no equilibrium in its reference state.
        """
        self.rve, self.effort = rve, Effort()
        rve.reset()
        self.reference = WarmStates.of(rve.solve_strain(np.zeros(6)), rve)

    def solve(self, strain: Array, states: WarmStates, k: int) -> WarmStates:
        """The state at ``strain`` (6,), from state k of ``states``; entries of free components are not used.

        Raises:
            ConvergenceError: the equilibrium was lost on the way.
            InputError: the strain is inside out.
        """
        solver = self.rve.solver
        solver.move_to(states.unknowns[k], np.zeros(solver.system.nodal_size))
        state = self.rve.solve_strain(strain, rate=None if self.rve.free else states.rate[k].astype(float))
        self.effort.add(1, state.equilibrium.iterations, state.equilibrium.factorisations)
        return WarmStates.of(state, self.rve)

    def solve_many(self, strain: Array, states: WarmStates) -> tuple[WarmStates, Index, dict[int, str]]:
        """States at ``strain`` (b, 6), each from its own of the b ``states``: those that are reached, and which.

        Batches go as far as their iterations are plain; states that need more are solved one by one, as :meth:`solve`
        does. The texts say why some are not reached.
        """
        parts, numbers, failures = [states.take([])], [np.zeros(0, dtype=np.int64)], {}
        size = max(1, _AT_ONCE // self.rve.solver.newton.pattern.size)
        for begin in range(0, len(strain), size):
            some = np.arange(begin, min(begin + size, len(strain)))
            found, reached = self._plain(strain[some], states.take(some))
            parts.append(found)
            numbers.append(some[reached])
            for k in np.setdiff1d(some, some[reached]):
                try:
                    parts.append(self.solve(strain[k], states, int(k)))
                    numbers.append(np.array([k]))
                except (ConvergenceError, InputError) as error:  # the latter: inside out
                    failures[int(k)] = str(error)
        number = np.concatenate(numbers)
        order = np.argsort(number)
        return WarmStates.join(parts).take(order), number[order], failures

    def _plain(self, strain: Array, start: WarmStates) -> tuple[WarmStates, Index]:
        """States at ``strain`` (b, 6) from those of ``start`` that plain iterations reach, and their numbers."""
        rve, newton = self.rve, self.rve.solver.newton
        before = newton.factorisations
        guess = _along_tangent(rve, strain, start)
        right_way = np.flatnonzero(np.linalg.det(np.eye(3) + guess[:, -9:].reshape(-1, 3, 3)) > 0.0)
        if not len(right_way):
            return start.take(right_way), right_way
        found = settle(newton, np.ascontiguousarray(guess[right_way].T))
        if not len(found.number):
            return start.take(found.number), found.number
        solved, values, negative = solve_each(newton, found.members, strain_columns(newton, found.members))
        coupling, block = (np.moveaxis(part, -1, 0).copy() for part in newton.coupling(found.members))
        of_border = np.concatenate([-solved[:, :, list(rve.free)], solved[:, :, 6:]], axis=2)
        stable = bordered(newton, coupling, block, of_border, values, negative)[1] == 0
        self.effort.add(int(stable.sum()), int(found.iterations.sum()), newton.factorisations - before)
        found, solved = found.take(stable), solved[stable]
        return _states(rve, found, *condensed(newton, found.members, solved)), right_way[found.number]


def _along_tangent(rve: RVE, strain: Array, start: WarmStates) -> Array:
    """Unknowns (b, 3n + 9) at ``strain`` (b, 6) to the first order; free components keep their stress at zero."""
    free, given = list(rve.free), [k for k in range(6) if k not in rve.free]
    change = strain - start.strain
    if free:
        across = start.tangent[:, free]
        driven = (across[:, :, given] * change[:, None, given]).sum(axis=2)
        change[:, free] = -np.linalg.solve(across[:, :, free], driven[:, :, None])[:, :, 0]
    guess = start.unknowns + (start.rate.astype(float) @ change[:, :, None])[:, :, 0]
    guess[:, -9:] = from_mandel(start.strain + change).reshape(-1, 9)
    return np.asarray(guess)


def _states(rve: RVE, found: Settled, moduli: Array, rate: Array) -> WarmStates:
    """The states of equilibria with their moduli (b, 6, 6) in J and rates."""
    system, volume, m = rve.solver.system, rve.structure.volume, rve.solver.system.nodal_size
    count = len(found.number)
    balance = found.gradient[m:] + times(rve.solver.newton.border.constraint[:, m:].T, found.multipliers)
    piola, tangent = balance.T.reshape(-1, 3, 3) / volume, moduli / volume
    H = found.y[m:].T.reshape(-1, 3, 3)
    carried, its_tangent = np.zeros((count, 6)), np.zeros((count, 6, 6))
    if any(rve.held):
        carried = to_mandel(support_stress(system, found.members, piola))
        its_tangent = support_tangent(system, found.members, tangent, rate)
    return WarmStates(
        strain=to_mandel(H),
        stress=to_mandel(piola),
        tangent=tangent,
        F=np.eye(3) + H,
        first_piola=piola,
        energy=np.array([system.energy(one) for one in found.each()]) / volume,
        unknowns=found.y.T.copy(),
        rate=rate.astype(np.float32),
        negative_pivots=np.zeros(count, dtype=np.int64),
        support=carried,
        support_tangent=its_tangent,
    )
