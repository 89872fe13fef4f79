"""Constitutive laws fitted to a data set: what data-driven computing is measured against.

A law is fitted by linear least squares to the stresses and, where the data have them, to the tangents. With rms the
root mean square over the data, the squares that are summed are
    |sigma - sigma_data|^2 / rms(sigma)^2  and  |T - T_data|^2 rms(epsilon)^2 / (6 rms(sigma)^2),
the second being the mean over all directions of the error of the stress that T gives for a strain of rms size.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.convexity import convexity_rows, least_squares_above
from dd_macro.material.laws import (
    Derivatives,
    FitReport,
    Law,
    LinearLaw,
    PolynomialEnergy,
    monomial_derivatives,
    monomials,
)
from dd_macro.material.metric import least_squares_modulus
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["fit_linear", "fit_polynomial", "mirrors_of"]

Array = NDArray[np.float64]

_FLIPPED = {"x": (4, 5), "y": (3, 5), "z": (3, 4)}  # strain components that change sign in the mirror normal to an axis
_FOLDS = 5
_RCOND = 1e-8  # singular values below this, relative to the largest, carry no information
_CHUNK = 400  # points in one block of rows


def fit_linear(dataset: Dataset) -> LinearLaw:
    """The linear elastic law with initial stress that fits the data best; C is symmetric and positive definite.

    Strain directions that neither strains nor tangents span get the mean modulus of those that are spanned.

    Raises:
        InputError: the strains or stresses are all the same and there are no tangents, or the fit has no positive
            modulus.

    Example:
        >>> strain = np.random.default_rng(0).uniform(-0.02, 0.02, (60, 6))
        >>> C = dd.isotropic(young=1e3, poisson=0.3).C
        >>> data = tsg.Dataset(strain, strain @ C, "first_piola", path=np.zeros(60, int), step=np.arange(60))
        >>> dd.fit_linear(data).C.round()[0, :3]
        array([1346.,  577.,  577.])
    """
    E, S, T = dataset.strain, dataset.stress, dataset.tangent
    if T is None and not (np.ptp(E, axis=0).any() and np.ptp(S, axis=0).any()):
        raise InputError("data set: expected strains and stresses that differ, to fit a law, got all the same")
    weight = _tangent_weight(dataset) ** 2

    def fit(keep: NDArray[np.bool_]) -> tuple[LinearLaw, Array, str]:
        e, s = E[keep].mean(axis=0), S[keep].mean(axis=0)
        gram = (E[keep] - e).T @ (E[keep] - e)  # of the data less their mean: the best sigma_0 is eliminated
        moment = (E[keep] - e).T @ (S[keep] - s)
        if T is not None:
            gram = gram + keep.sum() * weight * np.eye(6)
            moment = moment + weight * T[keep].sum(axis=0)
        C, note = least_squares_modulus(gram, moment, floor=1e-6)
        return LinearLaw(C, s - e @ C), gram, note

    law, gram, note = fit(np.ones(len(E), dtype=bool))
    folds = _folds(dataset)
    held_out = _held_out(dataset, folds, lambda fold: fit(folds != fold)[0])
    variance = np.linalg.eigvalsh(gram)
    variance = variance[variance > 1e-10 * variance[-1]]
    k = len(variance)
    solved = (27, 6 + k * (k + 1) // 2, float(np.sqrt(variance[-1] / variance[0])))
    reason = f"linear elastic fit of {_described(dataset)}{note}"
    return LinearLaw(law.C, law.initial_stress, _report(dataset, law, held_out, solved, reason))


def fit_polynomial(
    dataset: Dataset, *, degree: int = 4, mirrors: Collection[str] | None = None, convex: bool = True
) -> PolynomialEnergy:
    """The polynomial energy of degree 2 to 6 that fits the data best.

    A material that is its own image in the mirror normal to an axis has an energy that is even in the two shears that
    change sign there; the other monomials are left out. Coefficients that the data do not determine are the smallest
    possible, most often zero; but strain directions that neither strains nor tangents span get the mean modulus of
    the linear fit.

    Args:
        dataset: the data.
        degree: the highest of the monomials.
        mirrors: axes (of x, y, z) normal to the mirrors that the material is known to have; None: those that the data
            show (:func:`mirrors_of`).
        convex: ask for a convex energy at the data and around them, as stable materials have
            (dd_macro.material.convexity).

    Raises:
        InputError: bad arguments, or strains or stresses that are all zero.
        ConvergenceError: the search for a convex energy did not end.
    """
    if degree not in range(2, 7):
        raise InputError(f"degree: expected a whole number from 2 to 6, got {degree}")
    if mirrors is not None and not set(mirrors) <= set(_FLIPPED):
        raise InputError(f"mirrors: expected some of x, y, z, got {mirrors!r}")
    largest = np.abs(dataset.strain).max(axis=0)
    if not largest.any() or not dataset.stress.any():
        raise InputError("data set: expected strains and stresses other than zero, to fit a law")
    kept = mirrors_of(dataset) if mirrors is None else "".join(sorted(mirrors))
    exponents = _exponents(degree, kept)
    scale = np.where(largest > 1e-6 * largest.max(), largest, largest.max())
    linear = fit_linear(dataset)
    silent, filled = _silent(dataset, linear, exponents, scale)

    folds = _folds(dataset)
    derivatives = monomial_derivatives(exponents, scale)
    parts = [_triangle(dataset, np.flatnonzero(folds == k), derivatives, scale) for k in range(folds.max() + 1)]
    R = np.linalg.qr(np.concatenate(parts), mode="r")
    coefficients, rank, condition = _least_squares(R)
    law = PolynomialEnergy(exponents, coefficients + silent, scale)
    rows, note = np.zeros((0, len(exponents))), filled
    least = 0.1 * float(np.linalg.eigvalsh(linear.C)[0])
    if convex:
        law, rows, remark = convexity_rows(law, R, dataset.strain, least=least)
        note += remark

    def without(fold: int) -> Law:
        rest = np.concatenate([part for k, part in enumerate(parts) if k != fold])
        c = _least_squares(rest)[0] + silent
        return PolynomialEnergy(exponents, least_squares_above(rest[:, :-1], c, rows, least), scale)

    origin = "in the data" if mirrors is None else "given"
    reason = (
        f"polynomial energy of degree {degree}, {len(exponents)} coefficients, {rank} of them determined by "
        f"{_described(dataset)}; mirrors {origin}: {' '.join(kept) or 'none'}{note}"
    )
    report = _report(dataset, law, _held_out(dataset, folds, without), (len(exponents), rank, condition), reason)
    return PolynomialEnergy(exponents, law.coefficients, scale, report)


def mirrors_of(dataset: Dataset) -> str:
    """Axes normal to the mirrors that the data show: those data whose strain a mirror leaves as it is tell.

    There must be at least one such datum, and to round-off its stress and tangent must not change either.
    """
    E, S, T = dataset.strain, dataset.stress, dataset.tangent
    found = ""
    for axis, flipped in _FLIPPED.items():
        odd = list(flipped)
        even = [i for i in range(6) if i not in flipped]
        same = (np.abs(E[:, odd]) <= 1e-12 * np.abs(E).max()).all(axis=1)
        holds = bool(same.any()) and np.abs(S[same][:, odd]).max() <= 1e-9 * np.abs(S).max()
        if T is not None and holds:
            holds = np.abs(T[same][:, even][:, :, odd]).max() <= 1e-9 * np.abs(T).max()
        found += axis if holds else ""
    return found


def _exponents(degree: int, mirrors: str) -> NDArray[np.int64]:
    """Exponents (m, 6) of the monomials of degree 1 to ``degree`` that are even in every mirror."""
    chosen = [c for d in range(1, degree + 1) for c in combinations_with_replacement(range(6), d)]
    a = np.array([np.bincount(c, minlength=6) for c in chosen], dtype=np.int64)
    for axis in mirrors:
        a = a[a[:, _FLIPPED[axis]].sum(axis=1) % 2 == 0]
    return a


def _silent(dataset: Dataset, linear: LinearLaw, exponents: NDArray[np.int64], scale: Array) -> tuple[Array, str]:
    """Coefficients (m,) of the energy of strains in directions that the data do not span, and a note."""
    coefficients = np.zeros(len(exponents))
    variance, directions = np.linalg.eigh(dataset.strain.T @ dataset.strain)
    V = directions[:, variance <= 1e-10 * variance[-1]]
    if dataset.tangent is not None or V.shape[1] == 0:
        return coefficients, ""
    modulus = V @ (V.T @ linear.C @ V) @ V.T * np.outer(scale, scale)
    for m, a in enumerate(exponents):
        if a.sum() == 2:
            i, j = np.repeat(np.arange(6), a)
            coefficients[m] = modulus[i, j] * (0.5 if i == j else 1.0)
    return coefficients, f", {V.shape[1]} strain directions not in the data filled with the mean modulus"


def _triangle(dataset: Dataset, index: NDArray[np.int64], derivatives: Derivatives, scale: Array) -> Array:
    """R (k, m + 1) of the QR factorisation of the weighted equations of the points ``index``, right side last."""
    (first, G), (second, H) = derivatives
    m, size = G.shape[-1], _rms(dataset.stress)
    i, j = np.triu_indices(6)
    twice = _tangent_weight(dataset) / size * np.where(i == j, 1.0, np.sqrt(2.0))  # an entry beside the diagonal is two
    H = H[:, i, j] * twice[:, None]
    R = np.zeros((0, m + 1))
    for start in range(0, len(index), _CHUNK):
        points = index[start : start + _CHUNK]
        x = dataset.strain[points] / scale
        rows = (monomials(x, first) @ G.reshape(len(first), -1)).reshape(-1, m) / size
        blocks = [R, np.column_stack([rows, dataset.stress[points].reshape(-1) / size])]
        if dataset.tangent is not None:
            T = dataset.tangent[points]
            given = 0.5 * (T + np.swapaxes(T, 1, 2))[:, i, j] * twice
            rows = (monomials(x, second) @ H.reshape(len(second), -1)).reshape(-1, m)
            blocks.append(np.column_stack([rows, given.reshape(-1)]))
        R = np.linalg.qr(np.concatenate(blocks), mode="r")
    return R


def _least_squares(R: Array) -> tuple[Array, int, float]:
    """Smallest solution (m,) of R[:, :-1] c = R[:, -1] with scaled columns, its rank, and the condition number."""
    A, b = R[:, :-1], R[:, -1]
    size = np.linalg.norm(A, axis=0)
    size[size <= 1e-14 * size.max()] = np.inf  # a monomial that the data never see
    c, _, rank, singular = np.linalg.lstsq(A / size, b, rcond=_RCOND)
    return c / size, int(rank), float(singular[0] / singular[rank - 1])


def _rms(values: Array) -> float:
    return float(np.sqrt((values.reshape(len(values), -1) ** 2).sum(axis=1).mean()))


def _tangent_weight(dataset: Dataset) -> float:
    return _rms(dataset.strain) / np.sqrt(6.0)


def _folds(dataset: Dataset) -> NDArray[np.int64]:
    """The fold of every point, from 0."""
    paths, number = np.unique(dataset.path, return_inverse=True)
    return (number if len(paths) >= _FOLDS else np.arange(len(dataset))) % _FOLDS


def _held_out(dataset: Dataset, folds: NDArray[np.int64], fit_without: Callable[[int], Law]) -> float | None:
    if folds.max() == 0:
        return None
    squares = 0.0
    for fold in range(folds.max() + 1):
        out = folds == fold
        stress, _ = fit_without(fold).stress_and_tangent(dataset.strain[out])
        squares += float(((stress - dataset.stress[out]) ** 2).sum())
    return float(np.sqrt(squares / (dataset.stress**2).sum()))


def _report(
    dataset: Dataset, law: Law, held_out: float | None, solved: tuple[int, int, float], reason: str
) -> FitReport:
    stress, tangent = law.stress_and_tangent(dataset.strain)
    T = dataset.tangent
    return FitReport(
        stress_error=_rms(stress - dataset.stress) / _rms(dataset.stress),
        held_out_error=held_out,
        tangent_error=None if T is None else _rms(tangent - T) / _rms(T),
        coefficients=solved[0],
        rank=solved[1],
        condition=solved[2],
        stress_measure=dataset.stress_measure,
        reason=reason,
    )


def _described(dataset: Dataset) -> str:
    return f"{len(dataset)} stresses" + (" and tangents" if dataset.tangent is not None else "")
