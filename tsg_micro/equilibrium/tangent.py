"""The factorised tangent of the unknowns: nodal ones, and a small border of macroscopic ones and multipliers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from tsg_micro.data.errors import ConvergenceError
from tsg_micro.equilibrium.linear_solvers import Factor

__all__ = ["Border", "Tangent", "lowest_ritz", "lowest_stiffness"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Border:
    """Unknowns beside the nodal ones: which entries of H are free, and linear constraints A y = 0."""

    macro: Array
    """Directions (9, k) in which H is free."""
    constraint: Array
    """Rows (c, 3n + 9) of A, over displacements and H; A y = 0 is kept."""
    held: int | NDArray[np.int64] | None = None
    """Displacements that get a weak spring in the tangent alone, where without the constraints a motion is free."""

    @property
    def size(self) -> int:
        """Number of unknowns in the border."""
        return self.macro.shape[1] + len(self.constraint)


@dataclass(frozen=True)
class Tangent:
    """The factorised tangent at one point, border included."""

    factor: Factor
    coupling: Array
    """Border columns (nx, k)."""
    solved: Array
    """K^-1 times the coupling."""
    schur: Array
    negative_pivots: int
    """Negative eigenvalues of the energy's second derivative on the free unknowns."""

    def solve(self, x: Array, z: Array) -> tuple[Array, Array]:
        """Solution of the bordered system for right-hand sides (nx,) or (nx, k) and (border,) or (border, k).

        Raises:
            ConvergenceError: there is none.
        """
        x = self.factor.solve(x)
        if self.schur.size == 0:
            return x, z
        try:
            z = np.linalg.solve(self.schur, z - self.coupling.T @ x)
        except np.linalg.LinAlgError:
            raise ConvergenceError("equilibrium: the tangent of the border is singular") from None
        return x - self.solved @ z, z


def lowest_ritz(operator: Callable[[Array], Array], n: int, steps: int) -> tuple[Array, Array]:
    """Ritz values (k,), lowest first, and vectors (n, k) of a symmetric operator, fully reorthogonalised.

    SciPy's eigsh would do, but version 1.18 was seen to corrupt memory here where it did not converge.
    """
    basis = np.zeros((steps, n))
    diagonal, off = np.zeros(steps), np.zeros(steps)
    v = np.sin(1.0 + np.arange(n))  # no symmetry of a structure makes one of its modes orthogonal to it
    for k in range(steps):
        basis[k] = v / np.linalg.norm(v)
        v = operator(basis[k])
        diagonal[k] = basis[k] @ v
        for _ in range(2):
            v -= basis[: k + 1].T @ (basis[: k + 1] @ v)
        off[k] = np.linalg.norm(v)
        if off[k] <= 1e-12 * abs(diagonal[: k + 1]).max():
            break
    values, coefficients = scipy.linalg.eigh_tridiagonal(diagonal[: k + 1], off[:k])
    return values, basis[: k + 1].T @ coefficients


def lowest_stiffness(tangent: Tangent, steps: int = 40) -> float:
    """Smallest eigenvalue of the tangent, N/m: negative where it is unstable, near 0 at a limit of the load."""
    none = np.zeros(len(tangent.schur))
    size = len(tangent.coupling)
    values, _ = lowest_ritz(lambda x: tangent.solve(x, none)[0], size, min(size, steps))
    return float(1.0 / (values[0] if values[0] < 0.0 else values[-1]))
