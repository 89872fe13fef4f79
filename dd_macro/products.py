"""Products of many small matrices, many of which are the same one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["times"]

Array = NDArray[np.float64]
_CHUNK = 2048  # vectors that are worked on at once: their matrices stay in the cache


def times(matrices: Array, own: NDArray[np.int64], vectors: Array) -> Array:
    """Products (n, i) of matrices (k, i, j) and vectors (n, j); ``own`` (n,) says which is whose."""
    if len(matrices) == 1:
        return np.asarray(vectors @ matrices[0].T)
    out = np.empty((len(vectors), matrices.shape[1]))
    for begin in range(0, len(vectors), _CHUNK):
        some = slice(begin, begin + _CHUNK)
        np.einsum("nij,nj->ni", matrices[own[some]], vectors[some], out=out[some])
    return out
