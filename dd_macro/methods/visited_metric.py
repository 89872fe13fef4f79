"""A metric for one scene: the tangent of the data in the range of strain that the scene visits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dd_macro.material.metric import Metric, mean_tangent, secant_modulus
from dd_macro.material.search import MaterialSearch
from dd_macro.methods.finite_projection import make_projection
from dd_macro.methods.points import SolverOptions, solve
from dd_macro.parallel import total
from dd_macro.scene.boundary import Displacement, Traction
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.dataset import Dataset

__all__ = ["visited_tangent"]


def visited_tangent(
    operator: StrainOperator,
    dataset: Dataset,
    conditions: Sequence[Displacement],
    tractions: Sequence[Traction] = (),
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
    if dataset.tangent is None:
        return secant_modulus(dataset)
    everywhere = mean_tangent(dataset)
    result = solve(
        make_projection(operator, everywhere, conditions, tractions),
        MaterialSearch(dataset, everywhere),
        options=options,
    )
    local = np.bincount(result.index, weights=operator.weights, minlength=len(dataset))
    volume = total(operator.comm, local)
    metric = mean_tangent(dataset, volume)
    used = f"the {np.count_nonzero(volume)} of {len(dataset)} data that a first solve uses"
    return replace(metric, reason=f"mean tangent of {used}{metric.reason.partition(' data')[2]}")
