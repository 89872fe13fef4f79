"""The methods on the frontier of run time against error: each builds all that it needs, and solves the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from mpi4py import MPI

import dd_macro as dd
from tsg_micro.data.dataset import Dataset
from workflows.runs.adapt import Adaptation, adapt
from workflows.runs.scene import Scene, make_metric
from workflows.studies.methods import CLASSICAL, SECOND_ORDER, Way

__all__ = ["METHODS", "Method", "Solution", "adaptive"]


@dataclass(frozen=True)
class Solution:
    """A solved scene; ``note`` says how it went.

    ``material``: it has a material solution too, which a law has not. ``rves`` that the solve itself computed, and what
    they took of its time in s; None and 0 where it was given data.
    """

    operator: dd.StrainOperator
    result: dd.Solution
    note: str
    material: bool = True
    rves: int | None = None
    seconds_rve: float = 0.0


@dataclass(frozen=True)
class Method:
    """A way to solve a scene with given data, and the kinematics with which it is on the frontier."""

    name: str
    solve: Callable[[Scene, Dataset], Solution]
    kinematics: tuple[str, ...] = ("small",)


def with_data(scene: Scene, dataset: Dataset, *, way: Way, metric: str = "auto") -> Solution:
    """Data as points or as tangent spaces, with the metric of this name from what ``way`` makes of them.

    Raises:
        InputError: the data give no metric, or are too few for tangents to be estimated.
        ConvergenceError: the solve did not converge.
    """
    given, domain = way.data(dataset), scene.build(MPI.COMM_SELF)
    operator, conditions = scene.operator(domain), scene.conditions(domain)
    C = make_metric(metric, operator, given, conditions, order=way.order)
    result = way.solve(dd.make_projection(operator, C, conditions), way.search(given, C))
    return Solution(operator, result, f"{result.iterations} iterations")


def law(scene: Scene, dataset: Dataset, *, fit: Callable[[Dataset], dd.Law]) -> Solution:
    """A law fitted to the data, solved by Newton's method.

    Raises:
        InputError, ConvergenceError: the fit or the solve failed.
    """
    fitted, domain = fit(dataset), scene.build(MPI.COMM_SELF)
    operator = scene.operator(domain)
    result = dd.solve_law(operator, fitted, scene.conditions(domain))
    return Solution(operator, result, f"{result.iterations} Newton iterations", material=False)


def adaptive(scene: Scene, *, bar_force: float, budget: int, measure: str) -> Solution:
    """From nothing: the scene decides at which strains its ``budget`` of RVEs, bar force in N, is computed.

    ``measure`` is the stress of the solution.

    Raises:
        ConvergenceError: the solve did not converge.
    """
    domain = scene.build(MPI.COMM_SELF)
    operator, plan = scene.operator(domain), Adaptation(bar_force, budget, tolerance=0.0)
    found = adapt(operator, scene.conditions(domain), plan, scene=scene, dataset=None, measure=measure)
    last = found.rounds[-1]
    note = f"{len(found.rounds)} rounds, {sum(r.iterations for r in found.rounds)} iterations"
    return Solution(operator, found.result, note, rves=last.rves, seconds_rve=last.seconds_rve)


_CLASSICAL, _SECOND = CLASSICAL["classical"], SECOND_ORDER["second order"]
_ESTIMATED = SECOND_ORDER["second order, estimated tangents"]
METHODS = (
    Method("data-driven, metric tangent", partial(with_data, way=_CLASSICAL, metric="tangent")),
    Method("data-driven, metric visited", partial(with_data, way=_CLASSICAL, metric="visited")),
    Method("data-driven, metric secant", partial(with_data, way=_CLASSICAL, metric="secant")),
    Method("second-order data", partial(with_data, way=_SECOND), ("small", "finite")),
    Method("second-order data, estimated tangents", partial(with_data, way=_ESTIMATED)),
    Method("linear elastic law", partial(law, fit=dd.fit_linear)),
    Method("polynomial energy law", partial(law, fit=dd.fit_polynomial)),
)
"""All that solve a scene with given data."""
