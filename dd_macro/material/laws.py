"""Constitutive laws: stress and tangent of any number of points at once; dd_macro.material.fitting finds them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Derivatives", "FitReport", "Law", "LinearLaw", "PolynomialEnergy", "monomial_derivatives", "monomials"]

Array = NDArray[np.float64]
Exponents = NDArray[np.int64]
Derivatives = tuple[tuple[Exponents, Array], tuple[Exponents, Array]]


class Law(Protocol):
    """Stress and its symmetric derivative, of any number of points at once."""

    def stress_and_tangent(self, strain: Array) -> tuple[Array, Array]:
        """Mandel stress (n, 6) and tangent (n, 6, 6), both in Pa, of the Mandel strain (n, 6)."""


@dataclass(frozen=True)
class FitReport:
    """How well a law fits its data.

    ``stress_error`` and ``tangent_error`` are relative rms errors on the data; ``held_out_error`` is that of the stress
    at data that were left out of the fit, a fifth of the paths at a time (of the points, if there are fewer paths).
    ``condition`` is that of the least-squares problem with its columns scaled, ``rank`` of ``coefficients`` the number
    that the data determine. None: not there without tangents, or with a single datum.
    """

    stress_error: float
    held_out_error: float | None
    tangent_error: float | None
    coefficients: int
    rank: int
    condition: float
    stress_measure: str
    reason: str


@dataclass(frozen=True)
class LinearLaw:
    """sigma = sigma_0 + C epsilon; C (6, 6) and the initial stress sigma_0 (6,) in Pa.

    Example:
        >>> law = dd.LinearLaw(dd.isotropic(young=1e3, poisson=0.3).C)
        >>> stress, tangent = law.stress_and_tangent(0.01 * np.eye(6)[:1])
        >>> stress.round(2)[0, :3]
        array([13.46,  5.77,  5.77])
    """

    C: Array
    initial_stress: Array = field(default_factory=lambda: np.zeros(6))
    report: FitReport | None = None

    def stress_and_tangent(self, strain: Array) -> tuple[Array, Array]:
        """Stress (n, 6) and tangent (n, 6, 6) in Pa of the strain (n, 6)."""
        return self.initial_stress + strain @ self.C, np.broadcast_to(self.C, (len(strain), 6, 6))


@dataclass(frozen=True)
class PolynomialEnergy:
    """W = sum_m c_m prod_i (epsilon_i / s_i)^a_mi in J/m^3, sigma = dW/d epsilon, tangent d^2 W/d epsilon^2.

    ``exponents`` a (m, 6), ``coefficients`` c (m,) in J/m^3, ``scale`` s (6,) of the Mandel strain.
    """

    exponents: Exponents
    coefficients: Array
    scale: Array
    report: FitReport | None = None

    def energy(self, strain: Array) -> Array:
        """W (n,) in J/m^3 of the strain (n, 6)."""
        return monomials(strain / self.scale, self.exponents) @ self.coefficients

    def stress_and_tangent(self, strain: Array) -> tuple[Array, Array]:
        """Stress (n, 6) and tangent (n, 6, 6) in Pa of the strain (n, 6)."""
        x = np.asarray(strain) / self.scale
        (first, stress), (second, tangent) = self._prepared
        return monomials(x, first) @ stress, (monomials(x, second) @ tangent).reshape(-1, 6, 6)

    @cached_property
    def _prepared(self) -> Derivatives:
        (first, G), (second, H) = monomial_derivatives(self.exponents, self.scale)
        return (first, G @ self.coefficients), (second, (H @ self.coefficients).reshape(-1, 36))


def monomials(x: Array, exponents: Exponents) -> Array:
    """Values (n, m) of the monomials at the scaled strains x (n, 6)."""
    values = np.ones((len(x), len(exponents)))
    for i in range(6):
        powers = x[:, i, None] ** np.arange(exponents[:, i].max(initial=0) + 1)
        values *= powers[:, exponents[:, i]]
    return values


def monomial_derivatives(exponents: Exponents, scale: Array) -> Derivatives:
    """First and second derivatives as combinations of lower monomials: their exponents (l, 6), and (l, 6[, 6], m)."""

    def lowered(order: int) -> tuple[Exponents, Array]:
        place: dict[tuple[int, ...], int] = {}
        entries = []
        for m, a in enumerate(exponents):
            for axes in np.ndindex(*(6,) * order):
                b, factor = a.copy(), 1.0
                for i in axes:
                    factor *= b[i] / scale[i]
                    b[i] -= 1
                if factor:
                    entries.append((place.setdefault(tuple(b), len(place)), *axes, m, factor))
        matrix = np.zeros((len(place), *(6,) * order, len(exponents)))
        for *index, factor in entries:
            matrix[tuple(index)] = factor
        return np.array(list(place), dtype=np.int64).reshape(-1, 6), matrix

    return lowered(1), lowered(2)
