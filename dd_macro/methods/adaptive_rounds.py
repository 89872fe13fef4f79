"""The rounds of adaptive sampling: a step with the data that are there, the error that they leave, and more data.

A round takes one step of the second-order solve from the last state on, which shows well enough what strains there
are, and asks the source for data at those where they are missing most (dd_macro.methods.clusters). It ends where the
error that the data leave is small, or the budget is used; then the problem is solved to the end. The metric, and so the
factorised projection, is that of the first data throughout.

The error of second-order data goes with the square r^2 of the strain's distance from the nearest datum. A round that
lowers the mean of r^2 to a part rho leaves that part of the last error; what it changes is the rest, hence
error = change rho / (1 - rho).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro.material.graded import Coordinates, GradedTangents
from dd_macro.material.metric import Metric
from dd_macro.material.regional import search_in_regions
from dd_macro.material.tangent_spaces import StrainSearch, TangentSearch
from dd_macro.methods.adaptive_data import AllData, PartData
from dd_macro.methods.clusters import cluster
from dd_macro.methods.method import Material
from dd_macro.methods.metric_choice import choose_metric
from dd_macro.methods.projection import MechanicalState, relative_distance
from dd_macro.methods.second_order import SecondOrderOptions, SecondOrderResult, iterate
from dd_macro.methods.second_order_steps import StepRecord
from dd_macro.methods.theory import local_tangent_step, project
from dd_macro.parallel import span, total
from dd_macro.scene.problem import Problem
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["Adaptation", "Round", "Rounds"]

Array = NDArray[np.float64]
_MOST_ROUNDS = 1000
_LEFT = 0.9
"""Where a round hardly lowers the distance, the error is not more than nine times its change."""
_LEAVE = 0.03
"""Part of the out-of-balance force that a round may leave: it has to show which strains there are."""


@dataclass(frozen=True)
class Adaptation:
    """How the data are adapted: at most ``budget`` new ones; done at an estimated error of ``tolerance`` or less.

    A round has ``growth`` times the data that the last one used.

    Raises:
        InputError: on construction, where a value is out of range.
    """

    budget: int = 200
    tolerance: float = 5e-3
    growth: float = 4.0

    def __post_init__(self) -> None:
        if self.budget < 1:
            raise InputError(f"rve_budget: expected at least 1, got {self.budget}")
        if not 0 <= self.tolerance < 1:
            raise InputError(f"adapt_tolerance: expected a number from 0 to less than 1, got {self.tolerance}")
        if not 1 < self.growth < np.inf:
            raise InputError(f"growth: expected more than 1, got {self.growth}")


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


class Rounds:
    """What goes from round to round: the state, the search of the last data, how far its strains are from them."""

    def __init__(self, problem: Problem, material: Material, plan: Adaptation, start: MechanicalState | None) -> None:
        comm, given = problem.operator.comm, material.each
        self._forces = [part.bar_forces(problem, k) for k, part in enumerate(given)]
        parts = [PartData(part, _spread(comm, own)) for part, own in zip(given, self._forces, strict=True)]
        self.problem, self.plan, self.data = problem, plan, AllData(parts)
        metric = material.metric
        if isinstance(metric, str):
            metric = choose_metric(metric, problem, parts[0].all, order=2)
        self.projection = project(problem, metric)
        self._onto = local_tangent_step(StepRecord(self.projection, _MOST_ROUNDS, None))
        self._onto.leave = _LEAVE
        self._points = [np.flatnonzero(problem.region_of_points == k) for k in range(len(parts))]
        self._away = np.inf
        self._surprise: float | None = None
        self.z = self.projection.elastic() if start is None else start
        size = _root_mean_square(comm, problem.operator.weights, metric, self.z.strain)
        _, strained = span(comm, np.abs(self.z.strain))
        # a body that nothing loads is moved by the stress of its data at rest alone
        self._given = given[0].dataset is not None or not strained.any()
        self._coordinates = [Coordinates(metric, None if own is None else size) for own in self._forces]
        self.done: list[Round] = []
        self.reason = ""
        self.seconds = 0.0

    def step(self, known: Dataset) -> dict[str, Any]:
        """One step with the data ``known``: the numbers of its round."""
        operator, C, last, data = self.problem.operator, self.projection.metric, self.z, self.data
        parts = zip(data.parts, self._coordinates, self._forces, strict=True)
        self._searches = [_search(part.all, at, own) for part, at, own in parts]
        self.search = search_in_regions(self._searches, self.problem.region_of_points)
        self.spaces, iterations = self.search.spaces(last.strain, last.stress), 0
        if self.done or self._given:
            step = self._onto
            self.z, iterations = step(last, self.spaces, changed=0, search=0.0, final=False), 1
        change = relative_distance(operator, C, last, self.z) if self.done else None
        (gap, new), old = _gap(operator.comm, operator.weights, C, self.z.strain, self._off(known)), self._away
        self._away, left = new, min(new / old, _LEFT) if old > 0 else _LEFT
        return {
            "rves": data.rves,
            "failed": data.failed,
            "data": len(known),
            "change": change,
            "error": None if change is None else change * left / (1.0 - left),
            "gap": gap,
            "surprise": self._surprise,
            "seconds_rve": data.seconds,
            "iterations": iterations,
        }

    def _off(self, known: Dataset) -> Array:
        """How far the points (n,) are from their data, in strain and bar force."""
        off = np.empty(len(self.z.strain))
        for where, at, own in zip(self._coordinates, self._points, self._forces, strict=True):
            datum = self.spaces.index[at]
            there = None if own is None or known.bar_force is None else known.bar_force[datum]
            x = where.of(self.z.strain[at], None if there is None else own)
            off[at] = np.linalg.norm(x - where.of(known.strain[datum], there), axis=1)
        return off

    def finish(self, options: SecondOrderOptions) -> SecondOrderResult:
        """The problem solved to the end, with the matrix of the rounds."""
        self.seconds = sum(i.seconds_solve for i in self._onto.record.history)
        self._onto.record, self._onto.leave = StepRecord(self.projection, options.max_iterations, None), 0.0
        del self.spaces  # the solve has its own
        return iterate(self._onto, self.search, self.z, options)

    def grow(self, known: Dataset) -> None:
        """Ask for more data, or say why there are no more."""
        comm, w, plan = self.problem.operator.comm, self.problem.operator.weights, self.plan
        times = total(comm, np.bincount(self.spaces.index, minlength=len(known)))
        begin = np.cumsum([0, *(len(part.all) for part in self.data.parts)])
        used = np.array([np.count_nonzero(times[a:b]) for a, b in itertools.pairwise(begin)])
        count = _shares(np.maximum(1, np.round((plan.growth - 1.0) * used)).astype(int), plan.budget - self.data.rves)
        found: list[float] = []
        asked = 0
        each = zip(self.data.parts, self._searches, self._points, self._coordinates, self._forces, count, strict=True)
        for part, search, at, where, own, more in each:
            if more == 0:
                continue
            data = part.all
            there = where.of(data.strain, data.bar_force)
            places, nearest = cluster(comm, where.of(self.z.strain[at], own), w[at], there, count=int(more))
            asked += len(places)
            if len(places):
                strains, forces = where.back(places)
                new = part.add(strains, data.strain[nearest], forces)
                found += [] if new is None else [_surprise(new, search)]
        if not found:
            self.reason = "no RVE reached its strain" if asked else "every strain has its datum"
        else:
            self._surprise = max(found)


def _shares(count: NDArray[np.int64], rest: int) -> NDArray[np.int64]:
    """How many to ask for in each part, not more than the ``rest``; all of it where no small round would be left."""
    if rest >= 2 * count.sum():
        return count
    part = rest * count / count.sum()
    share = np.floor(part).astype(np.int64)
    share[np.argsort(share - part, kind="stable")[: rest - share.sum()]] += 1
    return share


def _gap(comm: MPI.Comm, w: Array, C: Metric, strain: Array, off: Array) -> tuple[float, float]:
    """Root mean square of the distance ``off`` (n,) from the data, over that of the strain; that of its square."""
    size = ((strain @ C.factor) ** 2).sum(axis=1)
    sums = total(comm, [w @ off**2, w @ size, w @ off**4])
    gap = float(np.sqrt(sums[0] / sums[1])) if sums[1] > 0 else float(sums[0] > 0)  # a body may be without load
    return gap, float(np.sqrt(sums[2]))


def _root_mean_square(comm: MPI.Comm, w: Array, C: Metric, strain: Array) -> float:
    """That of the strain, in the metric; where there is none, one that is small for any tissue."""
    sums = total(comm, np.array([w @ ((strain @ C.factor) ** 2).sum(axis=1), w.sum()]))
    return float(np.sqrt(sums[0] / sums[1])) or 1e-3 * float(np.sqrt(np.trace(C.C)))


def _spread(comm: MPI.Comm, forces: Array | None) -> Array | None:
    """The least, the middle and the largest of bar forces (n,) of all ranks; collective where there are some."""
    if forces is None:
        return None
    low, high = span(comm, forces)
    return np.unique([low, np.sqrt(low * high), high])


def _search(dataset: Dataset, where: Coordinates, forces: Array | None) -> TangentSearch:
    """The search of a part, by strain, and by bar force where it varies."""
    if forces is None or where.gamma is None:
        return StrainSearch(dataset, where.metric)
    return GradedTangents(dataset, where.metric, at=forces, gamma=where.gamma)


def _surprise(found: Dataset, search: TangentSearch) -> float:
    """Error of the stress that the data of ``search`` predict for the strains of ``found``, relative, in the metric."""
    if isinstance(search, GradedTangents) and found.bar_force is not None:
        search = search.for_points(found.bar_force)
    spaces, whiten = search.spaces(found.strain, found.stress), search.metric.whiten
    stress = spaces.stress_at(found.strain)
    size = np.linalg.norm(whiten(np.zeros_like(stress), found.stress))
    return float(np.linalg.norm(whiten(np.zeros_like(stress), stress - found.stress)) / size) if size > 0 else 0.0
