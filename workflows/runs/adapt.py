"""Adaptive sampling: the scene decides at which strains RVEs are computed, from a single datum or none on.

A round takes one step of the second-order solve from the last state on, which shows well enough what strains there
are, and adds RVEs at those where data are missing most (dd_macro.methods.clusters). It ends where the error that the
data leave is small, or the budget of RVEs is used; then the scene is solved to the end. The metric, and so the
factorised projection, is that of the first data throughout.

The error of second-order data goes with the square r^2 of the strain's distance from the nearest datum. A round that
lowers the mean of r^2 to a part rho leaves that part of the last error; what it changes is the rest, hence
error = change rho / (1 - rho).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

import dd_macro as dd
from dd_macro.methods.clusters import cluster
from dd_macro.methods.projection import relative_distance
from dd_macro.methods.second_order_steps import Record
from dd_macro.methods.theory import local_tangent_step
from dd_macro.parallel import one_thread, total
from tsg_micro.cells.parameters import CellParameters, check_bar_force
from tsg_micro.continuum.rve_law import sheet_rve
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError
from workflows.runs.adapt_data import AdaptedData
from workflows.runs.scene import Scene, make_metric

__all__ = ["Adaptation", "Adapted", "Round", "adapt", "adaptation", "known_bar_force"]

Array = NDArray[np.float64]
_MOST_ROUNDS = 1000
_LEFT = 0.9
"""Where a round hardly lowers the distance, the error is not more than nine times its change."""
_HOLD_AFTER = 8
"""Points still between two data after so many searches of the last solve do not matter to the error."""


@dataclass(frozen=True)
class Adaptation:
    """How the data are adapted: at most ``budget`` RVEs; done at an estimated error of ``tolerance`` or less.

    ``bar_force`` in N; None takes that of the data. A round has ``growth`` times the data that the last one used.

    Raises:
        InputError: on construction, where a value is out of range.
    """

    bar_force: float | None = None
    budget: int = 200
    tolerance: float = 5e-3
    growth: float = 4.0

    def __post_init__(self) -> None:
        if self.bar_force is not None:
            check_bar_force(self.bar_force, cells=1, EA_bar=CellParameters().EA_bar)
        if self.budget < 1:
            raise InputError(f"rve_budget: expected at least 1, got {self.budget}")
        if not 0 <= self.tolerance < 1:
            raise InputError(f"adapt_tolerance: expected a number from 0 to less than 1, got {self.tolerance}")
        if not 1 < self.growth < np.inf:
            raise InputError(f"growth: expected more than 1, got {self.growth}")


def adaptation(
    wanted: bool, *, bar_force: float | None, rve_budget: int | None, adapt_tolerance: float | None
) -> Adaptation | None:
    """What the command line's options ask for, None where they do not ask for it; None takes a default value.

    Raises:
        InputError: a value is out of range, or given although adaptation is not wanted.
    """
    given = {"bar_force": bar_force, "budget": rve_budget, "tolerance": adapt_tolerance}
    given = {name: value for name, value in given.items() if value is not None}
    if wanted:
        return Adaptation(**given)  # type: ignore[arg-type]
    if given:
        raise InputError("bar_force, rve_budget, adapt_tolerance: expected --adapt with them, got none")
    return None


@dataclass(frozen=True)
class Round:
    """One round. ``rves`` computed so far, ``failed`` ones among them, and ``data`` it had; ``iterations`` it took:
    none where elasticity is all that the one datum stands for, then one, in the last round those of the solve as well.
    ``change`` of the state since the last round in the metric, relative to the state, and the ``error`` that is left by
    it; None in the first. ``gap`` is the root mean square of the strain from the nearest datum, relative to that of the
    strain. ``surprise`` is the error that the last data had where RVEs were computed for this round: that of their
    stress, relative to all stress, which is more than the error elsewhere. Seconds count from the start.
    """

    rves: int
    failed: int
    data: int
    change: float | None
    error: float | None
    gap: float
    surprise: float | None
    seconds_rve: float
    iterations: int
    seconds: float


@dataclass(frozen=True)
class Adapted:
    """The last solve, the data that it used, all rounds, and why they ended; ``search`` is that of the last round."""

    result: dd.SecondOrderResult
    dataset: Dataset
    projection: dd.Projection
    search: dd.TangentSearch
    rounds: tuple[Round, ...]
    reason: str

    def figures(self) -> dict[str, tuple[Any, str]]:
        """For the summary: the history, one number a round, and where it ended."""
        last = self.rounds[-1]
        units = {"change": "1", "error": "1", "gap": "1", "surprise": "1", "seconds_rve": "s", "seconds": "s"}
        history = {
            f"{name}_rounds": ([getattr(r, name) for r in self.rounds], units.get(name, "")) for name in asdict(last)
        }
        ends = {"adapt_reason": (self.reason, ""), "rves": (last.rves, ""), "failed_rves": (last.failed, "")}
        return {**ends, "estimated_error": (last.error, "1"), "seconds_rve": (last.seconds_rve, "s"), **history}


def known_bar_force(plan: Adaptation, dataset: Dataset | None) -> float:
    """The bar force in N of the RVEs to compute.

    Raises:
        InputError: there is none, or the data have another one, no tangents or another kind of RVE.
    """
    bar_force = plan.bar_force
    if dataset is not None:
        if dataset.tangent is None:
            raise InputError("data: expected tangents for --adapt, got none")
        for source in dataset.sources:
            there = source.get("bar_force")
            bar_force = there if bar_force is None else bar_force
            if there is not None and there != bar_force:
                raise InputError(f"bar_force: expected that of the data, {there} N, got {bar_force}")
            if source.get("images", "merged") != "merged":
                raise InputError(f"data: expected RVEs with merged images for --adapt, got {source['images']}")
    if bar_force is None:
        why = "there are no data" if dataset is None else "the data do not say"
        raise InputError(f"bar_force: expected a force in N, since {why}, got none")
    return bar_force


@one_thread
def adapt(
    operator: dd.StrainOperator,
    conditions: list[dd.Displacement],
    plan: Adaptation,
    *,
    scene: Scene,
    dataset: Dataset | None,
    metric: str = "auto",
    measure: str | None = None,
    options: dd.SecondOrderOptions | None = None,
    keep: Callable[[Dataset], None] = lambda dataset: None,
    say: Callable[[str], None] = lambda text: None,
) -> Adapted:
    """Solve ``scene`` with ``dataset``, or the reference state alone, and with more data; collective.

    ``measure`` is the stress to solve in, that of the data or first Piola if None. ``keep`` gets the data of every
    round. The result does not depend on the number of ranks.

    Raises:
        InputError: as :func:`known_bar_force`, or the measure does not fit the data.
        ConvergenceError: a solve failed; the data until then were kept.
    """
    comm, w, begin = operator.comm, operator.weights, time.perf_counter()
    bar_force = known_bar_force(plan, dataset)
    data = AdaptedData(
        *(comm, dataset, sheet_rve(bar_force)),
        bar_force=bar_force,
        measure=measure or ("first_piola" if dataset is None else dataset.stress_measure),
        adapted={"load": scene.load, "strain": scene.strain},
    )
    C = make_metric(metric, operator, data.all, conditions, order=2)
    projection = dd.make_projection(operator, C, conditions)
    step = local_tangent_step(Record(projection, _MOST_ROUNDS, None))
    rounds: list[Round] = []
    z, surprise, away, reason = projection.elastic(), None, np.inf, ""
    while not reason:
        known = data.all
        keep(known)
        search = dd.TangentSearch(known, C)
        last, spaces, iterations = z, search.spaces(z.strain, z.stress), 0
        if rounds or dataset is not None:
            z, iterations = step(z, spaces, changed=0, search=0.0, final=step.exact), 1
        change = relative_distance(operator, C, last, z) if rounds else None
        (gap, new), old = _gap(comm, w, C, z.strain, known.strain[spaces.index]), away
        away, left = new, min(new / old, _LEFT) if old > 0 else _LEFT
        error = None if change is None else change * left / (1.0 - left)
        numbers = (data.rves, data.failed, len(known), change, error, gap, surprise, data.seconds)
        say(f"{data.rves} RVEs, {len(known)} data" + (f": estimated error {error:.2e}" if error is not None else ""))
        if error is not None and error <= plan.tolerance:
            reason = "estimated error reached"
        elif data.rves >= plan.budget:
            reason = "RVE budget used"
        else:
            used = np.count_nonzero(total(comm, np.bincount(spaces.index, minlength=len(known))))
            count, rest = max(1, round((plan.growth - 1.0) * used)), plan.budget - data.rves
            count = rest if rest < 2 * count else count  # no small round in the end
            wanted, nearest = cluster(comm, z.strain, w, known.strain, count=count, metric=C)
            found = data.add(wanted, known.strain[nearest]) if len(wanted) else None
            if found is None:
                reason = "no RVE reached its strain" if len(wanted) else "every strain has its datum"
            else:
                surprise = _surprise(found, search)
        if reason:
            options = replace(options or dd.SecondOrderOptions(), hold_after=_HOLD_AFTER)
            result = dd.solve_second_order(projection, search, start=z, options=options)
            iterations += result.iterations
        rounds.append(Round(*numbers, iterations, time.perf_counter() - begin))
    return Adapted(result, known, projection, search, tuple(rounds), reason)


def _gap(comm: MPI.Comm, w: Array, C: dd.Metric, strain: Array, datum: Array) -> tuple[float, float]:
    """Root mean square of the distance r of the strain from its datum, relative to that of the strain; that of r^2."""
    off, all_of_it = (((e @ C.factor) ** 2).sum(axis=1) for e in (strain - datum, strain))
    sums = total(comm, [w @ off, w @ all_of_it, w @ off**2])
    return float(np.sqrt(sums[0] / sums[1])), float(np.sqrt(sums[2]))


def _surprise(found: Dataset, search: dd.TangentSearch) -> float:
    """Error of the stress that the data of ``search`` predict for the strains of ``found``, relative, in the metric."""
    spaces, whiten = search.spaces(found.strain, found.stress), search.metric.whiten
    stress = spaces.stress + np.einsum("nij,nj->ni", spaces.tangent, found.strain - spaces.strain)
    size = np.linalg.norm(whiten(np.zeros_like(stress), found.stress))
    return float(np.linalg.norm(whiten(np.zeros_like(stress), stress - found.stress)) / size) if size > 0 else 0.0
