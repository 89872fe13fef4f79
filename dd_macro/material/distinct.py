"""Which of many rows of numbers are different, and the axes in which they differ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["first_of_equal", "principal_axes"]

Array = NDArray[np.float64]
_AT_ONCE = 100_000
_NO_EXTENT = 1e-12
"""Of rows along an axis, relative to that along the longest."""


def first_of_equal(rows: Array) -> NDArray[np.int64]:
    """Numbers, upwards, of the rows (n, k) that are the first of their kind."""
    key = np.zeros(len(rows), dtype=np.uint64)
    for column in rows.T:
        key ^= (column + 0.0).view(np.uint64)  # -0 is 0
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):  # splitmix64
            key = (key ^ (key >> np.uint64(shift))) * np.uint64(factor)
    _, first, kind = np.unique(key, return_index=True, return_inverse=True)
    if len(first) < len(rows):
        again = np.ones(len(rows), dtype=bool)
        again[first] = False
        if (rows[again] != rows[first[kind[again]]]).any():  # two kinds with one key
            first = np.unique(rows, axis=0, return_index=True)[1]
    return np.sort(first)


def principal_axes(rows: Array) -> tuple[Array, Array]:
    """Mean (k,) of the rows (n, k), and orthonormal axes (k, m) of what they differ in, the longest first.

    Along the k - m others they are the same to round-off; there is one axis at least.
    """
    middle = rows.mean(axis=0)
    parts = [slice(begin, begin + _AT_ONCE) for begin in range(0, len(rows), _AT_ONCE)]
    moment = sum(((rows[part] - middle).T @ (rows[part] - middle) for part in parts), np.zeros((len(middle),) * 2))
    axes = np.linalg.eigh(moment)[1][:, ::-1]
    extent = np.max([np.abs((rows[part] - middle) @ axes).max(axis=0) for part in parts], axis=0)
    different = extent > _NO_EXTENT * extent.max()
    different[0] = True
    return middle, axes[:, different]
