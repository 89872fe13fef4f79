"""Adaptive sampling: the scene decides at which strains RVEs are computed, from a single datum or none on.

A round solves the scene with second-order data from the last state on, and adds RVEs at the strains where data are
missing most (workflows.clusters). It ends where the state does not change any more, or the budget of RVEs is used.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import dd_macro as dd
from dd_macro.parallel import total
from tsg_micro.dataset import Dataset, convert_dataset, join_datasets
from tsg_micro.errors import ConvergenceError, InputError
from tsg_micro.mandel import to_mandel
from tsg_micro.parameters import CellParameters, check_bar_force
from tsg_micro.rve import RVE, RVEState
from workflows.clusters import cluster
from workflows.record import versions
from workflows.rve_law import sheet_rve
from workflows.scene import Scene, make_metric

__all__ = ["Adaptation", "Adapted", "Round", "adapt", "adaptation", "compute_states", "known_bar_force"]

Array = NDArray[np.float64]
_SHORTER = 3


@dataclass(frozen=True)
class Adaptation:
    """How the data are adapted: at most ``budget`` RVEs; done where a round changes the state by ``tolerance`` or less.

    ``bar_force`` in N; None takes that of the data. A round doubles the data: its change tells what they lacked.

    Raises:
        InputError: on construction, where a value is out of range.
    """

    bar_force: float | None = None
    budget: int = 200
    tolerance: float = 2e-3

    def __post_init__(self) -> None:
        if self.bar_force is not None:
            check_bar_force(self.bar_force, cells=1, EA_bar=CellParameters().EA_bar)
        if self.budget < 1:
            raise InputError(f"rve_budget: expected at least 1, got {self.budget}")
        if not 0 <= self.tolerance < 1:
            raise InputError(f"adapt_tolerance: expected a number from 0 to less than 1, got {self.tolerance}")


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
    """One solve. ``rves`` computed so far, ``failed`` ones among them, and ``data`` it had; ``iterations`` it took.
    ``change`` of the state since the last round in the metric, relative to the state; None in the first. ``gap`` is the
    root mean square of the strain from the nearest datum, relative to that of the strain. ``surprise`` is the error
    that the last data had where RVEs were computed for this round: that of their stress, relative to all stress, which
    is more than the error elsewhere.
    """

    rves: int
    failed: int
    data: int
    iterations: int
    change: float | None
    gap: float
    surprise: float | None
    seconds_rve: float
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
        units = {"change": "1", "gap": "1", "surprise": "1", "seconds_rve": "s", "seconds": "s"}
        history = {
            f"{name}_rounds": ([getattr(r, name) for r in self.rounds], units.get(name, "")) for name in asdict(last)
        }
        ends = {"adapt_reason": (self.reason, ""), "rves": (last.rves, ""), "failed_rves": (last.failed, "")}
        return {**ends, "change": (last.change, "1"), "seconds_rve": (last.seconds_rve, "s"), **history}


def known_bar_force(plan: Adaptation, dataset: Dataset | None) -> float:
    """The bar force in N of the RVEs to compute.

    Raises:
        InputError: there is none, or the data have another one, no tangents or another kind of RVE.
    """
    bar_force = plan.bar_force
    if dataset is not None:
        if dataset.tangent is None:
            raise InputError("data: expected tangents for --adapt, got none")
        for source in dataset.parameters.get("joined", [dataset.parameters]):
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


class _Data:
    """The data so far, the RVE that makes more of them, and what it did."""

    def __init__(self, comm: MPI.Comm, base: Dataset | None, plan: Adaptation, measure: str | None, scene: Scene):
        bar_force = known_bar_force(plan, base)
        self.comm, self.rve = comm, sheet_rve(bar_force)
        self.measure = measure or ("first_piola" if base is None else base.stress_measure)
        made_for = {"load": scene.load, "strain": scene.strain}
        rve = {"bar_force": bar_force, "blocks": [1, 1, 1], "images": "merged", "cell": asdict(CellParameters())}
        self.parameters = {**rve, "adapted": made_for}
        self.base = None if base is None else convert_dataset(base, self.measure)
        self.all, self._new = self.base, None  # type: Dataset | None, Dataset | None
        self.rves = self.failed = self.calls = 0
        self.seconds = 0.0

    def add(self, strains: Array, origins: Array) -> Dataset | None:
        """Add the RVEs at ``strains`` and return them; see :func:`compute_states`."""
        clock = time.perf_counter()
        states = compute_states(self.comm, self.rve, strains, origins)
        self.seconds += time.perf_counter() - clock
        self.rves += len(strains)
        self.failed += sum(state is None for state in states)
        self.calls += 1
        reached = [state for state in states if state is not None]
        if not reached:
            return None
        found = convert_dataset(_dataset(reached, self.parameters, self.calls - 1), self.measure)
        self._new = found if self._new is None else _append(self._new, found)
        self.all = self._new if self.base is None else join_datasets(self.base, self._new)
        return found


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
    data = _Data(comm, dataset, plan, measure, scene)
    if data.all is None:
        data.add(np.zeros((1, 6)), np.zeros((1, 6)))
    rounds: list[Round] = []
    z: dd.MechanicalState | None = None
    surprise = None
    while True:
        known = data.all
        if known is None:
            raise ConvergenceError("RVE: expected equilibrium in its reference state, got none")
        keep(known)
        C = make_metric(metric, operator, known, conditions, order=2)
        projection, search = dd.make_projection(operator, C, conditions), dd.TangentSearch(known, C)
        result = dd.solve_second_order(projection, search, start=z, options=options)
        last, z = z, result.mechanical
        change = None if last is None else _change(comm, w, C, z, last)
        numbers = (data.rves, data.failed, len(known), result.iterations, change, _gap(operator, result, known, C))
        rounds.append(Round(*numbers, surprise, data.seconds, time.perf_counter() - begin))
        changed = "" if change is None else f", state changed by {change:.2e}"
        say(f"{data.rves} RVEs, {len(known)} data: {result.iterations} iterations{changed}")
        left = plan.budget - data.rves
        if change is not None and change <= plan.tolerance:
            reason = "state settled"
            break
        if left <= 0:
            reason = "RVE budget used"
            break
        wanted, nearest = cluster(comm, z.strain, w, known.strain, count=min(left, len(known)), metric=C)
        found = data.add(wanted, known.strain[nearest]) if len(wanted) else None
        if found is None:
            reason = "no RVE reached its strain" if len(wanted) else "every strain has its datum"
            break
        surprise = _surprise(found, search)
    return Adapted(result, known, projection, search, tuple(rounds), reason)


def _gap(operator: dd.StrainOperator, result: dd.SecondOrderResult, data: Dataset, C: dd.Metric) -> float:
    strain = result.mechanical.strain
    off, all_of_it = (((e @ C.factor) ** 2).sum(axis=1) for e in (strain - data.strain[result.index], strain))
    sums = total(operator.comm, [operator.weights @ off, operator.weights @ all_of_it])
    return float(np.sqrt(sums[0] / sums[1]))


def _change(comm: MPI.Comm, w: Array, C: dd.Metric, z: dd.MechanicalState, last: dd.MechanicalState) -> float:
    now, off = C.whiten(z.strain, z.stress), C.whiten(z.strain - last.strain, z.stress - last.stress)
    sums = total(comm, [w @ (off**2).sum(axis=1), w @ (now**2).sum(axis=1)])
    return float(np.sqrt(sums[0] / sums[1]))


def _surprise(found: Dataset, search: dd.TangentSearch) -> float:
    """Error of the stress that the data of ``search`` predict for the strains of ``found``, relative, in the metric."""
    spaces, whiten = search.spaces(found.strain, found.stress), search.metric.whiten
    stress = spaces.stress + np.einsum("nij,nj->ni", spaces.tangent, found.strain - spaces.strain)
    size = np.linalg.norm(whiten(np.zeros_like(stress), found.stress))
    return float(np.linalg.norm(whiten(np.zeros_like(stress), stress - found.stress)) / size) if size > 0 else 0.0


def compute_states(comm: MPI.Comm, rve: RVE, strains: Array, origins: Array) -> list[RVEState | None]:
    """States of the RVE at ``strains`` (k, 6), shared among the ranks; every one comes from the reference state.

    Where the equilibrium is lost on the way, the strain is halved towards that of ``origins`` (k, 6), a few times.
    """
    mine: dict[int, RVEState | None] = {}
    with threadpool_limits(1):
        for k in range(comm.rank, len(strains), comm.size):
            mine[k] = None
            for part in 0.5 ** np.arange(_SHORTER):
                rve.reset()
                try:
                    state = rve.solve_strain(origins[k] + part * (strains[k] - origins[k]))
                except (ConvergenceError, InputError):  # the latter: inside out
                    continue
                mine[k] = dataclasses.replace(state, rate=None)
                break
    states = {k: state for part in comm.allgather(mine) for k, state in part.items()}
    return [states[k] for k in range(len(strains))]


def _dataset(states: list[RVEState], parameters: dict[str, Any], path: int) -> Dataset:
    """The states as data of first Piola stress, the round as their path."""
    F = np.array([state.F for state in states])
    return Dataset(
        strain=to_mandel(F - np.eye(3)),
        stress=to_mandel(np.array([state.first_piola for state in states])),
        stress_measure="first_piola",
        path=np.full(len(states), path),
        step=np.arange(len(states)),
        tangent=np.array([state.tangent for state in states]),
        deformation_gradient=F,
        energy=np.array([state.energy for state in states]),
        parameters=parameters,
        versions=versions(),
    )


def _append(first: Dataset, second: Dataset) -> Dataset:
    """Both as one, of one run: unlike join_datasets it has one source, and paths that are the rounds."""
    b = second.arrays()
    arrays: dict[str, Any] = {name: np.concatenate([a, b[name]]) for name, a in first.arrays().items()}
    return dataclasses.replace(first, **arrays)
