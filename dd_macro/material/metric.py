"""The metric of phase space: a symmetric positive definite C that weighs strain against stress.

Local distance (paper, Section 4.1): |z_e|^2 = 1/2 epsilon : C : epsilon + 1/2 sigma : C^-1 : sigma.
With C = L L^T the whitened point (L^T epsilon, L^-1 sigma) / sqrt(2) in R^12 has that length as its Euclidean norm.

Components that the data declare silent, s, do not count: C = [[C_aa, 0], [0, c I]], c -> 0, with a the others. Then
    |z|^2 = 1/2 epsilon_a : C_aa : epsilon_a + 1/2 sigma_a : C_aa^-1 : sigma_a + c/2 |epsilon_s|^2 + 1/(2c) |sigma_s|^2
The first two weights stay inverse to each other, so it is the metric of the strains and stresses a. A strain epsilon_s
costs nothing, a stress sigma_s is kept at that of the data, zero, and both terms vanish like c: what C has in s does
not matter. c is 1e-3 of the mean eigenvalue of C_aa, so that there is a stiffness matrix, one for both projections.
Were sigma_s free of cost too, with material states that take it from the mechanical ones, shear through the thickness
would carry any sigma_zz, which free faces cannot, and the iteration would need hundreds of steps.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import COMPONENTS

__all__ = [
    "Metric",
    "isotropic",
    "least_squares_modulus",
    "mean_tangent",
    "metric_from_dataset",
    "secant_modulus",
]

Array = NDArray[np.float64]

_FLOOR = 1e-2  # smallest eigenvalue of a metric taken from data, relative to the largest
_CHUNK = 8192  # points that are worked on at once
_SILENT = 1e-3  # c, relative to the mean eigenvalue of C_aa


@dataclass(frozen=True)
class Metric:
    """C (6, 6) in Pa in Mandel components, and why it was chosen.

    Raises:
        InputError: on construction, where C is not 6 x 6, finite, symmetric and positive definite.
    """

    C: Array
    reason: str

    def __post_init__(self) -> None:
        C = np.array(self.C, dtype=float)
        if C.shape != (6, 6) or not np.isfinite(C).all():
            raise InputError(f"metric C: expected 6 x 6 finite numbers in Pa, got shape {C.shape} or NaN or infinity")
        if not np.allclose(C, C.T, rtol=0, atol=1e-9 * np.abs(C).max()):
            raise InputError(f"metric C: expected a symmetric matrix, got asymmetry {np.abs(C - C.T).max():.3g} Pa")
        C = 0.5 * (C + C.T)
        smallest, largest = np.linalg.eigvalsh(C)[[0, -1]]
        if smallest <= 1e-14 * abs(largest):
            raise InputError(f"metric C: expected a positive definite matrix, got the eigenvalue {smallest:.3g} Pa")
        C.setflags(write=False)
        object.__setattr__(self, "C", C)

    @cached_property
    def factor(self) -> Array:
        """Lower triangular L (6, 6) with C = L L^T."""
        return np.linalg.cholesky(self.C)

    def without(self, silent: Collection[str]) -> Metric:
        """The metric in which the components ``silent``, among xx .. xy, do not count.

        Raises:
            InputError: they are unknown, or all components.
        """
        if not silent:
            return self
        counted = np.array([name not in silent for name in COMPONENTS])
        if counted.sum() != len(COMPONENTS) - len(set(silent)) or not counted.any():
            raise InputError(f"silent: expected some of {', '.join(COMPONENTS)}, got {', '.join(silent)}")
        return _metric(self.C[np.ix_(counted, counted)], counted, self.reason)

    def whiten(self, strain: ArrayLike, stress: ArrayLike) -> Array:
        """Points (n, 12) whose Euclidean distances are the local distance, sqrt(J/m^3), of (n, 6) and (n, 6) in Pa."""
        sigma = np.asarray(stress, dtype=float)
        whitened = scipy.linalg.solve_triangular(self.factor, sigma.reshape(-1, 6).T, lower=True).T.reshape(sigma.shape)
        white = np.concatenate([np.asarray(strain) @ self.factor, whitened], axis=-1)
        white /= np.sqrt(2.0)
        return white

    def squares(self, strain: Array, stress: Array) -> Array:
        """Squares (n,) of the lengths of such points, J/m^3, some points at a time."""
        out = np.empty(len(strain))
        for begin in range(0, len(out), _CHUNK):
            some = slice(begin, begin + _CHUNK)
            out[some] = (self.whiten(strain[some], stress[some]) ** 2).sum(axis=1)
        return out


def isotropic(*, young: float, poisson: float) -> Metric:
    """Metric of the isotropic elastic solid with Young's modulus in Pa and Poisson's ratio.

    Raises:
        InputError: they give no positive definite C.

    Example:
        >>> dd.isotropic(young=1e3, poisson=0.25).C[0].round(1)
        array([1200.,  400.,  400.,    0.,    0.,    0.])
    """
    if not (np.isfinite(young) and young > 0 and -1 < poisson < 0.5):
        raise InputError(f"young, poisson: expected young > 0 and -1 < poisson < 0.5, got {young} and {poisson}")
    C = np.eye(6) * young / (1 + poisson)
    C[:3, :3] += young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    return Metric(C, f"isotropic, Young's modulus {young:.4g} Pa, Poisson's ratio {poisson:.3g}")


def mean_tangent(dataset: Dataset, weight: Array | None = None) -> Metric:
    """Metric from the mean of the data's tangents, its symmetric part with small eigenvalues raised.

    Components that are silent in the data do not count. ``weight`` (N,) of the data, not negative and not all zero;
    equal ones if None.

    Raises:
        InputError: the data have no tangents, or weights that are no weights.

    Example:
        >>> source = tsg.RVESource(tsg.RVESpec.of_kind("bulk", tsg.Tissue(bar_force=1e-8)))
        >>> dd.mean_tangent(source.states(np.zeros((1, 6)), np.zeros((1, 6)))).C.round()[0, :3]
        array([1646.,  859.,  859.])
    """
    if dataset.tangent is None:
        raise InputError("data set: expected tangents for this metric, got none")
    if weight is not None and not (np.shape(weight) == (len(dataset),) and np.min(weight) >= 0 and np.sum(weight) > 0):
        raise InputError(f"weight: expected {len(dataset)} numbers from 0 upwards, not all zero, got {weight}")
    mean = np.average(dataset.tangent, axis=0, weights=weight)[np.ix_(dataset.counted, dataset.counted)]
    C, raised = _positive(0.5 * (mean + mean.T))
    return _metric(C, dataset.counted, f"mean tangent of {len(dataset)} data" + _note(raised))


def secant_modulus(dataset: Dataset) -> Metric:
    """Metric from the symmetric C that fits sigma = C epsilon best (least squares) over the data.

    Strain directions that the data do not span get the mean modulus of those they span; silent ones do not count.

    Raises:
        InputError: all strains or all stresses are zero.

    Example:
        >>> strain = np.random.default_rng(0).uniform(-0.02, 0.02, (60, 6))
        >>> C = dd.isotropic(young=1e3, poisson=0.3).C
        >>> data = tsg.Dataset(strain, strain @ C, "first_piola", path=np.zeros(60, int), step=np.arange(60))
        >>> bool(np.allclose(dd.secant_modulus(data).C, C))
        True
    """
    E, S = dataset.strain[:, dataset.counted], dataset.stress[:, dataset.counted]
    if not E.any() or not S.any():
        raise InputError("data set: expected strains and stresses other than zero, to fit a secant modulus")
    C, note = least_squares_modulus(E.T @ E, E.T @ S)
    return _metric(C, dataset.counted, f"least-squares secant of {len(dataset)} data" + note)


def least_squares_modulus(gram: Array, moment: Array, *, floor: float = _FLOOR) -> tuple[Array, str]:
    """Symmetric positive definite C (k, k) in Pa that minimises |E C - S|, and a note on what the data did not give.

    Strain directions that E does not span get the mean modulus of those it spans.

    Args:
        gram: E^T E (k, k), of k components of strain E (N, k).
        moment: E^T S (k, k) in Pa, of stresses S (N, k).
        floor: eigenvalues smaller than this times the largest are raised to it.

    Raises:
        InputError: C has no positive eigenvalue.
    """
    variance, directions = np.linalg.eigh(gram)
    spanned = variance > 1e-10 * variance[-1]
    U = directions[:, spanned]
    A, B = U.T @ gram @ U, U.T @ moment @ U
    inner = scipy.linalg.solve_continuous_lyapunov(A, B + B.T)  # min |E C - S| over symmetric C
    inner, raised = _positive(0.5 * (inner + inner.T), floor)
    V = directions[:, ~spanned]
    C = U @ inner @ U.T + np.trace(inner) / len(inner) * (V @ V.T)
    unspanned = f", {V.shape[1]} strain directions not in the data filled with the mean" if V.size else ""
    return C, _note(raised, floor) + unspanned


def metric_from_dataset(dataset: Dataset) -> Metric:
    """The default metric, from the data alone: their mean tangent, or the secant modulus where there are no tangents.

    Raises:
        InputError: the data give no modulus (all zero).

    Example:
        >>> strain = np.random.default_rng(0).uniform(-0.02, 0.02, (60, 6))
        >>> C = dd.isotropic(young=1e3, poisson=0.3).C
        >>> data = tsg.Dataset(strain, strain @ C, "first_piola", path=np.zeros(60, int), step=np.arange(60))
        >>> dd.metric_from_dataset(data).C.round()[0, :3]
        array([1346.,  577.,  577.])
    """
    return secant_modulus(dataset) if dataset.tangent is None else mean_tangent(dataset)


def _metric(C: Array, counted: NDArray[np.bool_], reason: str) -> Metric:
    """The metric with C (k, k) in Pa for the components of the mask ``counted`` (6,), the others silent."""
    if counted.all():
        return Metric(C, reason)
    full = np.diag(np.where(counted, 0.0, _SILENT * np.trace(C) / len(C)))
    full[np.ix_(counted, counted)] = C
    silent = [name for name, counts in zip(COMPONENTS, counted, strict=True) if not counts]
    return Metric(full, f"{reason}, {' and '.join(silent)} silent")


def _positive(C: Array, floor: float = _FLOOR) -> tuple[Array, int]:
    """C with eigenvalues below the floor raised to it, and their number."""
    values, vectors = np.linalg.eigh(C)
    if values[-1] <= 0:
        raise InputError(
            "data set: expected a modulus with a positive eigenvalue, got none; are the signs of stress right?"
        )
    low = values < floor * values[-1]
    return (vectors * np.where(low, floor * values[-1], values)) @ vectors.T, int(low.sum())


def _note(raised: int, floor: float = _FLOOR) -> str:
    return f", {raised} eigenvalues raised to {floor:g} of the largest" if raised else ""
