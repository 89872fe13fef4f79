"""The data-driven solve: fixed-point iteration between the data set and the constraint set (paper, Section 4.1).

Queries are over-relaxed: the nearest datum is looked up of y + omega (z - y), with y the material and z the
mechanical state. With omega > 1 the iteration leaves its start behind, but may cycle, and on a fine mesh some points
change their datum for ever; so omega falls to 1 in a fixed number of iterations, and the best state found on the way is
finished with omega = 1, for which the distance can only fall and the iteration ends by itself.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.search import MaterialSearch
from dd_macro.methods.projection import MechanicalState, Projection
from dd_macro.methods.solution import Solution
from dd_macro.parallel import one_thread, total
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.errors import ConvergenceError, InputError

__all__ = ["DataDrivenResult", "Iteration", "SolverOptions", "point_keys", "solve"]

Array = NDArray[np.float64]
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SolverOptions:
    """How the fixed-point iteration runs.

    ``max_iterations`` bounds all iterations, ``tolerance`` is the relative change of the distance below which a
    step with omega = 1 has converged, ``over_relaxation`` is the omega to start with (1: the plain iteration), and
    ``annealing`` the number of iterations in which it falls to 1, after a quarter of them.

    Raises:
        InputError: on construction, where a value is out of range.
    """

    max_iterations: int = 300
    tolerance: float = 1e-8
    over_relaxation: float = 1.8
    annealing: int = 20

    def __post_init__(self) -> None:
        for name, good, expected in (
            ("max_iterations", self.max_iterations >= 1, "at least 1"),
            ("tolerance", 0 <= self.tolerance < 1, "a number in [0, 1)"),
            ("over_relaxation", 1 <= self.over_relaxation < 2, "a number in [1, 2)"),
            ("annealing", self.annealing >= 1, "at least 1"),
        ):
            if not good:
                raise InputError(f"{name}: expected {expected}, got {getattr(self, name)}")

    def omega(self, iteration: int) -> float:
        """Over-relaxation of an iteration, from 0: for a quarter of ``annealing`` the asked one, then down to 1."""
        part = 4.0 / 3.0 * (1.0 - iteration / self.annealing)
        return 1.0 + (self.over_relaxation - 1.0) * min(max(part, 0.0), 1.0)


@dataclass(frozen=True)
class Iteration:
    """One iteration: omega, the distance |y - z| in sqrt(J), points whose datum changed, and seconds on this rank."""

    omega: float
    distance: float
    changed: int
    seconds_search: float
    seconds_solve: float


@dataclass(frozen=True, kw_only=True, repr=False)
class DataDrivenResult(Solution):
    """The solution with data. ``outside_data`` is the fraction of quadrature points whose mechanical strain is outside
    the neighbourhood of the data (dd_macro.material.neighbourhood); ``queries`` were made of the search on this rank,
    of which ``skips`` needed none.
    """

    outside_data: float
    queries: int
    skips: int
    history: tuple[Iteration, ...]

    def figures(self) -> dict[str, tuple[Any, str]]:
        """Numbers of the solution for a summary, each with its unit; collective."""
        assert self.metric is not None
        queries, skips = (int(n) for n in total(self.problem.operator.comm, [self.queries, self.skips]))
        return super().figures() | {
            "converged": (self.converged, ""),
            "reason": (self.reason, ""),
            "distance": (self.distance, "sqrt(J)"),
            "outside_data": (self.outside_data, "fraction of quadrature points"),
            "metric": (self.metric.C, "Pa"),
            "metric_reason": (self.metric.reason, ""),
            "queries": (queries, ""),
            "queries_skipped": (skips, ""),
            "distance_history": ([i.distance for i in self.history], "sqrt(J)"),
            "changed_history": ([i.changed for i in self.history], ""),
            "seconds_search": (sum(i.seconds_search for i in self.history), "s"),
            "seconds_linear_solves": (sum(i.seconds_solve for i in self.history), "s"),
        }


@one_thread
def solve(
    projection: Projection,
    search: MaterialSearch,
    *,
    start: MechanicalState | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int, Iteration], None] | None = None,
) -> DataDrivenResult:
    """Data-driven solution of the scene of ``projection`` with the data of ``search``.

    Args:
        start: mechanical state whose nearest data start the iteration; the elastic solution with C if None.
        options: SolverOptions, default values if None.
        progress: called on every rank with the iteration's number and record.

    Raises:
        InputError: projection and search have different metrics.
        ConvergenceError: ``max_iterations`` were not enough, or the linear solver failed; it has the history.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))])
        >>> strain = np.random.default_rng(0).uniform(-0.02, 0.02, (500, 6))
        >>> C = dd.isotropic(young=1e3, poisson=0.3).C
        >>> data = tsg.Dataset(strain, strain @ C, "first_piola", path=np.zeros(500, int), step=np.arange(500))
        >>> metric = dd.metric_from_dataset(data)
        >>> solution = dd.solve(dd.project(problem, metric), dd.MaterialSearch(data, metric))
        >>> bool(solution.normalised_distance < 1.0)
        True
    """
    options = options or SolverOptions()
    if not np.array_equal(projection.metric.C, search.metric.C):
        raise InputError("metric: expected the same C in the projection and in the search, got two different ones")
    history: list[Iteration] = []
    try:
        return _iterate(projection, search, start or projection.elastic(), options, history, progress)
    except ConvergenceError as error:
        raise ConvergenceError(str(error), history) from None


def _iterate(
    projection: Projection,
    search: MaterialSearch,
    z: MechanicalState,
    options: SolverOptions,
    history: list[Iteration],
    progress: Callable[[int, Iteration], None] | None,
) -> DataDrivenResult:
    comm, w = projection.operator.comm, projection.operator.weights
    data = search.dataset
    metric = search.metric
    key = point_keys(projection.operator)
    index, _ = search.nearest(metric.whiten(z.strain, z.stress))
    best_distance, best_index = np.inf, index
    seen: set[int] = set()
    previous, relaxed = np.inf, True
    while len(history) < options.max_iterations:
        omega = options.omega(len(history)) if relaxed else 1.0
        clock = time.perf_counter()
        z = projection.project(data.strain[index], data.stress[index])
        solved = time.perf_counter()
        y_white = metric.whiten(data.strain[index], data.stress[index])
        z_white = metric.whiten(z.strain, z.stress)
        local = np.linalg.norm(z_white - y_white, axis=1)
        new, _ = search.nearest(y_white + omega * (z_white - y_white))
        sums = total(comm, [w @ local**2, (new != index).sum()])
        distance, changed = float(np.sqrt(sums[0])), int(sums[1])
        history.append(Iteration(omega, distance, changed, time.perf_counter() - solved, solved - clock))
        _log.info("iteration %d: distance %.6e, %d changed", len(history), distance, changed)
        if progress is not None:
            progress(len(history), history[-1])

        if omega > 1:
            if distance < best_distance * (1 - 1e-12):
                best_distance, best_index = distance, index
            state = comm.allreduce(int(np.sum(key * (new.astype(np.uint64) + np.uint64(1)))) % 2**61) % 2**61
            if changed == 0 or state in seen or options.omega(len(history)) == 1:
                relaxed, index = False, best_index  # finish from the best state found
            else:
                seen.add(state)
                index = new
            continue

        if changed == 0:
            reason = "no datum changed"
        elif previous - distance <= options.tolerance * distance:
            reason = "distance settled"
        else:
            previous, index = distance, new
            continue
        return _result(projection, search, z, index, local, reason, history)
    raise ConvergenceError(
        f"data-driven iteration: expected convergence within {options.max_iterations} iterations; "
        f"{history[-1].changed} data still changed in the last one, distance {history[-1].distance:.4g} sqrt(J)"
    )


def _result(
    projection: Projection,
    search: MaterialSearch,
    z: MechanicalState,
    index: NDArray[np.int64],
    local: Array,
    reason: str,
    history: list[Iteration],
) -> DataDrivenResult:
    comm, w = projection.operator.comm, projection.operator.weights
    data = search.dataset
    outside = search.outside(z.strain)
    size = search.metric.squares(z.strain, z.stress)
    sums = total(comm, [float(w @ local**2), float(w @ size), float(outside.sum()), float(len(w))])
    normalised = float(np.sqrt(sums[0] / sums[1])) if sums[1] > 0 else float(sums[0] > 0)
    return DataDrivenResult(
        problem=projection.problem,
        metric=projection.metric,
        solver=projection.solver,
        dataset=search.dataset,
        queries=search.queries,
        skips=search.skips,
        mechanical=z,
        material_strain=data.strain[index],
        material_stress=data.stress[index],
        support=None if data.support is None else data.support[index],
        index=index,
        local_distance=local,
        distance=float(np.sqrt(sums[0])),
        normalised_distance=normalised,
        outside_data=float(sums[2] / sums[3]),
        iterations=len(history),
        converged=True,
        reason=reason,
        history=tuple(history),
    )


def point_keys(operator: StrainOperator) -> NDArray[np.uint64]:
    """A pseudo-random odd number per quadrature point, the same on any number of ranks."""
    domain, nq = operator.domain, operator.points_per_cell
    cells = domain.mesh.topology.original_cell_index[: domain.owned_cells].astype(np.uint64)
    x = (cells[:, None] * np.uint64(nq) + np.arange(nq, dtype=np.uint64)).reshape(-1) + np.uint64(1)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):  # splitmix64
        x = (x ^ (x >> np.uint64(shift))) * np.uint64(factor)
    return (x ^ (x >> np.uint64(31))) | np.uint64(1)
