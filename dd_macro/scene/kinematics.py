"""Kinematics at the quadrature points: from the gradient of the displacement to the strain of the material, and back.

A material is a map from a strain to its stress, both symmetric. In small strain they are those of the equations. In
finite strain they are the Biot strain U - I and the Biot stress T = sym(R^T P), with F = R U the polar decomposition
and P the first Piola stress: work conjugate, and what an RVE under a symmetric F gives (there R = I). So a material
does not see a rotation of the body, P(Q F) = Q P(F). With E = (U^2 - I) / 2 and the second Piola stress S,
    2 T = U S + S U = L_U S,   dE = L_U dU / 2,   so   dS/dE = 2 L_U^-1 (2 dT/dU - L_S) L_U^-1,   P = F S.
Gradients H = F - I and first Piola stresses are vectors of 9, row by row.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.mandel import BASIS, from_mandel, to_mandel

__all__ = ["FiniteStrain", "Kinematics", "SmallStrain", "second_piola"]

Array = NDArray[np.float64]
_HUGE = 1e50


class Kinematics(Protocol):
    """What the gradients of n points mean to their material."""

    @property
    def strain(self) -> Array:
        """Strain (n, 6) of the material, Mandel."""

    @property
    def inside_out(self) -> bool:
        """Whether det F is not positive, or no number, somewhere."""

    def nominal_stress(self, stress: Array) -> Array:
        """Stress of the equations, (n, 6) or (n, 9) in Pa, of the material's stress (n, 6)."""

    def nominal_tangent(self, stress: Array, tangent: Array) -> Array:
        """Derivative (n, 6, 6) or (n, 9, 9) in Pa of it, of the material's stress (n, 6) and tangent (n, 6, 6)."""


@dataclass(frozen=True)
class SmallStrain:
    """The strain (n, 6) and the stress of the equations are those of the material."""

    strain: Array
    inside_out: bool = False

    def nominal_stress(self, stress: Array) -> Array:
        """The same stress (n, 6) in Pa."""
        return stress

    def nominal_tangent(self, stress: Array, tangent: Array) -> Array:
        """The same tangent (n, 6, 6) in Pa."""
        return tangent


class FiniteStrain:
    """The polar decomposition F = R U (n, 3, 3) of displacement gradients (n, 9).

    ``inside_out``: det F is not positive somewhere; a gradient without bounds counts as F = 0.
    """

    def __init__(self, gradient: Array) -> None:
        F = np.eye(3) + gradient.reshape(-1, 3, 3)
        # of a diverging iteration, on some ranks maybe: the decomposition would raise there, and the others wait
        self.F = np.where(np.abs(F).max(axis=(1, 2), keepdims=True) < _HUGE, F, 0.0)
        self.inside_out = bool((np.linalg.det(self.F) <= 0).any())
        squares, directions = np.linalg.eigh(self.F.swapaxes(1, 2) @ self.F)
        stretch = np.sqrt(np.maximum(squares, np.finfo(float).tiny))[:, None, :]
        self.U = (directions * stretch) @ directions.swapaxes(1, 2)
        self.R = self.F @ ((directions / stretch) @ directions.swapaxes(1, 2))

    @property
    def strain(self) -> Array:
        """Biot strain U - I, Mandel (n, 6)."""
        return to_mandel(self.U - np.eye(3))

    def nominal_stress(self, stress: Array) -> Array:
        """First Piola stress (n, 9) in Pa of the Biot stress (n, 6)."""
        return (self.F @ from_mandel(self._second_piola(stress))).reshape(-1, 9)

    def nominal_tangent(self, stress: Array, tangent: Array) -> Array:
        """dP/dF (n, 9, 9) in Pa of the Biot stress (n, 6) and its derivative by U (n, 6, 6)."""
        S = from_mandel(self._second_piola(stress))
        inverse = self._inverse
        material = 2.0 * inverse @ (2.0 * tangent - _anticommutator(S)) @ inverse
        G = (self.F[:, None] @ BASIS).reshape(-1, 6, 9)  # dE = G dF
        A = G.swapaxes(1, 2) @ material @ G
        for i in range(3):
            A[:, 3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += S
        return A

    def material_stress(self, nominal: Array) -> Array:
        """Biot stress sym(R^T P), Mandel (n, 6), of the first Piola stress (n, 9), both in Pa."""
        return to_mandel(self.R.swapaxes(1, 2) @ nominal.reshape(-1, 3, 3))

    @property
    def stretch_derivative(self) -> Array:
        """dU/dF (n, 6, 9), U as a Mandel vector."""
        return np.asarray(2.0 * self._inverse @ (self.F[:, None] @ BASIS).reshape(-1, 6, 9))

    @property
    def deformation(self) -> Array:
        """The gradient (n, 3, 3) of the material, R times its stretch."""
        return self.F

    def first_piola(self, nominal: Array) -> Array:
        """First Piola stress (n, 3, 3) of the material, of the stress of the equations, both in Pa."""
        return nominal.reshape(-1, 3, 3)

    def turned(self, U: Array, stress: Array) -> Array:
        """Stress of the equations in Pa of data of stretch U (n, 3, 3) and Biot stress (n, 6), turned with R."""
        return np.asarray((self.R @ U @ second_piola(U, stress)).reshape(-1, 9))

    def _second_piola(self, stress: Array) -> Array:
        return 2.0 * np.einsum("nij,nj->ni", self._inverse, stress)

    @cached_property
    def _inverse(self) -> Array:
        return np.linalg.inv(_anticommutator(self.U))


def second_piola(U: Array, stress: Array) -> Array:
    """Second Piola stress (n, 3, 3) in Pa at the stretch U (n, 3, 3) of the Biot stress (n, 6) in Pa."""
    return from_mandel(2.0 * np.linalg.solve(_anticommutator(U), stress[..., None])[..., 0])


def _anticommutator(A: Array) -> Array:
    """L (n, 6, 6) with L x the Mandel vector of A X + X A, for symmetric A (n, 3, 3)."""
    return (to_mandel(A) @ _OF_BASIS).reshape(-1, 6, 6)


_OF_BASIS = np.einsum("iab,kac,jcb->kij", BASIS, BASIS, 2.0 * BASIS).reshape(6, 36)
