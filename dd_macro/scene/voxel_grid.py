"""A hexahedral mesh as voxels: the place of every cell on one grid of cubes, and the cells' faces on its sides."""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx
import numpy as np
from numpy.typing import NDArray

from dd_macro.compat import geometry_nodes
from dd_macro.scene.mesh import TaggedMesh
from tsg_micro.data.errors import InputError

__all__ = ["VoxelGrid", "voxel_grid"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
_NEAR = 1e-4
"""Of an edge: how far the corner of a voxel may be from the grid."""


@dataclass(frozen=True)
class VoxelGrid:
    """The cells of a mesh, all on one rank, in the order of that rank."""

    domain: TaggedMesh
    edge: float
    """Of a voxel, m."""
    origin: Array
    """Coordinates (3,) of the lowest corner of voxel (0, 0, 0), m."""
    index: Ints
    """Place of every cell on the grid (cells, 3), from 0."""

    @property
    def midpoint(self) -> Array:
        """Of every cell (cells, 3), m."""
        return self.origin + self.edge * (self.index + 0.5)

    def faces(self, side: str) -> Ints:
        """Faces on a side of the mesh: rows (k, 3) of cell, axis and end (0 low, 1 high); of two cells the first.

        Raises:
            InputError: there is no such side, or it has no facet.
        """
        mesh, facets = self.domain.mesh, self.domain.facets(side)
        if len(facets) == 0:
            raise InputError(f"side of the mesh: expected facets on {side!r}, got none")
        mesh.topology.create_connectivity(2, 3)
        cells = mesh.topology.connectivity(2, 3)
        cell = np.array([cells.links(facet)[0] for facet in facets], dtype=np.int64)
        middle = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, 2, facets)].mean(axis=1)
        away = middle - self.midpoint[cell]
        axis = np.abs(away).argmax(axis=1)
        end = away[np.arange(len(away)), axis] > 0.0
        return np.column_stack([cell, axis, end]).astype(np.int64)


def voxel_grid(domain: TaggedMesh, edge: float) -> VoxelGrid:
    """The voxels of a mesh whose cells are all cubes of this ``edge`` (m) along x, y and z on one grid.

    Raises:
        InputError: the mesh is shared by several ranks, or a cell is no such cube; the first one is named.
    """
    if domain.comm.size > 1:
        raise InputError(f"full tensegrity: expected one rank, got {domain.comm.size}")
    corners = domain.mesh.geometry.x[geometry_nodes(domain.mesh)]
    low, high = corners.min(axis=1), corners.max(axis=1)
    origin = low.min(axis=0)
    place = (low - origin) / edge
    index = np.rint(place).astype(np.int64)
    near = np.abs(corners - (origin + edge * index)[:, None]) < _NEAR * edge
    far = np.abs(corners - (origin + edge * (index + 1))[:, None]) < _NEAR * edge
    kind = (far * np.array([1, 2, 4])).sum(axis=2)  # which corner of the cube it is
    cube = (near ^ far).all(axis=(1, 2)) & (np.sort(kind, axis=1) == np.arange(8)).all(axis=1)
    wrong = np.flatnonzero(~cube)
    if wrong.size:
        number = np.asarray(domain.mesh.topology.original_cell_index)[wrong]
        first = wrong[number.argmin()]
        size = " x ".join(f"{length:.4g}" for length in high[first] - low[first])
        at = ", ".join(f"{x:.4g}" for x in corners[first].mean(axis=0))
        raise InputError(
            f"mesh: expected cubes of one block's edge, {edge:.4g} m, on one grid, got cell {number.min()} of {size} m "
            f"around ({at}) m ({len(wrong)} of {len(cube)} cells)"
        )
    return VoxelGrid(domain, edge, origin, index)
