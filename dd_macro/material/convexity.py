"""Least squares for polynomial energies that are convex at the data and around them.

That the second derivative at a strain is at least mu in a direction v is a linear inequality for the coefficients. The
inequalities that matter are found by cutting planes: strains are drawn around the data, those where the fit is not
convex are added with their softest direction, and the fit is repeated. It is a least-distance problem (Lawson and
Hanson 1974, chapter 23), solved by non-negative least squares.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from dd_macro.material.laws import PolynomialEnergy, monomial_derivatives, monomials
from tsg_micro.data.errors import ConvergenceError

__all__ = ["MARGIN", "convexity_rows", "least_squares_above"]

Array = NDArray[np.float64]

MARGIN = 0.1
"""How far around the data the energy is convex, relative to the widest range of a strain component."""
_DRAWN = 2000  # strains in a round
_ADDED = 80  # inequalities in a round
_KEPT = 800  # inequalities at most, from round to round
_ROUNDS = 100
_WEIGHT = 1e-6  # of staying near the start in coefficients that the data do not determine


def convexity_rows(
    law: PolynomialEnergy, R: Array, strain: Array, *, least: float
) -> tuple[PolynomialEnergy, Array, str]:
    """The convex energy nearest to ``law``, the inequalities (r, m) that make it so, and a note.

    Args:
        law: the best fit.
        R: what makes distance: |R[:, :m] (c - c_law)|, c the m coefficients.
        strain: of the data (N, 6).
        least: smallest second derivative in Pa that is asked for.

    Raises:
        ConvergenceError: non-negative least squares failed.
    """
    start, scale = law.coefficients, law.scale
    second, H = monomial_derivatives(law.exponents, scale)[1]
    rows = np.zeros((0, len(start)))
    margin = MARGIN * np.ptp(strain, axis=0).max()
    random = np.random.default_rng(0)
    c, clean, most = start, 0, 0.0
    for _ in range(_ROUNDS):
        away = random.normal(size=(_DRAWN, 6))
        away *= margin * random.uniform(size=(_DRAWN, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
        drawn = strain[random.integers(len(strain), size=_DRAWN)] + away
        at = monomials(drawn / scale, second)
        value, vector = np.linalg.eigh((at @ (H @ c).reshape(len(second), 36)).reshape(-1, 6, 6))
        bad = np.flatnonzero(value[:, 0] < 0.1 * least)
        most = max(most, len(bad) / _DRAWN)
        clean = 0 if len(bad) else clean + 1
        if clean == 2:
            break
        if not len(bad):
            continue
        half = bad[np.argsort(value[bad, 0] / np.abs(value[bad, -1]))[: _ADDED // 2]]
        bad = np.union1d(half, random.choice(bad, size=min(len(bad), _ADDED // 2), replace=False))
        softest = vector[bad, :, 0]
        rows = np.concatenate([rows, np.einsum("nl,lijm,ni,nj->nm", at[bad], H, softest, softest, optimize=True)])
        c = least_squares_above(R[:, :-1], start, rows, least)
        rows = rows[np.argsort(rows @ c)[:_KEPT]]  # those that bind come first
    law = dataclasses.replace(law, coefficients=c)
    if clean < 2:
        return law, rows, f", convex but for {len(bad) / _DRAWN:.2%} of the strains looked at around the data"
    return law, rows, ", convex around the data" + (f" (made so at {most:.2%} of the strains)" if most else "")


def least_squares_above(A: Array, start: Array, rows: Array, least: float) -> Array:
    """c (m,) that minimises |A (c - start)| (and, where A is silent, |c - start|) subject to rows c >= least.

    Raises:
        ConvergenceError: non-negative least squares failed.
    """
    from scipy.optimize import nnls  # start-up need not wait for what fits alone need

    missing = least - rows @ start
    if not (missing > 0).any():
        return start
    size = np.linalg.norm(A, axis=0)
    seen = size > 1e-14 * size.max()
    size[~seen] = np.median(size[seen])
    A = A / size
    stay = _WEIGHT * np.linalg.norm(A, 2) * np.eye(len(start))
    R = np.linalg.qr(np.concatenate([A, stay]), mode="r")
    G = scipy.linalg.solve_triangular(R, (rows / size).T, trans="T")
    length = np.linalg.norm(G, axis=0)
    E = np.concatenate([G, missing[None]]) / length
    target = np.zeros(len(E))
    target[-1] = 1.0
    try:
        multipliers, _ = nnls(E, target, maxiter=30 * E.shape[1])
    except RuntimeError as error:
        raise ConvergenceError(f"convex fit: non-negative least squares stopped ({error})") from None
    r = E @ multipliers - target
    return start + scipy.linalg.solve_triangular(R, -r[:-1] / r[-1]) / size
