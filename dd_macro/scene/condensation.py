"""Static condensation: the stiffness of elements with nine unknowns of their own, left in the nodal displacement alone.

    K_uu - K_ua K_aa^-1 K_au,      right side f_u - K_ua K_aa^-1 f_a,      a = K_aa^-1 (f_a - K_au u)
Element matrices are made in NumPy for many cells at once, once for all cells of one shape and with the same moduli.
"""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx
import dolfinx.fem.petsc
import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dd_macro.parallel import total
from dd_macro.products import times
from dd_macro.scene.spaces import Stiffness, StrainOperator, stiffness_form
from tsg_micro.data.errors import ConvergenceError
from tsg_micro.data.mandel import BASIS

__all__ = ["CellShapes", "CondensedMatrix"]

Array = NDArray[np.float64]
_CHUNK = 64  # cells whose matrices are made at once: what they need stays in the cache
_SAME = 1e-12  # relative, of numbers that count as equal
_KEYS = np.random.default_rng(0).integers(2**62, size=9)  # sums of multiples of these tell cells apart


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
        self._unknowns = (3 * self._dofs[..., None].astype(np.int64) + np.arange(3)).reshape(-1)
        self._back, self._inverse = np.zeros((0, 9, 24)), np.zeros((0, 9, 9))
        self._place = shapes.kind
        self._comm = operator.comm

    def assemble(self, C: Array, own: NDArray[np.int64] | None = None) -> PETSc.Mat:
        """``matrix`` with the moduli C in Pa; symmetric. Cells of equal shape and moduli share theirs.

        C is one (6, 6) for all points, or (n, 6, 6) or (n, 15, 15), or as many as there are, of which each point has
        its ``own`` (n,).

        Raises:
            ConvergenceError: the inner unknowns of some cell have no stiffness; on all ranks.
        """
        self.matrix.zeroEntries()
        cells, points = len(self._dofs), self._shapes.weights.shape[1]
        kind = self._shapes.kind
        if C.ndim == 2:
            C, own = C[None], np.zeros((cells, points), dtype=np.int64)
            first, self._place = _distinct(kind)
        elif own is None:
            own = np.arange(cells * points).reshape(cells, points)
            first = self._place = np.arange(cells)
        else:
            own = own.reshape(cells, points)
            first, self._place = _distinct(np.column_stack([own, kind]) @ _KEYS[: points + 1])
        self._back, self._inverse = np.empty((len(first), 9, 24)), np.empty((len(first), 9, 9))
        order, often = np.argsort(self._place, kind="stable"), np.bincount(self._place, minlength=len(first))
        end, counts = np.cumsum([0, *often]), np.zeros(2)
        for begin in range(0, len(first), _CHUNK):
            some = slice(begin, begin + _CHUNK)
            K, self._back[some], self._inverse[some], signs = self._condensed(C[own[first[some]]], kind[first[some]])
            counts += signs @ often[some]
            alike = order[end[begin] : end[min(begin + _CHUNK, len(first))]]
            for part in (alike[i : i + _CHUNK] for i in range(0, len(alike), _CHUNK)):
                dofs, values = self._dofs[part], K[self._place[part] - begin].reshape(len(part), -1)
                self.matrix.setValuesBlockedLocalRCV(dofs, dofs, values, PETSc.InsertMode.ADD_VALUES)
        self.matrix.assemble()
        self.negative, singular = (int(n) for n in total(self._comm, counts))
        if singular:
            raise ConvergenceError(
                f"elements: expected modes with some stiffness, got none in {singular} cells or more"
            )
        return self.matrix

    def condense(self, force: Array) -> Array:
        """Right side (3 * nodes,) in N of the condensed matrix for ``force`` (3 * nodes + 9 * cells,) in N."""
        nodal, inner = np.split(force, [3 * self._nodes])
        x = self._ghosted.x
        moved = times(self._back.swapaxes(1, 2), self._place, inner.reshape(-1, 9))
        x.array[:] = -np.bincount(self._unknowns, moved.reshape(-1), minlength=len(x.array))
        x.scatter_reverse(dolfinx.la.InsertMode.add)
        return np.asarray(nodal + x.array[: 3 * self._nodes])

    def expand(self, u: Array, force: Array) -> Array:
        """All unknowns (3 * nodes + 9 * cells,) of the nodal u (3 * nodes,) for ``force``."""
        x = self._ghosted.x
        x.array[: 3 * self._nodes] = u
        x.scatter_forward()
        at_nodes = x.array.reshape(-1, 3)[self._dofs].reshape(-1, 24)
        inner = times(self._inverse, self._place, force[3 * self._nodes :].reshape(-1, 9))
        return np.concatenate([u, (inner - times(self._back, self._place, at_nodes)).reshape(-1)])

    def _condensed(self, C: Array, kind: NDArray[np.int64]) -> tuple[Array, Array, Array, Array]:
        """Condensed K (k, 24, 24), K_aa^-1 K_au (k, 9, 24) and K_aa^-1 (k, 9, 9) of the moduli C (k, points, ...), and
        how many of its eigenvalues are negative, and whether one is zero (2, k).
        """
        kind = kind[:1] if len(self._shapes.weights) == 1 else kind  # one for all
        gradients, k = self._shapes.gradients[kind], len(C)
        N = _mandel(gradients) if C.shape[-1] == 6 else _gradient_and_mandel(gradients)
        CN = (self._shapes.weights[kind][..., None, None] * C) @ N
        rows = C.shape[1] * C.shape[2]
        K = N.reshape(len(kind), rows, 33).swapaxes(1, 2) @ CN.reshape(k, rows, 33)
        inverse, signs = _inverse(K[:, 24:, 24:])
        back = inverse @ K[:, 24:, :24]
        return K[:, :24, :24] - K[:, :24, 24:] @ back, back, inverse, signs


def _inverse(K: Array) -> tuple[Array, Array]:
    """K_aa^-1 (k, 9, 9), the unit matrix where one is singular; negative eigenvalues, and singular ones (2, k)."""
    try:
        np.linalg.cholesky(K)
        return np.linalg.inv(K), np.zeros((2, len(K)))
    except np.linalg.LinAlgError:
        values = np.linalg.eigvalsh(K)
        lost = np.abs(values).min(axis=1) <= _SAME * np.abs(values).max(axis=1)
        return np.linalg.inv(np.where(lost[:, None, None], np.eye(9), K)), np.array([(values < 0).sum(axis=1), lost])


def _distinct(key: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """A cell of each key, and which of these each cell is like."""
    _, first, place = np.unique(key, return_index=True, return_inverse=True)
    return first, place


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
