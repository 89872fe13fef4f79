"""The methods on the frontier of run time against error: each builds all that it needs, and solves the scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from mpi4py import MPI

import dd_macro as dd
from tsg_micro.dataset import Dataset
from workflows.adapt import Adaptation, adapt
from workflows.fe2 import as_data_driven
from workflows.scene import Scene, make_metric, with_tangents
from workflows.trial import PATIENT

__all__ = ["METHODS", "Method", "Solution", "adaptive"]


@dataclass(frozen=True)
class Solution:
    """A solved scene; ``note`` says how it went.

    ``material``: it has a material solution too, which a law has not. ``rves`` that the solve itself computed, and what
    they took of its time in s; None and 0 where it was given data.
    """

    operator: dd.StrainOperator
    result: dd.DataDrivenResult
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


def classical(scene: Scene, dataset: Dataset, *, metric: str) -> Solution:
    """Data are points.

    Raises:
        InputError: the data give no metric.
        ConvergenceError: the fixed point was not found.
    """
    operator, projection = _projection(scene, metric, dataset)
    result = dd.solve(projection, dd.MaterialSearch(dataset, projection.metric), options=PATIENT)
    return Solution(operator, result, f"{result.iterations} iterations")


def second_order(scene: Scene, dataset: Dataset) -> Solution:
    """Data are their tangent spaces.

    Raises:
        InputError: there are no tangents, and too few data for them to be estimated.
        ConvergenceError: the solve did not converge.
    """
    operator, projection = _projection(scene, "auto", dataset, order=2)
    result = dd.solve_second_order(projection, dd.TangentSearch(with_tangents(dataset), projection.metric))
    return Solution(operator, result, f"{result.iterations} iterations")


def estimated(scene: Scene, dataset: Dataset) -> Solution:
    """The same without the tangents of the data: they are estimated from neighbours, as those of measured data are."""
    return second_order(scene, dataclasses.replace(dataset, tangent=None))


def law(scene: Scene, dataset: Dataset, *, fit: Callable[[Dataset], dd.Law]) -> Solution:
    """A law fitted to the data, solved by Newton's method.

    Raises:
        InputError, ConvergenceError: the fit or the solve failed.
    """
    fitted, domain = fit(dataset), scene.build(MPI.COMM_SELF)
    operator = scene.operator(domain)
    result = dd.solve_law(operator, fitted, scene.conditions(domain))
    return Solution(operator, as_data_driven(result), f"{result.iterations} Newton iterations", material=False)


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


def _projection(
    scene: Scene, metric: str, dataset: Dataset, *, order: int = 1
) -> tuple[dd.StrainOperator, dd.Projection]:
    """The scene in this process, with the metric of this name from the data for solves of ``order``."""
    domain = scene.build(MPI.COMM_SELF)
    operator, conditions = scene.operator(domain), scene.conditions(domain)
    C = make_metric(metric, operator, dataset, conditions, order=order)
    return operator, dd.make_projection(operator, C, conditions)


METHODS = (
    *(Method(f"data-driven, metric {m}", partial(classical, metric=m)) for m in ("tangent", "visited", "secant")),
    Method("second-order data", second_order, ("small", "finite")),
    Method("second-order data, estimated tangents", estimated),
    Method("linear elastic law", partial(law, fit=dd.fit_linear)),
    Method("polynomial energy law", partial(law, fit=dd.fit_polynomial)),
)
"""All that solve a scene with given data."""
