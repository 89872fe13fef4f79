"""The neighbourhood of data: the strains that are no further from the nearest of them than its own neighbours are.

The gap of a datum is its distance to the sixth neighbour, so the neighbourhood is one ball around each datum. Data that
fill a set of strains leave no holes in it; strains beside that set, in a direction that was not sampled or in a corner
of its bounding box, are outside. A single datum has no neighbours: every other strain is outside.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = ["Neighbourhood"]

Array = NDArray[np.float64]
_NEIGHBOURS, _ROUND_OFF = 6, 1e-9


class Neighbourhood:
    """That of data at the strains (N, 6), whose distance is |(a - b) ``factor``|, factor (6, 6)."""

    def __init__(self, strain: Array, factor: Array) -> None:
        self._factor, self.at = factor, strain @ factor
        self._tree = cKDTree(self.at)

    def __len__(self) -> int:
        return len(self.at)

    def gap(self, index: NDArray[np.int64]) -> Array:
        """Distance (n,) of the data of these numbers to their sixth neighbours, or to the last there is."""
        if len(self.at) == 1:
            return np.zeros(len(index))
        return np.asarray(self._tree.query(self.at[index], k=[min(_NEIGHBOURS + 1, len(self.at))])[0][:, 0])

    def outside(self, strain: Array) -> NDArray[np.bool_]:
        """Whether the strains (n, 6) are outside (n,)."""
        distance, index = self._tree.query(strain @ self._factor)
        used, own = np.unique(index, return_inverse=True)
        return np.asarray(distance > self.gap(used)[own] + _ROUND_OFF * np.abs(self.at).max())
