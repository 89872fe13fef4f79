"""Second-order data: every datum stands for its tangent space, and several data for their weighted mean.

Around a datum (epsilon_i, sigma_i) with tangent D_i the data are (epsilon_i + d, sigma_i + D_i d). The state of that
space nearest to (epsilon, sigma) in the metric C has
    (C + D_i^T C^-1 D_i) d = C (epsilon - epsilon_i) + D_i^T C^-1 (sigma - sigma_i)
With n neighbours their tangent spaces are averaged with the weights (R^2 - r_i^2)^2, r_i the distances to the
neighbours and R that to the next datum. So the average is continuous where neighbours are exchanged, takes noise out of
the data, is exact for linear data, and an offset from all data, as strains have that were never sampled, cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.metric import Metric
from dd_macro.material.neighbourhood import Neighbourhood
from dd_macro.material.search import MaterialSearch
from dd_macro.products import times
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["SpaceProjection", "StrainSearch", "TangentSearch", "TangentSpaces"]

Array = NDArray[np.float64]
_CHUNK = 8192  # points that are worked on at once


@dataclass(frozen=True)
class TangentSpaces:
    """The tangent spaces at n quadrature points: strain (n, 6), stress (n, 6) and tangents (k, 6, 6), both in Pa.

    ``index`` (n,) is the nearest datum of each point, ``reach`` (n,) how far d may go, as a length in sqrt(J/m^3);
    ``own`` (n,) the number of its tangent: points with the same datum share one, averages are one for each point.
    """

    strain: Array
    stress: Array
    tangents: Array
    own: NDArray[np.int64]
    index: NDArray[np.int64]
    reach: Array

    @property
    def tangent(self) -> Array:
        """The tangent at every point (n, 6, 6) in Pa."""
        return self.tangents[self.own]

    def stress_at(self, strain: Array) -> Array:
        """Stress (n, 6) in Pa of the tangent spaces at the strain (n, 6)."""
        return self.stress + times(self.tangents, self.own, strain - self.strain)


class TangentSearch(MaterialSearch):
    """Search for the nearest data, and projection onto their tangent spaces.

    The datum is the nearest one, not the one whose tangent space is nearest: those of far data come near by chance, and
    a state on the tangent space of its datum has no distance to it, so it would never leave its first datum.

    A datum is trusted over the gap to its neighbours and some way beyond; where the state is further from its datum,
    the answer is an extrapolation (:meth:`trusted`). The gap alone is no measure: strain directions that were not
    sampled, which tangents cover too, stay as far from the data however many there are.

    Args:
        dataset: with tangents (see dd_macro.material.estimated_tangents.estimate_tangents for data without).
        metric: the metric of the distance.
        neighbours: data whose tangent spaces are averaged at each point; 1 takes that of the nearest datum.
        trust: how far a datum reaches beyond the gap to its neighbours, relative to the extent of the data's strain.
        workers: threads of one search; -1 takes all.

    Raises:
        InputError: the data have no tangents, or a number is out of range.
    """

    def __init__(
        self, dataset: Dataset, metric: Metric, *, neighbours: int = 1, trust: float = 0.3, workers: int = 1
    ) -> None:
        if dataset.tangent is None:
            raise InputError(
                "data set: expected tangents, got none; dd_macro.estimate_tangents makes them from neighbours"
            )
        if not trust > 0:
            raise InputError(f"trust: expected a positive number, got {trust}")
        super().__init__(dataset, metric, workers=workers)
        if not 1 <= neighbours <= len(self._data):
            raise InputError(
                f"neighbours: expected 1 to {len(self._data)}, the number of different data, got {neighbours}"
            )
        self.neighbours, self.trust = neighbours, trust
        self._reach = self._reaches()

    def spaces(self, strain: Array, stress: Array) -> TangentSpaces:
        """Tangent spaces of the data nearest to strain (n, 6), stress (n, 6) in Pa.

        Raises:
            InputError: they are not finite.
        """
        z = self.metric.whiten(strain, stress)
        if self.neighbours == 1:
            return self.of(self.nearest(z)[0])
        more = min(self.neighbours + 1, len(self._data))
        along, beside = self._along(z)
        distance, index = self._tree.query(along, k=more, workers=self.workers)
        distance = np.hypot(distance, beside[:, None])
        if more == self.neighbours:  # no next datum: it is as far away as the last, and half as much again
            outer, inside = 1.5 * distance[:, -1:], distance
        else:
            outer, inside = distance[:, -1:], distance[:, :-1]
        weight = (outer**2 - inside**2) ** 2
        weight[~weight.any(axis=1)] = 1.0  # all equally far
        weight /= weight.sum(axis=1, keepdims=True)
        place = self._first[index[:, : self.neighbours]]
        data = self.dataset
        assert data.tangent is not None
        at = np.einsum("nk,nki->ni", weight, data.strain[place])
        D = np.einsum("nk,nkij->nij", weight, data.tangent[place])
        tau = data.stress[place] + np.einsum("nkij,nkj->nki", data.tangent[place], at[:, None] - data.strain[place])
        tau, nearest = np.einsum("nk,nki->ni", weight, tau), place[:, 0]
        return TangentSpaces(at, tau, D, np.arange(len(at)), nearest, self._reach[nearest])

    def of(self, index: NDArray[np.int64]) -> TangentSpaces:
        """Tangent spaces of the data of these numbers (n,)."""
        data = self.dataset
        assert data.tangent is not None
        used = np.zeros(len(data), dtype=bool)
        used[index] = True
        own = (np.cumsum(used) - 1)[index]
        return TangentSpaces(data.strain[index], data.stress[index], data.tangent[used], own, index, self._reach[index])

    def trusted(self, spaces: TangentSpaces, strain: Array) -> Array:
        """Fraction (n,) of the way from the datum to ``strain`` (n, 6) that the data vouch for; 1 if all of it."""
        length = np.linalg.norm((strain - spaces.strain) @ self.metric.factor, axis=1) / np.sqrt(2.0)
        return np.minimum(1.0, spaces.reach / np.maximum(length, 1e-300))

    @property
    def _counted(self) -> NDArray[np.bool_]:
        """All components: tangents answer the silent ones too."""
        return np.ones(6, dtype=bool)

    def _reaches(self) -> Array:
        """Length (N,) in sqrt(J/m^3) that the strain may go from each datum; a single datum has no gap and no limit.

        The gap is that of dd_macro.material.neighbourhood, the extent of the data the root mean square of their strain.
        """
        reach = np.full(len(self.dataset), np.inf)
        near = Neighbourhood(self.dataset.strain[self._first], self.metric.factor)
        if len(near) > 1:
            extent = np.sqrt((near.at**2).sum(axis=1).mean())
            reach[self._first] = (near.gap(np.arange(len(near))) + self.trust * extent) / np.sqrt(2.0)
        return reach


class StrainSearch(TangentSearch):
    """As :class:`TangentSearch`, by the distance of the strain alone.

    For data that a source was asked for at strains of the solution. In strain and stress a datum that contradicts the
    tangent of its neighbour may be further from the state on that tangent than the neighbour is, however near its
    strain: where the tissue stiffens beyond what the metric expects, the state would never leave its first datum.
    """

    def _seen(self, z: Array) -> Array:
        """Their strain."""
        return np.concatenate([z[:, :6], np.zeros_like(z[:, 6:])], axis=1)


class SpaceProjection:
    """Closest points of n tangent spaces; what does not depend on the point is prepared once."""

    def __init__(self, spaces: TangentSpaces, metric: Metric) -> None:
        self.spaces = spaces
        L = metric.factor
        self._whiten, self._back = L, np.linalg.inv(L)
        self._tangent = self._back @ spaces.tangents @ self._back.T
        self._inverse = np.linalg.inv(np.eye(6) + self._tangent.swapaxes(1, 2) @ self._tangent)
        self._across = self._inverse @ self._tangent.swapaxes(1, 2)

    def closest(self, strain: Array, stress: Array) -> tuple[Array, Array]:
        """Strain (n, 6) and stress (n, 6) in Pa of the tangent spaces nearest to these."""
        d, s = self.along(strain - self.spaces.strain, stress - self.spaces.stress)
        d += self.spaces.strain
        s += self.spaces.stress
        return d, s

    def along(self, strain: Array, stress: Array) -> tuple[Array, Array]:
        """The part along the tangent spaces of a change of strain (n, 6) and stress (n, 6) in Pa."""
        part = np.empty_like(strain), np.empty_like(stress)
        for begin in range(0, len(strain), _CHUNK):
            some = slice(begin, begin + _CHUNK)
            own = self.spaces.own[some]
            d = times(self._inverse, own, strain[some] @ self._whiten)
            d += times(self._across, own, stress[some] @ self._back.T)
            part[0][some], part[1][some] = d @ self._back, times(self._tangent, own, d) @ self._whiten.T
        return part
