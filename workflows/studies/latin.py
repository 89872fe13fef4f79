"""Random designs of studies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["latin_hypercube"]


def latin_hypercube(random: np.random.Generator, count: int, dimension: int) -> NDArray[np.float64]:
    """Points (count, dimension) in the unit cube: each of ``count`` equal slices of an axis has one of them."""
    rows = np.stack([random.permutation(count) for _ in range(dimension)], axis=1)
    return np.asarray((rows + random.random((count, dimension))) / count)
