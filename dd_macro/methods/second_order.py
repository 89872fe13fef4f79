"""The data-driven solve with second-order data: points of the constraint set on the tangent spaces of their data.

A step looks up the tangent spaces of the data nearest to the last state, and finds the state z that is compatible, in
equilibrium and as near as possible to the material states y in those spaces; again until the data do not change any
more. With tangents of all six strains z and y can be one, sigma = sigma_i + D_i (epsilon - epsilon_i): the distance
vanishes, and the metric only decides which datum is nearest. So no strain direction is silent, sampled or not.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro.material.tangent_spaces import SpaceProjection, TangentSearch, TangentSpaces
from dd_macro.methods.points import DataDrivenResult, Iteration
from dd_macro.methods.projection import MechanicalState, Projection
from dd_macro.methods.second_order_steps import AlternatingStep, Step, StepRecord
from dd_macro.methods.theory import local_tangent_step, theory_of
from dd_macro.parallel import one_thread, total
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import ConvergenceError, InputError

__all__ = ["SecondOrderOptions", "SecondOrderResult", "StepName", "iterate", "solve_second_order"]

Array = NDArray[np.float64]
StepName = Literal["alternating", "local-tangent"]

_SLOW, _LEAST_RELAXATION = 0.7, 0.2
_FEW = 1e-3
"""Part of all points that keep their datum where no more of them would change it: they do not matter to the state."""


@dataclass(frozen=True)
class SecondOrderOptions:
    """How the second-order solve runs.

    ``max_iterations`` bounds the iterations: projections onto the constraint set, or factorisations. ``tolerance`` is
    the change of the state, relative to its length, below which it has converged; in the alternating method it also
    bounds the gradient of the distance, so that the state may be further off. Points may go back and forth between data
    for ever, more so if these are noisy: a point that returns twice to a datum that it just left keeps it, and after
    ``hold_after`` searches the points that move most keep what they have, more each time; where no more than one in a
    thousand points would change its datum, these keep it. So the iteration ends, and the result says how many points
    were held. Averages over neighbours that approach their fixed point slowly, or not at all, are looked up part of the
    way.

    Raises:
        InputError: on construction, where a value is out of range.
    """

    max_iterations: int = 1000
    tolerance: float = 1e-7
    hold_after: int = 25

    def __post_init__(self) -> None:
        for name in ("max_iterations", "hold_after"):
            if getattr(self, name) < 1:
                raise InputError(f"{name}: expected at least 1, got {getattr(self, name)}")
        if not 0 < self.tolerance < 1:
            raise InputError(f"tolerance: expected a number between 0 and 1, got {self.tolerance}")


@dataclass(frozen=True, kw_only=True, repr=False)
class SecondOrderResult(DataDrivenResult):
    """The result of a second-order solve; ``index`` is the nearest datum, the material state is not that datum.

    ``lookups`` counts the searches for data, ``held`` the points kept from going back and forth between data, and
    ``extrapolated`` the fraction of points further from their datum than it is trusted (dd_macro.TangentSearch). The
    material state of these is cut off there, so that their local distance tells how far out they are.
    """

    lookups: int
    held: int
    extrapolated: float

    def figures(self) -> dict[str, tuple[Any, str]]:
        """Numbers of the solution for a summary, each with its unit; collective."""
        return super().figures() | {
            "extrapolated": (self.extrapolated, "fraction of quadrature points"),
            "held": (self.held, "quadrature points"),
        }


class _Picks:
    """The data of the points, and what keeps them from going back and forth for ever."""

    def __init__(self, search: TangentSearch, comm: MPI.Comm, start: MechanicalState, hold_after: int) -> None:
        self.search, self.comm, self.hold_after, self.lookups = search, comm, hold_after, 1
        self.spaces = search.spaces(start.strain, start.stress)
        points = len(self.spaces.index)
        self._few = _FEW * float(total(comm, points))
        self.held = np.zeros(points, dtype=bool)
        self._left = np.full(points, -1)  # the datum that a point had before the one it has
        self._returns = np.zeros(points, dtype=int)

    def look_up(self, z: MechanicalState, unsettled: NDArray[np.bool_]) -> int:
        """Take the tangent spaces for state z; the number of points of this rank with another nearest datum."""
        self.lookups += 1
        late = self.lookups > self.hold_after
        last = self.spaces
        if self.search.neighbours > 1:
            new = self.search.spaces(z.strain, z.stress)
            self.held |= late & unsettled
            kept = (np.where(_as(self.held, b), a, b) for a, b in zip(_fields(last), _fields(new), strict=True))
            self.spaces = TangentSpaces(*kept)
            return int((self.spaces.index != last.index).sum())
        index, _ = self.search.nearest(self.search.metric.whiten(z.strain, z.stress))
        moves = index != last.index
        back = moves & (index == self._left)
        self._returns[back] += 1
        self.held = moves & (late | (back & (self._returns > 1)))
        if float(total(self.comm, (moves & ~self.held).sum())) <= self._few:
            self.held = moves.copy()
        moves &= ~self.held
        self._returns[moves & ~back] = 0
        self._left[moves] = last.index[moves]
        if not moves.any():
            return 0
        self.spaces = self.search.of(np.where(moves, index, last.index))
        return int(moves.sum())


def _fields(spaces: TangentSpaces) -> tuple[NDArray[Any], ...]:
    return spaces.strain, spaces.stress, spaces.tangents, spaces.own, spaces.index, spaces.reach


def _as(mask: NDArray[np.bool_], array: NDArray[Any]) -> NDArray[np.bool_]:
    """The mask (n,) in the shape of an array (n, ...)."""
    return mask.reshape(-1, *(1,) * (array.ndim - 1))


def solve_second_order(
    projection: Projection,
    search: TangentSearch,
    *,
    method: StepName = "local-tangent",
    start: MechanicalState | None = None,
    options: SecondOrderOptions | None = None,
    progress: Callable[[int, Iteration], None] | None = None,
) -> SecondOrderResult:
    """Data-driven solution of the scene of ``projection`` with the tangent spaces of the data of ``search``.

    Both methods converge to the same states. The tangents may be unsymmetric (Cauchy stress).

    Args:
        method: "alternating" or "local-tangent".
        start: mechanical state whose nearest data start the iteration; the elastic solution with C if None.
        options: SecondOrderOptions, default values if None.
        progress: called on every rank with the iteration's number and record.

    Raises:
        InputError: no such method, or projection and search have different metrics.
        ConvergenceError: ``max_iterations`` were not enough, or a linear solver failed; it has the history.
    """
    options = options or SecondOrderOptions()
    if method not in get_args(StepName):
        raise InputError(f"method: expected {' or '.join(get_args(StepName))}, got {method!r}")
    if not np.array_equal(projection.metric.C, search.metric.C):
        raise InputError("metric: expected the same C in the projection and in the search, got two different ones")
    if method == "alternating" and not theory_of(projection.operator).linear:
        raise InputError(
            "method: expected local-tangent in finite strain, got 'alternating', which needs linear spaces"
        )
    record = StepRecord(projection, options.max_iterations, progress)
    z = start or projection.elastic()
    if method == "alternating":
        return iterate(AlternatingStep(record, options.tolerance), search, z, options)
    return iterate(local_tangent_step(record), search, z, options)


@one_thread
def iterate(step: Step, search: TangentSearch, z: MechanicalState, options: SecondOrderOptions) -> SecondOrderResult:
    """:func:`solve_second_order` from ``z`` on with the steps ``step``, which go on with their record.

    Raises:
        ConvergenceError: see there.
    """
    try:
        return _iterate(step, search, z, options)
    except ConvergenceError as error:
        raise ConvergenceError(str(error), step.record.history) from None


def _iterate(step: Step, search: TangentSearch, z: MechanicalState, options: SecondOrderOptions) -> SecondOrderResult:
    record = step.record
    operator, metric = record.projection.operator, search.metric
    volume = float(total(operator.comm, operator.weights.sum()))
    averaged = search.neighbours > 1
    clock = time.perf_counter()
    picks = _Picks(search, operator.comm, z, options.hold_after)
    changed, final = int(total(operator.comm, len(operator.weights))), averaged and step.exact
    relaxation, before, at = 1.0, np.inf, z
    while True:
        seconds = time.perf_counter() - clock
        spaces = picks.spaces
        z = step(z, spaces, changed=changed, search=seconds, final=final)
        clock = time.perf_counter()
        moved = record.size(z.strain - at.strain, z.stress - at.stress)
        little = options.tolerance * record.size(z.strain, z.stress)
        local = np.sqrt(metric.squares(z.strain - at.strain, z.stress - at.stress))
        if averaged and moved > _SLOW * before:
            relaxation = max(_SLOW * relaxation, _LEAST_RELAXATION)
        before, at = moved, _between(at, z, relaxation)
        count = picks.look_up(at, local > max(moved, little) / np.sqrt(volume))
        changed, held = (int(n) for n in total(operator.comm, [count, picks.held.sum()]))
        settled = moved <= little if averaged else changed == 0
        if settled and final:
            break
        final = settled or (averaged and (step.exact or moved <= 10 * little))
        if picks.lookups >= options.hold_after:  # what is looked up next may be the end
            final = True
        if picks.lookups > options.hold_after:
            relaxation = 1.0
    reason = "state settled" if averaged else "no datum changed"
    if held:
        reason += f", {held} points held between data"
    return _result(record, search, z, spaces, linear=step.linear, reason=reason, lookups=picks.lookups, held=held)


def _between(a: MechanicalState, b: MechanicalState, part: float) -> MechanicalState:
    """The state ``part`` of the way from a to b."""
    pairs = ((a.u, b.u), (a.eta, b.eta), (a.strain, b.strain), (a.stress, b.stress))
    return b if part == 1.0 else MechanicalState(*(x + part * (y - x) for x, y in pairs))


def _support(data: Dataset, index: NDArray[np.int64], strain: Array) -> Array | None:
    """What clamps carry at the points (n, 6), Pa, of their data and how it changes with the strain (n, 6)."""
    if data.support is None:
        return None
    support = data.support[index]
    if data.support_tangent is not None:
        support = support + np.einsum("nij,nj->ni", data.support_tangent[index], strain - data.strain[index])
    return support


def _result(
    record: StepRecord, search: TangentSearch, z: MechanicalState, spaces: TangentSpaces, **more: Any
) -> SecondOrderResult:
    comm, w = record.projection.operator.comm, record.projection.operator.weights
    strain, stress = SpaceProjection(spaces, search.metric).closest(z.strain, z.stress)
    part = search.trusted(spaces, strain)[:, None]
    strain, stress = spaces.strain + part * (strain - spaces.strain), spaces.stress + part * (stress - spaces.stress)
    local = np.sqrt(search.metric.squares(z.strain - strain, z.stress - stress))
    outside = search.outside(z.strain)
    numbers = w @ local**2, w @ search.metric.squares(z.strain, z.stress), outside.sum(), (part < 1).sum(), len(w)
    sums = total(comm, [float(number) for number in numbers])
    return SecondOrderResult(
        problem=record.projection.problem,
        metric=search.metric,
        solver=record.projection.solver,
        dataset=search.dataset,
        queries=search.queries,
        skips=search.skips,
        mechanical=z,
        material_strain=strain,
        material_stress=stress,
        support=_support(search.dataset, spaces.index, z.strain),
        index=spaces.index,
        local_distance=local,
        distance=float(np.sqrt(sums[0])),
        normalised_distance=float(np.sqrt(sums[0] / sums[1])) if sums[1] > 0 else float(sums[0] > 0),
        outside_data=float(sums[2] / sums[4]),
        iterations=len(record.history),
        converged=True,
        history=tuple(record.history),
        extrapolated=float(sums[3] / sums[4]),
        **more,
    )
