"""Data of a tissue whose bar force varies from cell to cell: a datum is near in strain, stress and bar force.

The bar force is one more coordinate of a datum, gamma ln f_b, with gamma the root mean square of the strain in the
metric: a relative change of f_b counts as the same relative change of the strain. What is left of the difference the
datum's own rate d sigma / d f_b takes up, as its tangent does for the strain.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.metric import Metric
from dd_macro.material.search import MaterialSearch
from dd_macro.material.tangent_spaces import StrainSearch, TangentSearch, TangentSpaces
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["Coordinates", "GradedPoints", "GradedTangents"]

Array = NDArray[np.float64]


class Coordinates:
    """Where a strain and a bar force are, in the metric; ``gamma`` in sqrt(J/m^3) is the weight of ln f_b.

    Without a gamma there are no bar forces, and the strain is all there is.
    """

    def __init__(self, metric: Metric, gamma: float | None = None) -> None:
        self.metric, self.gamma = metric, gamma

    def of(self, strain: Array, bar_force: Array | None) -> Array:
        """Coordinates (n, 6) or (n, 7) of strains (n, 6) and bar forces (n,) in N."""
        x = strain @ self.metric.factor
        if self.gamma is None or bar_force is None:
            return np.asarray(x)
        return np.column_stack([x, self.gamma * np.log(bar_force)])

    def back(self, x: Array) -> tuple[Array, Array | None]:
        """Strains and bar forces at these coordinates."""
        strain = x[:, :6] @ np.linalg.inv(self.metric.factor)
        return strain, None if self.gamma is None else np.exp(x[:, 6] / self.gamma)


class _Graded(MaterialSearch):
    """The search for points with the bar forces ``at`` (n,) in N; ``gamma`` as in Coordinates.

    Raises:
        InputError: the data do not know their bar force.
    """

    def __init__(self, dataset: Dataset, metric: Metric, *, at: Array, gamma: float) -> None:
        if dataset.bar_force is None:
            raise InputError("data: expected their bar forces, in a tissue where it varies, got none")
        self._at, self._gamma = np.asarray(at, dtype=float), gamma / np.sqrt(2.0)
        super().__init__(dataset, metric)

    def _places(self) -> Array:
        assert self.dataset.bar_force is not None
        white = self.metric.whiten(self.dataset.strain, self.dataset.stress)
        return np.column_stack([super()._seen(white), self._gamma * np.log(self.dataset.bar_force)])

    def _seen(self, z: Array) -> Array:
        return np.column_stack([super()._seen(z), self._gamma * np.log(self._at)])

    def for_points(self, at: Array) -> Self:
        """The same search for points of other bar forces (n,)."""
        other = copy.copy(self)
        other._at = np.asarray(at, dtype=float)
        other.forget()
        return other


class GradedPoints(_Graded):
    """Data as points."""


class GradedTangents(_Graded, StrainSearch):
    """Data as tangent spaces, whose stress follows the bar force of the point."""

    def of(self, index: NDArray[np.int64]) -> TangentSpaces:
        """As :meth:`TangentSearch.of`, of all points in their order."""
        spaces = TangentSearch.of(self, index)
        data = self.dataset
        if data.bar_force_rate is None or data.bar_force is None:
            return spaces
        change = (self._at - data.bar_force[index])[:, None] * data.bar_force_rate[index]
        return replace(spaces, stress=spaces.stress + change)
