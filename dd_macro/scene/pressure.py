"""Pressure on a side: dead in small strain; in finite strain it follows the body, with its tangent.

With x(s, t) of the deformed facet the force of a pressure p from outside is f_k = -p int N_k x_s x x_t ds dt, and
    d f_k / d u_l = p int N_k ([x_t] N_l,s - [x_s] N_l,t) ds dt,    [a] b = a x b.
On a closed surface, or one whose rim is held, p times the enclosed volume is its potential and the tangent symmetric;
elsewhere the symmetric part is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dd_macro.scene.facets import SideFacets
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.errors import InputError

__all__ = ["Following", "Pressure"]

Array = NDArray[np.float64]
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
"""[e_a] for each axis a: [e_a] b = e_a x b."""


@runtime_checkable
class Following(Protocol):
    """A load whose forces go with the displacement where strain is finite."""

    def forces_at(self, operator: StrainOperator, u: Array) -> Array:
        """Nodal forces (3 * nodes,) in N where the nodes are displaced by u (3 * nodes,) in m; collective."""

    def add_stiffness(self, operator: StrainOperator, u: Array, matrix: PETSc.Mat, factor: float) -> None:
        """Add minus ``factor`` times the derivative of the forces by u, its symmetric part, to the nodal ``matrix``.

        The matrix is assembled afterwards by whoever calls; collective.
        """


@dataclass(frozen=True)
class Pressure:
    """Pressure in Pa on a side, positive from outside.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> squeeze = dd.Pressure("right", 20.0)
        >>> f"{squeeze.nodal_forces(operator).reshape(-1, 3).sum(axis=0)[0]:.3g}"
        '-1.6e-08'
    """

    side: str
    value: float

    def __post_init__(self) -> None:
        if isinstance(self.value, bool) or not isinstance(self.value, int | float) or not math.isfinite(self.value):
            raise InputError(f"pressure on {self.side!r}: expected a finite number in Pa, got {self.value!r}")

    def nodal_forces(self, operator: StrainOperator) -> Array:
        """Nodal forces (3 * nodes,) in N on the body at rest.

        Raises:
            InputError: an unknown side, or one without outer facets.
        """
        facets = _facets(operator, self.side)
        return facets.nodal(-self.value * facets.areas)

    def forces_at(self, operator: StrainOperator, u: Array) -> Array:
        """See :class:`Following`."""
        facets = _facets(operator, self.side)
        s, t = np.moveaxis(facets.deformed(u), 1, 0)
        return facets.nodal(-self.value * np.cross(s, t) * facets.weights[:, None])

    def add_stiffness(self, operator: StrainOperator, u: Array, matrix: PETSc.Mat, factor: float) -> None:
        """See :class:`Following`."""
        facets = _facets(operator, self.side)
        s, t = np.moveaxis(facets.deformed(u) @ _CROSS.reshape(3, 9), 1, 0)  # [a] as rows of nine
        N, (by_s, by_t) = facets.shape, np.moveaxis(facets.along, 1, 0)
        of_s = np.einsum("q,fqk,fql,fqm->fklm", facets.weights, N, by_s, t, optimize=True)
        of_t = np.einsum("q,fqk,fql,fqm->fklm", facets.weights, N, by_t, s, optimize=True)
        K = (-factor * self.value) * (of_s - of_t)
        n, k = K.shape[:2]
        K = K.reshape(n, k, k, 3, 3).transpose(0, 1, 3, 2, 4).reshape(n, 3 * k, 3 * k)
        K = 0.5 * (K + K.swapaxes(1, 2))
        dofs = facets.dofs.astype(np.int32)
        if n:
            values = K.reshape(n, -1)
            matrix.setValuesBlockedLocalRCV(dofs, dofs, values, PETSc.InsertMode.ADD_VALUES)


@lru_cache(maxsize=8)
def _facets(operator: StrainOperator, side: str) -> SideFacets:
    """Those of the side, made once: they are asked for in every iteration."""
    return SideFacets(operator, side)
