"""B of an operator without a matrix: strains and forces cell by cell, from gradients at the quadrature points.

With J the map of a cell, N the functions of the space in the reference cell and E_m the tensors whose coefficients the
strain has, B u = E_m : (u_n (x) J^-T grad N_n), and the force of a stress is its transpose, times the weights. Cells of
equal shape have one B (components, functions), a product of matrices for all of them; others keep J^-1 at their points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

__all__ = ["CellGradients", "CellMaps", "equal_cells"]

Array = NDArray[np.float64]
_CHUNK = 1024  # cells that are worked on at once: what they need stays in the cache
_SAME = 1e-12  # relative, of lengths that count as equal


def equal_cells(comm: MPI.Comm, corners: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The shape (cells,) of each cell, from 0, of corners (cells, 8, 3), and a cell (shapes,) of each; collective."""
    offsets = (corners - corners[:, :1]).reshape(len(corners), 24)
    size = comm.allreduce(float(np.abs(offsets).max(initial=0.0)), MPI.MAX)
    if len(offsets) == 0 or np.abs(offsets - offsets[0]).max() <= _SAME * size:
        return np.zeros(len(offsets), dtype=np.int64), np.arange(min(1, len(offsets)))
    rounded = np.rint(offsets / (_SAME * size)).astype(np.int64)
    key = rounded @ np.random.default_rng(0).integers(2**62, size=24)  # equal for equal cells, else unlikely to be
    _, first, kind = np.unique(key, return_index=True, return_inverse=True)
    return kind, first


@dataclass(frozen=True)
class CellMaps:
    """Maps of the cells: their shape ``kind`` (cells,), and of each shape J^-1 (shapes, points, 3, 3) in 1/m and the
    ``weights`` (shapes, points) in m^3; ``first`` (shapes,) is a cell of each.
    """

    kind: NDArray[np.int64]
    first: NDArray[np.int64]
    inverse: Array
    weights: Array

    @classmethod
    def of(cls, comm: MPI.Comm, corners: Array, gradients: Array, weights: Array) -> CellMaps:
        """Of corners (cells, 8, 3) in m, the ``gradients`` (3, points, 8) of the trilinear functions in the reference
        cell, and the weights (points,) there; collective.
        """
        kind, first = equal_cells(comm, corners)
        J = np.einsum("kqn,cni->cqik", gradients, corners[first])
        return cls(kind, first, np.linalg.inv(J), np.abs(np.linalg.det(J)) * weights)


class CellGradients:
    """B and its transpose of the cells.

    Args:
        maps: of the cells.
        gradients: of the functions of the space in the reference cell, (3, points, functions).
        directions: the tensors (components, 3, 3) whose coefficients a strain has.
    """

    def __init__(self, maps: CellMaps, gradients: Array, directions: Array) -> None:
        self._maps = maps
        self.components, (_, self.points, self.functions) = len(directions), gradients.shape
        self._directions = np.ascontiguousarray(directions.reshape(-1, 9))
        self._reference = np.ascontiguousarray(gradients.transpose(2, 1, 0).reshape(self.functions, -1))
        self._one: tuple[Array, Array] | None = None
        if len(maps.first) == 1:
            of_cell = np.einsum("kqn,qkj->qnj", gradients, maps.inverse[0])
            B = np.einsum("mij,qnj->qmni", directions, of_cell)
            rows = self.points * self.components
            weighted = maps.weights[0][:, None, None, None] * B
            self._one = B.reshape(rows, -1).T.copy(), weighted.reshape(rows, -1).copy()

    def strain(self, u: Array) -> Array:
        """B u (cells * points, components) of the displacement u (cells, functions, 3) in m."""
        cells = len(u)
        out = np.empty((cells, self.points * self.components))
        for some in _chunks(cells):
            if self._one is not None:
                np.matmul(u[some].reshape(-1, 3 * self.functions), self._one[0], out=out[some])
                continue
            inverse = self._maps.inverse[self._maps.kind[some]]
            local = u[some].swapaxes(1, 2).reshape(-1, self.functions) @ self._reference
            H = np.einsum("ciqk,cqkj->cqij", local.reshape(len(inverse), 3, self.points, 3), inverse)
            out[some] = (H.reshape(-1, 9) @ self._directions.T).reshape(len(inverse), -1)
        return out.reshape(-1, self.components)

    def force(self, stress: Array) -> Array:
        """Forces (cells, functions, 3) in N of the stress (cells * points, components) in Pa."""
        stress = stress.reshape(-1, self.points * self.components)
        cells = len(stress)
        out = np.empty((cells, 3 * self.functions))
        for some in _chunks(cells):
            if self._one is not None:
                np.matmul(stress[some], self._one[1], out=out[some])
                continue
            kind = self._maps.kind[some]
            inverse = self._maps.inverse[kind] * self._maps.weights[kind][..., None, None]
            P = (stress[some].reshape(-1, self.components) @ self._directions).reshape(len(kind), self.points, 3, 3)
            local = np.einsum("cqij,cqkj->ciqk", P, inverse).reshape(-1, 3 * self.points)
            out[some] = (local @ self._reference.T).reshape(len(kind), 3, -1).swapaxes(1, 2).reshape(len(kind), -1)
        return out.reshape(cells, self.functions, 3)


def _chunks(cells: int) -> list[slice]:
    return [slice(begin, begin + _CHUNK) for begin in range(0, cells, _CHUNK)]
