"""The one definition of the Mandel vector, and the invariants p and q that are read off it.

Order: xx, yy, zz, yz, xz, xy; the three shears carry sqrt(2), so that the dot product of two vectors is
the double contraction of the two tensors, for strain and for stress alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["BASIS", "COMPONENTS", "from_mandel", "pressure", "to_mandel", "von_mises"]

Array = NDArray[np.float64]

COMPONENTS = ("xx", "yy", "zz", "yz", "xz", "xy")
_ROW = np.array([0, 1, 2, 1, 0, 0])
_COLUMN = np.array([0, 1, 2, 2, 2, 1])
_SCALE = np.array([1.0, 1.0, 1.0, np.sqrt(2.0), np.sqrt(2.0), np.sqrt(2.0)])


def to_mandel(tensor: ArrayLike) -> Array:
    """Mandel vectors (..., 6) of the symmetric part of tensors (..., 3, 3); the unit stays.

    Example:
        >>> tsg.to_mandel([[1.0, 0.5, 0.0], [0.5, 2.0, 0.0], [0.0, 0.0, 3.0]]).round(3)
        array([1.   , 2.   , 3.   , 0.   , 0.   , 0.707])
    """
    t = np.asarray(tensor, dtype=float)
    symmetric = 0.5 * (t + np.swapaxes(t, -1, -2))
    return symmetric[..., _ROW, _COLUMN] * _SCALE


def from_mandel(vector: ArrayLike) -> Array:
    """Symmetric tensors (..., 3, 3) of Mandel vectors (..., 6); the unit stays.

    Example:
        >>> tsg.from_mandel([1.0, 2.0, 3.0, 0.0, 0.0, 2**0.5])[0].round(3)
        array([1., 1., 0.])
    """
    v = np.asarray(vector, dtype=float) / _SCALE
    tensor = np.empty((*v.shape[:-1], 3, 3))
    tensor[..., _ROW, _COLUMN] = v
    tensor[..., _COLUMN, _ROW] = v
    return tensor


BASIS = from_mandel(np.eye(6))
"""The six orthonormal symmetric tensors (6, 3, 3) whose coefficients a Mandel vector holds."""
BASIS.setflags(write=False)


def pressure(stress: ArrayLike) -> Array:
    """Hydrostatic pressure p = -tr(sigma)/3 of Mandel stresses (..., 6); paper, Section 4.2.

    Example:
        >>> tsg.pressure([[-3.0, -3.0, -3.0, 0.0, 0.0, 0.0]])
        array([3.])
    """
    return -np.asarray(stress, dtype=float)[..., :3].sum(axis=-1) / 3.0


def von_mises(stress: ArrayLike) -> Array:
    """Effective stress q = sqrt(3/2 s:s), s the deviator, of Mandel stresses (..., 6); paper, Section 4.2.

    Example:
        >>> tsg.von_mises([[5.0, 0, 0, 0, 0, 0], [-3.0, -3.0, -3.0, 0.0, 0.0, 0.0]])
        array([5., 0.])
    """
    s = np.array(stress, dtype=float)
    s[..., :3] += pressure(s)[..., None]
    return np.sqrt(1.5 * np.einsum("...i,...i->...", s, s))
