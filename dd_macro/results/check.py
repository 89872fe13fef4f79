"""The error of a solution by the stress that its material has at strains that the solution visits.

r = sigma - sigma(material at its strain) is known at a few points: there the material itself is asked, a source of
data. They are drawn by volume and by where data are furthest, spread over the data (dd_macro.methods.check_points), so
that their sum sum w / pi |r|^2 is in the mean that of all points. With the answers also as tangent spaces, that of the
nearest strain for each point of the body, r is known everywhere well enough to say how the state follows it
(dd_macro.methods.correction), and the
    error = |dz| / |z + dz|  (sum w / pi |r|^2 / sum w |r'|^2)^1/2,
r' the residual of the tangent spaces, whose own error is of second order in the distance to the nearest strain and
may be more than that of many data. What clamps carry beside sigma adds its own residual.
|.| is the length of states in the metric of the secants of the answers.

Where nothing can be asked, the data themselves answer, with tangents: all of them where they were taken as points, all
but its own datum at each point where they were taken as tangent spaces. What leaving it out changes is the estimate
then, which is rather too large than too small, since what takes its place is further away.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dd_macro.material.distinct import first_of_equal
from dd_macro.material.estimated_tangents import estimate_tangents
from dd_macro.material.metric import Metric, mean_tangent, secant_modulus
from dd_macro.material.source import Source
from dd_macro.methods.check_points import Drawn, Points, draw, shares
from dd_macro.methods.correction import Correction, correct
from dd_macro.methods.second_order import SecondOrderResult
from dd_macro.methods.solution import Solution
from dd_macro.parallel import one_thread, total
from dd_macro.products import times
from tsg_micro.data.dataset import Dataset, convert_dataset
from tsg_micro.data.errors import InputError

__all__ = ["CHECKS", "ErrorEstimate", "check_by_data", "check_by_source"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
CHECKS = 12
_AT_ONCE, _SAME = 4, 1e-9
_LEAST, _NEIGHBOURS = 4, 16


@dataclass(frozen=True)
class ErrorEstimate:
    """The ``error`` of the state, relative, in the energy norm; None where nothing could be asked.

    ``kind`` says what answered, ``checks`` at how many points, of which ``failed`` got no answer: the material has no
    equilibrium there, and all of their stress counts as residual. It took ``seconds``.
    """

    error: float | None
    kind: str
    checks: int = 0
    failed: int = 0
    seconds: float = 0.0

    def figures(self) -> dict[str, tuple[Any, str]]:
        """Its numbers for a summary, each with its unit."""
        return {
            "estimated_error": (self.error, "1"),
            "error_kind": (self.kind, ""),
            "checks": (self.checks, ""),
            "failed_checks": (self.failed, ""),
            "seconds_check": (self.seconds, "s"),
        }


@one_thread
def check_by_source(
    solution: Solution, sources: Sequence[Source], *, bar_force: Array | None = None, count: int = CHECKS
) -> ErrorEstimate:
    """The error by the answers of ``sources``, one for each region of the problem, at ``count`` points; collective.

    ``bar_force`` (n,) in N is that of the points, where it varies in their region, 0 elsewhere.

    Raises:
        InputError: the stress measure of the solution's data cannot be had of the answers.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))])
        >>> source = tsg.RVESource(tsg.RVESpec.of_kind("sheet", tsg.Tissue(bar_force=1e-8)))
        >>> solution = dd.AdaptiveMethod().prepare(problem, dd.Material(source=source)).solve()
        >>> bool(dd.check_by_source(solution, [source]).error < 0.05)
        True
    """
    begin = time.perf_counter()
    problem, z = solution.problem, solution.mechanical
    op, region = problem.operator, problem.region_of_points
    share = shares(op.comm, op.weights, _expected(solution))
    groups = 1 if solution.dataset is None else len(solution.dataset)
    support = np.zeros_like(z.stress) if solution.support is None else solution.support
    force = np.zeros(len(region)) if bar_force is None else bar_force
    drawn = draw(
        op, Points(z.strain, z.stress, support, region, force, np.maximum(solution.index, 0), groups), share, count
    )
    del support, force, share
    measure = "first_piola" if solution.dataset is None else solution.dataset.stress_measure
    answers, answered = _ask(sources, drawn, measure)
    failed = int((~answered).sum())
    kind = "check RVEs"
    if answers is None:
        return ErrorEstimate(None, kind, len(answered), failed, time.perf_counter() - begin)
    metric = _metric_of(answers, drawn.weight[answered])
    residual = drawn.stress.copy()
    residual[answered] -= answers.stress
    squares = drawn.weight * (metric.whiten(np.zeros_like(residual), residual) ** 2).sum(axis=1)
    sampled, unanswered = (float(np.sqrt(squares[which].sum())) for which in (answered, ~answered))
    near = _nearest(answers.strain, drawn.region[answered], z.strain, region, metric)
    found = _corrected(answers, near, solution, metric)
    ratio = sampled / found.residual if found.residual > 0 else 0.0
    off = np.zeros_like(residual)
    off[answered] = drawn.support[answered] - (0.0 if answers.support is None else answers.support)
    beside = float(np.sqrt(drawn.weight @ (metric.whiten(np.zeros_like(off), off) ** 2).sum(axis=1)))
    left = np.linalg.norm([found.change * ratio, unanswered, beside])
    error = float(left) / found.state if found.state > 0 else 0.0
    return ErrorEstimate(error, kind, len(answered), failed, time.perf_counter() - begin)


@one_thread
def check_by_data(solution: Solution) -> ErrorEstimate:
    """The error by the data of the solution, those that it did not use at each point; collective.

    It is None where the data are too few to answer each other.
    """
    begin = time.perf_counter()
    problem, z, data = solution.problem, solution.mechanical, solution.dataset
    own = isinstance(solution, SecondOrderResult)
    kind = "data without their own" if own else "tangents of the data"
    if data is None or len(first_of_equal(data.strain)) < _LEAST or not (data.strain.any() and data.stress.any()):
        return ErrorEstimate(None, kind, seconds=time.perf_counter() - begin)
    if data.tangent is None:
        data = estimate_tangents(data, neighbours=min(len(data) - 1, _NEIGHBOURS))
    metric = solution.metric or _metric_of(data, np.ones(len(data)))
    near = _other(data, z.strain, solution.index if own else None, metric)
    found = _corrected(data, near, solution, metric)
    error = found.change / found.state if found.state > 0 else 0.0
    points = int(total(problem.operator.comm, len(near)))
    return ErrorEstimate(error, kind, points, 0, time.perf_counter() - begin)


def _expected(solution: Solution) -> Array:
    """What |r|^2 is thought to go with (n,): the square of the distance to the datum, or its fourth power, in the
    strain, where the datum is a tangent space.
    """
    if not isinstance(solution, SecondOrderResult):
        return np.asarray(solution.local_distance**2)
    assert solution.dataset is not None
    assert solution.metric is not None
    away = (solution.mechanical.strain - solution.dataset.strain[solution.index]) @ solution.metric.factor
    return np.asarray((away**2).sum(axis=1) ** 2)


def _ask(sources: Sequence[Source], drawn: Drawn, measure: str) -> tuple[Dataset | None, NDArray[np.bool_]]:
    """The answers in the order of the points that were answered, and the mask of these points.

    Small strains are asked for first, a few at a time: a source goes on from the states that it has.
    """
    answered = np.zeros(len(drawn.weight), dtype=bool)
    parts: list[tuple[Index, Dataset]] = []
    by_size = np.argsort(np.linalg.norm(drawn.strain, axis=1), kind="stable")
    for k, source in enumerate(sources):
        of_region = by_size[drawn.region[by_size] == k]
        for begin in range(0, len(of_region), _AT_ONCE):
            here = of_region[begin : begin + _AT_ONCE]
            wanted = drawn.strain[here]
            forces = drawn.bar_force[here]
            found = source.states(wanted, wanted, *((forces,) if forces.any() else ()))
            if found is None:
                continue
            reached = _reached(found.strain, wanted)
            answered[here[reached]] = True
            parts.append((here[reached], convert_dataset(found, measure)))
    if not parts:
        return None, answered
    order = np.argsort(np.concatenate([here for here, _ in parts]))
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for _, part in parts])[order]
        for name in ("strain", "stress", "tangent", "path", "step")
    }
    if any(part.support is not None for _, part in parts):
        carried = [np.zeros_like(part.stress) if part.support is None else part.support for _, part in parts]
        arrays["support"] = np.concatenate(carried)[order]
    return Dataset(stress_measure=measure, **arrays), answered


def _reached(found: Array, wanted: Array) -> Index:
    """The numbers of the strains ``wanted`` (k, 6) that are in ``found`` (m, 6), which has them in their order."""
    numbers, at = [], 0
    for k, strain in enumerate(wanted):
        if at < len(found) and np.abs(found[at] - strain).max() <= _SAME:
            numbers.append(k)
            at += 1
    return np.array(numbers, dtype=np.int64)


def _metric_of(answers: Dataset, weight: Array) -> Metric:
    """The metric of the secants of the answers, each with its ``weight``; of their tangents where all are at rest."""
    root = np.sqrt(weight / weight.mean())[:, None]
    try:
        weighted = Dataset(
            answers.strain * root, answers.stress * root, answers.stress_measure, answers.path, answers.step
        )
        return secant_modulus(weighted)
    except InputError:
        return mean_tangent(answers, weight)


def _nearest(at: Array, region_at: Index, strain: Array, region: Index, metric: Metric) -> Index:
    """The nearest of the strains ``at`` (k, 6) to each of ``strain`` (n, 6), of its own region if that has one."""
    near = np.zeros(len(strain), dtype=np.int64)
    for k in np.unique(region):
        here, there = np.flatnonzero(region == k), np.flatnonzero(region_at == k)
        there = there if len(there) else np.arange(len(at))
        near[here] = there[cKDTree(at[there] @ metric.factor).query(strain[here] @ metric.factor)[1]]
    return near


def _other(data: Dataset, strain: Array, own: Index | None, metric: Metric) -> Index:
    """The datum nearest in strain (n,), at another strain than the ``own`` datum (n,) if there is one."""
    _, first, same = np.unique(data.strain, axis=0, return_index=True, return_inverse=True)
    _, two = cKDTree(data.strain[first] @ metric.factor).query(strain @ metric.factor, k=2)
    place = two[:, 0] if own is None else np.where(same.reshape(-1)[own] == two[:, 0], two[:, 1], two[:, 0])
    return np.asarray(first[place], dtype=np.int64)


def _corrected(data: Dataset, near: Index, solution: Solution, metric: Metric) -> Correction:
    """The correction of the solution for its residual against the tangent spaces of these data (n,)."""
    assert data.tangent is not None
    z = solution.mechanical
    residual = z.stress - data.stress[near] - times(data.tangent, near, z.strain - data.strain[near])
    return correct(solution.problem, z, residual, data.tangent, near, metric, older=solution.linear)
