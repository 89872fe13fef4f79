"""A material that differs from region to region: its points are asked each in the part that they are of.

The data of all parts are one data set, in the order of the parts, so that the number of a datum says its part too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.laws import Law
from dd_macro.material.search import MaterialSearch
from dd_macro.material.tangent_spaces import TangentSearch, TangentSpaces
from tsg_micro.data.dataset import Dataset, join_datasets

__all__ = ["RegionalLaw", "RegionalSearch", "RegionalTangentSearch", "join_parts", "search_in_regions"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def join_parts(datasets: Sequence[Dataset]) -> Dataset:
    """The data sets as one, in their order."""
    joined = datasets[0]
    for dataset in datasets[1:]:
        joined = join_datasets(joined, dataset)
    return joined


@overload
def search_in_regions(searches: Sequence[TangentSearch], region: Index) -> TangentSearch: ...
@overload
def search_in_regions(searches: Sequence[MaterialSearch], region: Index) -> MaterialSearch: ...
def search_in_regions(searches: Sequence[MaterialSearch], region: Index) -> MaterialSearch:
    """One search for all points, whose ``region`` (n,) says which of ``searches`` is theirs."""
    if len(searches) == 1:
        return searches[0]
    dataset = join_parts([search.dataset for search in searches])
    if all(isinstance(search, TangentSearch) for search in searches):
        return RegionalTangentSearch(searches, region, dataset)  # type: ignore[arg-type]
    return RegionalSearch(searches, region, dataset)


class RegionalSearch(MaterialSearch):
    """The nearest datum of every point among the data of its own part.

    Args:
        parts: a search for each region.
        region: of the points (n,), from 0.
        dataset: of all parts, joined.
    """

    def __init__(self, parts: Sequence[MaterialSearch], region: Index, dataset: Dataset) -> None:
        self.parts, self.dataset, self.metric = tuple(parts), dataset, parts[0].metric
        self._points = [np.flatnonzero(region == k) for k in range(len(parts))]
        self._begin = np.cumsum([0, *(len(part.dataset) for part in parts)])

    @property
    def queries(self) -> int:  # type: ignore[override]
        """Points asked for so far."""
        return sum(part.queries for part in self.parts)

    @property
    def skips(self) -> int:  # type: ignore[override]
        """Those that needed no search."""
        return sum(part.skips for part in self.parts)

    def forget(self) -> None:
        """Drop what is remembered of earlier searches."""
        for part in self.parts:
            part.forget()

    def outside(self, strain: Array) -> NDArray[np.bool_]:
        """As :meth:`MaterialSearch.outside`, of the points in their order."""
        found = np.zeros(len(strain), dtype=bool)
        for part, points in zip(self.parts, self._points, strict=True):
            found[points] = part.outside(strain[points])
        return found

    def nearest(self, z: Array) -> tuple[Index, Array]:
        """As :meth:`MaterialSearch.nearest`, of the points in their order."""
        index, distance = np.zeros(len(z), dtype=np.int64), np.zeros(len(z))
        for part, points, begin in zip(self.parts, self._points, self._begin, strict=False):
            found, distance[points] = part.nearest(z[points])
            index[points] = begin + found
        return index, distance


class RegionalTangentSearch(RegionalSearch, TangentSearch):
    """The tangent spaces of the data of every point's own part."""

    parts: tuple[TangentSearch, ...]  # type: ignore[assignment]

    def __init__(self, parts: Sequence[TangentSearch], region: Index, dataset: Dataset) -> None:
        RegionalSearch.__init__(self, parts, region, dataset)
        self.neighbours, self.trust = max(part.neighbours for part in parts), parts[0].trust

    def spaces(self, strain: Array, stress: Array) -> TangentSpaces:
        """As :meth:`TangentSearch.spaces`."""
        pieces = [part.spaces(strain[at], stress[at]) for part, at in zip(self.parts, self._points, strict=True)]
        return self._together(pieces, len(strain))

    def of(self, index: Index) -> TangentSpaces:
        """As :meth:`TangentSearch.of`."""
        ends = zip(self.parts, self._points, self._begin, strict=False)
        return self._together([part.of(index[at] - begin) for part, at, begin in ends], len(index))

    def _together(self, pieces: Sequence[TangentSpaces], n: int) -> TangentSpaces:
        """The tangent spaces of all points, of those of the parts."""
        found = {}
        first = np.cumsum([0, *(len(piece.tangents) for piece in pieces)])
        for name, more in (("strain", 0), ("stress", 0), ("own", first), ("index", self._begin), ("reach", 0)):
            values = getattr(pieces[0], name)
            whole = np.zeros((n, *values.shape[1:]), dtype=values.dtype)
            for k, (piece, points) in enumerate(zip(pieces, self._points, strict=True)):
                whole[points] = getattr(piece, name) + (more if isinstance(more, int) else more[k])
            found[name] = whole
        return TangentSpaces(tangents=np.concatenate([piece.tangents for piece in pieces]), **found)


class RegionalLaw:
    """A law for every region; ``region`` (n,) of the points, from 0."""

    def __init__(self, laws: Sequence[Law], region: Index) -> None:
        self.laws = tuple(laws)
        self._points = [np.flatnonzero(region == k) for k in range(len(laws))]

    def stress_and_tangent(self, strain: Array) -> tuple[Array, Array]:
        """Stress (n, 6) and tangent (n, 6, 6) in Pa of the strain (n, 6)."""
        stress, tangent = np.zeros((len(strain), 6)), np.zeros((len(strain), 6, 6))
        for law, points in zip(self.laws, self._points, strict=True):
            stress[points], tangent[points] = law.stress_and_tangent(strain[points])
        return stress, tangent

    def support(self, strain: Array) -> Array:
        """What clamps carry beside the stress (n, 6), Pa, at the strain of the last call."""
        found = np.zeros((len(strain), 6))
        for law, points in zip(self.laws, self._points, strict=True):
            if hasattr(law, "support"):
                found[points] = law.support(strain[points])
        return found
