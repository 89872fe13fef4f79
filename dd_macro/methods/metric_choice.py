"""The metric of a problem by its name: from the data alone, or from those that the problem visits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dd_macro.material.metric import Metric, mean_tangent, metric_from_dataset, secant_modulus
from dd_macro.material.search import MaterialSearch
from dd_macro.methods.points import SolverOptions, solve
from dd_macro.methods.theory import project
from dd_macro.parallel import total
from dd_macro.scene.boundary import Displacement
from dd_macro.scene.loads import Load
from dd_macro.scene.problem import Problem
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["METRICS", "check_metric", "choose_metric", "visited_tangent"]

METRICS = ("auto", "tangent", "visited", "secant")
"""The data's default, the mean tangent of all data or of those that the scene visits, the secant modulus."""


def check_metric(name: str) -> None:
    """Raise InputError where there is no metric of this name."""
    if name not in METRICS:
        raise InputError(f"metric: expected one of {', '.join(METRICS)}, got {name!r}")


def choose_metric(name: str, problem: Problem, dataset: Dataset, *, order: int = 1) -> Metric:
    """The metric of this name for the problem; collective.

    What the data declare silent does not count in it, unless the tangents are asked (``order`` 2): those of RVEs answer
    every strain.

    Raises:
        InputError: no such metric, or the data give none.
        ConvergenceError: the solve that tells what is visited did not converge.
    """
    check_metric(name)
    if order == 2 and dataset.tangent is not None:
        dataset = replace(dataset, silent=())
    if name == "visited":
        return _visited(problem, dataset, None)
    choose = {"auto": metric_from_dataset, "tangent": mean_tangent, "secant": secant_modulus}[name]
    return choose(dataset)


def visited_tangent(
    operator: StrainOperator,
    dataset: Dataset,
    conditions: Sequence[Displacement],
    tractions: Sequence[Load] = (),
    *,
    options: SolverOptions | None = None,
) -> Metric:
    """Metric from the mean tangent of the data that a first solve ends on, each with the volume that it stands for.

    The first solve has the mean tangent of all data as its metric. Tangents of a sheet under strain differ by a factor
    of ten over the usual boxes of data, of which a scene visits a small part. Without tangents in the data it is their
    secant modulus, and nothing is solved.

    Raises:
        InputError: bad conditions, or the data give no modulus.
        ConvergenceError: the first solve did not converge.
    """
    return _visited(Problem(operator, conditions, tractions), dataset, options)


def _visited(problem: Problem, dataset: Dataset, options: SolverOptions | None) -> Metric:
    if dataset.tangent is None:
        return secant_modulus(dataset)
    everywhere = mean_tangent(dataset)
    result = solve(project(problem, everywhere), MaterialSearch(dataset, everywhere), options=options)
    operator = problem.operator
    local = np.bincount(result.index, weights=operator.weights, minlength=len(dataset))
    volume = total(operator.comm, local)
    metric = mean_tangent(dataset, volume)
    used = f"the {np.count_nonzero(volume)} of {len(dataset)} data that a first solve uses"
    return replace(metric, reason=f"mean tangent of {used}{metric.reason.partition(' data')[2]}")
