"""Nearest datum of every material point: a k-d tree over the whitened data, and queries that need no search.

The tree is over the principal axes of the data, those in which they differ: distances are the same, and its boxes lie
along the data, which mostly fill few of the twelve directions. The others are equally far from all data.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dd_macro.material.distinct import first_of_equal, principal_axes
from dd_macro.material.metric import Metric
from dd_macro.material.neighbourhood import Neighbourhood
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["MaterialSearch"]

Array = NDArray[np.float64]


class MaterialSearch:
    """Search tree over the data, in the whitened space of the metric.

    The last search of every point is kept: a point that has since moved by less than half the gap between its
    nearest and its second nearest datum still has the same nearest datum (triangle inequality), so it is not
    searched for. ``queries`` counts the points asked for, ``skips`` those that needed no search.

    Args:
        dataset: strain (N, 6) and stress (N, 6) in Pa; of equal data the first one stands for all.
        metric: the metric of the distance.
        workers: threads of one search; -1 takes all.

    Example:
        >>> strain = np.random.default_rng(0).uniform(-0.02, 0.02, (60, 6))
        >>> C = dd.isotropic(young=1e3, poisson=0.3).C
        >>> data = tsg.Dataset(strain, strain @ C, "first_piola", path=np.zeros(60, int), step=np.arange(60))
        >>> search = dd.MaterialSearch(data, dd.metric_from_dataset(data))
        >>> search.nearest(search.metric.whiten(data.strain[:3], data.stress[:3]))[0]
        array([0, 1, 2])
    """

    def __init__(self, dataset: Dataset, metric: Metric, *, workers: int = 1) -> None:
        self.dataset, self.metric, self.workers = dataset, metric, workers
        places = self._places()
        self._first = first_of_equal(places)
        if len(self._first) < len(places):
            places = places[self._first]
        self._middle, self._axes = principal_axes(places)
        self._data = (places - self._middle) @ self._axes
        self._tree = cKDTree(self._data)
        self.queries = self.skips = 0
        self.forget()

    def forget(self) -> None:
        """Drop what is remembered of earlier searches."""
        self._where = np.empty((0, 0))
        self._nearest = np.empty(0, dtype=np.int64)
        self._margin = np.empty(0)

    def _places(self) -> Array:
        """Where the data are, (N, 12) or more coordinates."""
        return self._seen(self.metric.whiten(self.dataset.strain, self.dataset.stress))

    def _seen(self, z: Array) -> Array:
        """What of whitened points (n, 12) the distance is of: all of it."""
        return z

    @property
    def _counted(self) -> NDArray[np.bool_]:
        """The strain components (6,) that the data answer: all but the silent ones."""
        return self.dataset.counted

    @cached_property
    def neighbourhood(self) -> Neighbourhood:
        """That of the strains of the data, in the components that they answer."""
        return Neighbourhood(
            self.dataset.strain[first_of_equal(self.dataset.strain)], self.metric.factor * self._counted[:, None]
        )

    def outside(self, strain: Array) -> NDArray[np.bool_]:
        """Whether the strains (n, 6) are outside the neighbourhood of the data (n,)."""
        return self.neighbourhood.outside(strain)

    def nearest(self, z: Array) -> tuple[NDArray[np.int64], Array]:
        """Index into the data set of the nearest datum, and the local distance to it, of whitened points z (n, 12).

        Raises:
            InputError: z is of another shape or not finite.
        """
        if z.ndim != 2 or z.shape[1] != 12 or not np.isfinite(z).all():
            raise InputError(f"points to search for: expected finite numbers (n, 12), got shape {z.shape} or NaN")
        z, beside = self._along(z)
        if z.shape != self._where.shape:
            self._where = np.full(z.shape, np.nan)
            self._nearest = np.zeros(len(z), dtype=np.int64)
            self._margin = np.zeros(len(z))
        moved = np.linalg.norm(z - self._where, axis=1)
        search = ~(moved < self._margin)  # true for the NaN of a point never searched
        self.queries += len(z)
        self.skips += int((~search).sum())
        if search.any():
            distance, index = self._tree.query(z[search], k=2, workers=self.workers)
            self._where[search] = z[search]
            self._nearest[search] = index[:, 0]
            # a hair less than half, so that round-off cannot turn a tie
            self._margin[search] = 0.5 * (1 - 1e-9) * (distance[:, 1] - distance[:, 0])
        return self._first[self._nearest], np.hypot(np.linalg.norm(z - self._data[self._nearest], axis=1), beside)

    def _along(self, z: Array) -> tuple[Array, Array]:
        """Whitened points z (n, 12) in the axes of the data, and how far they are from all data across them (n,)."""
        seen = self._seen(z) - self._middle
        along = seen @ self._axes
        seen -= along @ self._axes.T
        return along, np.sqrt(np.einsum("ni,ni->n", seen, seen))
