"""Static condensation: the stiffness of elements with nine unknowns of their own, left in the nodal displacement alone.

    K_uu - K_ua K_aa^-1 K_au,      right side f_u - K_ua K_aa^-1 f_a,      a = K_aa^-1 (f_a - K_au u)
Element matrices are made in NumPy for many cells at once, those of one modulus once for all cells of one shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx
import dolfinx.fem.petsc
import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dd_macro.parallel import total
from dd_macro.scene.spaces import Stiffness, StrainOperator, stiffness_form
from tsg_micro.data.errors import ConvergenceError
from tsg_micro.data.mandel import BASIS

__all__ = ["CellShapes", "CondensedMatrix"]

Array = NDArray[np.float64]
_CHUNK = 64  # cells whose matrices are made at once: what they need stays in the cache
_SAME = 1e-12  # relative, of numbers that count as equal


@dataclass(frozen=True)
class CellShapes:
    """Cells of equal shape are of one ``kind`` (cells,); ``weights`` (kinds, points) in m^3.

    ``gradients`` (kinds, points, 11, 3) in 1/m are those of the eight nodal functions and of the three inner ones.
    """

    kind: NDArray[np.int64]
    gradients: Array
    weights: Array

    @classmethod
    def of(cls, operator: StrainOperator, inner: Array) -> CellShapes:
        """Of the cells of ``operator``, and of gradients ``inner`` (cells, points, 3, 3) of the inner functions."""
        maps = operator.maps
        gradients = np.concatenate([operator.shape_gradients(maps.first), inner[maps.first]], axis=2)
        return cls(maps.kind, gradients, maps.weights)


class CondensedMatrix(Stiffness):
    """Condensed K = sum w [B M]^T C [B M] of the trilinear space of ``operator``; it is assembled again and again."""

    def __init__(self, operator: StrainOperator, shapes: CellShapes) -> None:
        super().__init__(dolfinx.fem.petsc.create_matrix(stiffness_form(operator, np.eye(6))))
        self._shapes = shapes
        self._dofs = np.ascontiguousarray(operator.displacements.dofmap.list[: operator.domain.owned_cells])
        self._nodes = operator.owned_nodes
        self._ghosted = dolfinx.fem.Function(operator.displacements)
        self._back, self._inverse = np.zeros((0, 9, 24)), np.zeros((0, 9, 9))
        self._place = shapes.kind
        self._comm, self._negative, self._singular = operator.comm, 0, 0

    def assemble(self, C: Array) -> PETSc.Mat:
        """``matrix`` with the moduli C in Pa, (n, 6, 6) or (n, 15, 15), or one (6, 6) for all points; symmetric.

        Raises:
            ConvergenceError: the inner unknowns of some cell have no stiffness; on all ranks.
        """
        self.matrix.zeroEntries()
        self._negative = self._singular = 0
        cells, (kinds, points) = len(self._dofs), self._shapes.weights.shape
        alike = C.ndim == 2 and kinds <= _CHUNK  # cells of one kind have one matrix
        per_cell = np.broadcast_to(C, (cells, points, *C.shape)) if C.ndim == 2 else C
        per_cell = per_cell.reshape(cells, points, *C.shape[-2:])
        if alike:
            self._place = self._shapes.kind
            K, self._back, self._inverse = self._condensed(per_cell[:kinds], np.arange(kinds))
        else:
            self._place = np.arange(cells)
            self._back, self._inverse = np.empty((cells, 9, 24)), np.empty((cells, 9, 9))
        for some in (slice(begin, begin + _CHUNK) for begin in range(0, cells, _CHUNK)):
            if not alike:
                K, self._back[some], self._inverse[some] = self._condensed(per_cell[some], self._shapes.kind[some])
            values = K[self._shapes.kind[some]] if alike else K
            dofs = self._dofs[some]
            self.matrix.setValuesBlockedLocalRCV(dofs, dofs, values.reshape(len(dofs), -1), PETSc.InsertMode.ADD_VALUES)
        self.matrix.assemble()
        self.negative, singular = (int(n) for n in total(self._comm, [self._negative, self._singular]))
        if singular:
            raise ConvergenceError(
                f"elements: expected modes with some stiffness, got none in {singular} cells or more"
            )
        return self.matrix

    def condense(self, force: Array) -> Array:
        """Right side (3 * nodes,) in N of the condensed matrix for ``force`` (3 * nodes + 9 * cells,) in N."""
        nodal, inner = np.split(force, [3 * self._nodes])
        x = self._ghosted.x
        x.array[:] = 0.0
        moved = np.einsum("cai,ca->ci", self._back[self._place], inner.reshape(-1, 9))
        np.subtract.at(x.array.reshape(-1, 3), self._dofs, moved.reshape(-1, 8, 3))
        x.scatter_reverse(dolfinx.la.InsertMode.add)
        return np.asarray(nodal + x.array[: 3 * self._nodes])

    def expand(self, u: Array, force: Array) -> Array:
        """All unknowns (3 * nodes + 9 * cells,) of the nodal u (3 * nodes,) for ``force``."""
        x = self._ghosted.x
        x.array[: 3 * self._nodes] = u
        x.scatter_forward()
        of_nodes = np.einsum("cai,ci->ca", self._back[self._place], x.array.reshape(-1, 3)[self._dofs].reshape(-1, 24))
        of_force = np.einsum("cab,cb->ca", self._inverse[self._place], force[3 * self._nodes :].reshape(-1, 9))
        return np.concatenate([u, (of_force - of_nodes).reshape(-1)])

    def _condensed(self, C: Array, kind: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Condensed K (k, 24, 24), K_aa^-1 K_au (k, 9, 24) and K_aa^-1 (k, 9, 9) of the moduli C (k, points, ...)."""
        kind = kind[:1] if len(self._shapes.weights) == 1 else kind  # one for all
        gradients, k = self._shapes.gradients[kind], len(C)
        N = _mandel(gradients) if C.shape[-1] == 6 else _gradient_and_mandel(gradients)
        CN = (self._shapes.weights[kind][..., None, None] * C) @ N
        rows = C.shape[1] * C.shape[2]
        K = N.reshape(len(kind), rows, 33).swapaxes(1, 2) @ CN.reshape(k, rows, 33)
        inverse = self._inverse_of(K[:, 24:, 24:])
        back = inverse @ K[:, 24:, :24]
        return K[:, :24, :24] - K[:, :24, 24:] @ back, back, inverse

    def _inverse_of(self, K: Array) -> Array:
        """K_aa^-1 (k, 9, 9), the unit matrix where one is singular; not positive ones are counted."""
        try:
            np.linalg.cholesky(K)
            return np.asarray(np.linalg.inv(K))
        except np.linalg.LinAlgError:
            values = np.linalg.eigvalsh(K)
            self._negative += int((values < 0).sum())
            lost = np.abs(values).min(axis=1) <= _SAME * np.abs(values).max(axis=1)
            self._singular += int(lost.sum())
            return np.asarray(np.linalg.inv(np.where(lost[:, None, None], np.eye(9), K)))


def _mandel(gradients: Array) -> Array:
    """Mandel strains (..., 6, 3 f) of unit amplitudes of f functions, from their gradients (..., f, 3)."""
    N = np.zeros((*gradients.shape[:-2], 6, 3 * gradients.shape[-2]))
    for i in range(3):
        for m in range(6):
            for j in np.flatnonzero(BASIS[m, i]):
                N[..., m, i::3] = BASIS[m, i, j] * gradients[..., j]
    return N


def _gradient_and_mandel(gradients: Array) -> Array:
    """Gradients row by row of the nodal functions, Mandel strains of the three inner ones: (..., 15, 33)."""
    N = np.zeros((*gradients.shape[:-2], 15, 33))
    for i in range(3):
        N[..., 3 * i : 3 * i + 3, i:24:3] = gradients[..., :8, :].swapaxes(-1, -2)
    N[..., 9:, 24:] = _mandel(gradients[..., 8:, :])
    return N
