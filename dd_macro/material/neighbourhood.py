"""The neighbourhood of data: the strains that are no further from the nearest of them than its own neighbours are.

The gap of a datum is its distance to the sixth neighbour, so the neighbourhood is one ball around each datum. Data that
fill a set of strains leave no holes in it; strains beside that set, in a direction that was not sampled or in a corner
of its bounding box, are outside. So that more data never put a strain out, a datum within a tenth of the strain itself
is always near enough. A single datum has no neighbours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = ["Neighbourhood"]

Array = NDArray[np.float64]
_NEIGHBOURS, _OF_STRAIN, _ROUND_OFF = 6, 0.1, 1e-9


class Neighbourhood:
    """That of data at the strains (N, 6), whose distance is |(a - b) ``factor``|, factor (6, 6)."""

    def __init__(self, strain: Array, factor: Array) -> None:
        self._factor, self.at = factor, strain @ factor
        self._tree = cKDTree(self.at, balanced_tree=False)  # built in half the time, and asked little

    def __len__(self) -> int:
        return len(self.at)

    def gap(self, index: NDArray[np.int64]) -> Array:
        """Distance (n,) of the data of these numbers to their sixth neighbours, or to the last there is."""
        if len(self.at) == 1:
            return np.zeros(len(index))
        return np.asarray(self._tree.query(self.at[index], k=[min(_NEIGHBOURS + 1, len(self.at))])[0][:, 0])

    def outside(self, strain: Array) -> NDArray[np.bool_]:
        """Whether the strains (n, 6) are outside (n,)."""
        at = strain @ self._factor
        distance, index = self._tree.query(at)
        used, own = np.unique(index, return_inverse=True)
        near = np.maximum(self.gap(used)[own], _OF_STRAIN * np.linalg.norm(at, axis=1))
        return np.asarray(distance > near + _ROUND_OFF * np.abs(self.at).max())
