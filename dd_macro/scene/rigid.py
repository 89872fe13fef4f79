"""Rigid motions that supports leave to a body, held in the mean: no node is, and loads in balance feel nothing of it.

    [K   R] [x]   [b]
    [R^T 0] [l] = [0]           R orthonormal, of the free rigid motions of the body at rest
K is singular at rest, so K + s 1 is factorised, with s small against the stiffness of any strain. With its inverse A
and Y = A R, x = A b - Y (R^T Y)^-1 R^T A b meets R^T x = 0, and a few corrections take s out. Where forces are in
balance l = 0. All nodes are shifted alike, none is pinned.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro.parallel import total
from tsg_micro.data.errors import ConvergenceError

__all__ = ["SHIFT", "HeldMean"]

Array = NDArray[np.float64]
Solve = Callable[[Array], Array]
SHIFT = 1e-8
"""s over the mean of K's diagonal."""
_CORRECTIONS, _SMALL, _FELT = 30, 1e-10, 1e-6


class HeldMean:
    """Solves with the matrix of a body whose free rigid ``motions`` (k, n), orthonormal over the ranks, are held.

    Args:
        comm: of the body.
        motions: this rank's part.
        solve: with K + s 1.
        product: with K + s 1.
        shift: s in N/m.
    """

    def __init__(self, comm: MPI.Comm, motions: Array, *, solve: Solve, product: Solve, shift: float) -> None:
        self._comm, self._R, self._solve, self._product, self._shift = comm, motions, solve, product, shift
        self._Y = np.array([self._lever(mode) for mode in motions])
        self._inverse = np.linalg.inv(total(comm, motions @ self._Y.T))

    def _lever(self, mode: Array) -> Array:
        """(K + s 1)^-1 of a motion: that over s at rest, where K does not feel it."""
        y = mode / self._shift
        left = mode - self._product(y)
        return y if self._norm(left) <= _FELT else y + self._solve(left)

    def solve(self, b: Array) -> Array:
        """x (n,) of the right side b (n,).

        Raises:
            ConvergenceError: the corrections do not take the shift out: K is singular otherwise too.
        """
        size = self._norm(b)
        x, left = np.zeros_like(b), b - self._R.T @ total(self._comm, self._R @ b)
        for _ in range(_CORRECTIONS):
            step = self._solve(left)
            x = x + step - self._Y.T @ (self._inverse @ total(self._comm, self._R @ step))
            x -= self._R.T @ total(self._comm, self._R @ x)
            out = b - self._product(x) + self._shift * x
            left = out - self._R.T @ total(self._comm, self._R @ out)
            if self._norm(left) <= _SMALL * size:
                return x
        raise ConvergenceError(
            f"free body: expected a residual of {_SMALL:.0e} within {_CORRECTIONS} corrections, got "
            f"{self._norm(left) / size:.1e}; more than its rigid motions may be without stiffness"
        )

    def _norm(self, x: Array) -> float:
        return float(np.sqrt(total(self._comm, x @ x)))
