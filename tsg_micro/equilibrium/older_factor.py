"""Work that an older factor does for a tangent of now: Newton steps, and the inertia of one nearby.

In large structures a factorisation costs some twenty solves. Conjugate gradients with the present tangent,
preconditioned by an older one, find a Newton step in fewer. The preconditioner keeps linear constraints, so the
iteration stays among the motions that they allow; there the older tangent is positive definite, and the iteration ends
where the present one shows that it is not.

With K0 the older tangent and E = K0^-1 (K0 - K), K0 (1 - t E) is regular for all t from 0 to 1 where the spectral
radius of E is below 1: then no eigenvalue changes its sign on the way, and K has the inertia of K0.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from tsg_micro.equilibrium.linear_solvers import Factor
from tsg_micro.equilibrium.members import MemberState, MemberSystem
from tsg_micro.equilibrium.tangent import Border, Tangent

__all__ = ["conjugate_gradients", "corrected", "newton_step"]

Array = NDArray[np.float64]
_MOST = 25
"""Iterations, which cost more than a factorisation."""
_NEAR = 1e-2
"""Spectral radius of E, so far from 1 that an estimate in few rounds will do."""
_ROUNDS, _EXACT = 2, 1e-10


def newton_step(
    system: MemberSystem,
    border: Border,
    free: NDArray[np.int64],
    older: Tangent,
    state: MemberState,
    out_of_balance: tuple[Array, Array],
    *,
    within: float,
) -> tuple[Array, Array] | None:
    """Values of the unknowns that are ``free`` and of the border, multipliers 0, of the Newton step at ``state``.

    Its error is about ``within`` of it, in energy. None where conjugate gradients do not find it.
    """
    n, m, k = len(free), system.nodal_size, border.macro.shape[1]
    forces = np.concatenate(out_of_balance)
    step = np.zeros((system.size, 1))

    def precondition(residual: Array) -> Array:
        found = np.concatenate(older.solve(residual[:n], residual[n:]))
        found[n + k :] = 0.0  # multipliers: the next iteration finds its own
        return found

    def operator(x: Array) -> Array:
        step[free, 0], step[m:, 0] = x[:n], border.macro @ x[n : n + k]
        product = system.tangent_product(state, step)[:, 0]
        return np.concatenate([product[free], border.macro.T @ product[m:], np.zeros(len(x) - n - k)])

    first = np.zeros_like(forces)
    if len(border.constraint):  # what they lack is mended here
        first = precondition(forces)
        forces = forces - operator(first)
        forces[n + k :] = 0.0
    x = conjugate_gradients(operator, precondition, forces, within=within)
    return None if x is None else (first[:n] + x[:n], first[n:] + x[n:])


def conjugate_gradients(
    operator: Callable[[Array], Array], precondition: Callable[[Array], Array], residual: Array, *, within: float
) -> Array | None:
    """x (n,) with operator x = ``residual`` (n,), until an iteration adds less than ``within`` of x, in energy.

    None where a direction has no positive stiffness, or where many iterations would be needed.
    """
    x, p, size, energy = np.zeros_like(residual), np.zeros_like(residual), np.inf, 0.0
    for _ in range(_MOST):
        z = precondition(residual)
        before, size = size, float(residual @ z)
        p = z + size / before * p
        product = operator(p)
        stiffness = float(p @ product)
        if not (size > 0.0 and stiffness > 0.0):
            return None
        x, residual = x + size / stiffness * p, residual - size / stiffness * product
        energy += size**2 / stiffness
        if size**2 / stiffness <= within**2 * energy:
            return x
    return None


def corrected(factor: Factor, upper: sp.csr_array) -> Factor | None:
    """A factor of the matrix with this ``upper`` triangle (n, n) from that of one nearby; None where it is not near.

    The spectral radius of E is estimated by power iterations from a vector that no symmetry singles out.
    """
    diagonal, lower = upper.diagonal()[:, None], upper.T.tocsr()

    def product(x: Array) -> Array:
        return np.asarray(upper @ x + lower @ x - diagonal * x)

    v, radius = np.sin(1.0 + np.arange(len(diagonal)))[:, None], _EXACT
    for _ in range(_ROUNDS):
        v = v / np.linalg.norm(v)
        v = v - factor.solve(product(v))
        radius = max(radius, float(np.linalg.norm(v)))
        if not radius <= _NEAR:
            return None
        if not v.any():
            break
    corrections = math.ceil(math.log(_EXACT) / math.log(radius)) - 1

    def solve(b: Array) -> Array:
        columns = b.reshape(len(b), -1)
        x = factor.solve(columns)
        for _ in range(corrections):
            x = x + factor.solve(columns - product(x))
        return x.reshape(b.shape)

    return Factor(solve, factor.negative_pivots)
