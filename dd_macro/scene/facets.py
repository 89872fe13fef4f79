"""Integrals over the outer facets of a side, at rest and in the deformed body; NumPy alone, nothing is compiled.

A facet is mapped by x(s, t), (s, t) in the unit square, from the corners of its cell. Its oriented area is
x_s x x_t ds dt, outwards, so forces need neither a normal nor an area of their own.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import basix
import dolfinx
import numpy as np
from numpy.typing import NDArray

from dd_macro.compat import geometry_nodes
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.errors import InputError

__all__ = ["SideFacets", "add_at_nodes", "ghosted"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class SideFacets:
    """The outer facets of the side ``name`` whose cells this rank owns; collective.

    ``cells`` (f,); ``shape`` (f, q, k) of the k nodes of a cell's displacement at the q points of each facet, its
    derivatives ``along`` (f, 2, q, k) by s and t, and ``weights`` (q,) of the unit square.

    Raises:
        InputError: there is no such side, or no outer facet on it; on all ranks.
    """

    def __init__(self, operator: StrainOperator, name: str) -> None:
        self.operator, self.name = operator, name
        domain, mesh = operator.domain, operator.domain.mesh
        facets = domain.facets(name)
        mesh.topology.create_connectivity(2, 3)
        mesh.topology.create_connectivity(3, 2)
        cell_of, facets_of = mesh.topology.connectivity(2, 3), mesh.topology.connectivity(3, 2)
        outer = [int(f) for f in facets if len(cell_of.links(f)) == 1 and cell_of.links(f)[0] < domain.owned_cells]
        outer = _without_shared(mesh, outer)
        if operator.comm.allreduce(len(outer)) == 0:
            raise InputError(f"side of the mesh: expected outer facets of the mesh on {name!r}, got none")
        self.cells = np.array([cell_of.links(f)[0] for f in outer], dtype=np.int64)
        place = np.array([list(facets_of.links(cell_of.links(f)[0])).index(f) for f in outer], dtype=np.int64)
        hexahedron, element = basix.CellType.hexahedron, operator.displacements.element.basix_element
        linear = basix.create_element(basix.ElementFamily.P, hexahedron, 1)
        square, self.weights = basix.make_quadrature(basix.CellType.quadrilateral, 2 * element.degree + 1)
        corners = np.array([basix.geometry(hexahedron)[v] for v in basix.topology(hexahedron)[2]])  # (6, 4, 3)
        ends = corners[:, 1:3] - corners[:, :1]  # (6, 2, 3): reference directions of s and t
        points = corners[:, None, 0] + np.einsum("qa,fai->fqi", square, ends)
        self._geometry = _tabulated(linear, points, ends, place)
        self.shape, self.along = _tabulated(element, points, ends, place)
        self.dofs = operator.displacements.dofmap.list[self.cells].astype(np.int64)  # of nodes, (f, k)

    @cached_property
    def _corners(self) -> Array:
        """Corners (f, 8, 3) in m of the cells."""
        mesh = self.operator.domain.mesh
        return np.asarray(mesh.geometry.x[geometry_nodes(mesh)[self.cells]])

    @cached_property
    def points(self) -> Array:
        """Coordinates (f, q, 3) in m of the points."""
        return np.einsum("fqk,fki->fqi", self._geometry[0], self._corners)

    @cached_property
    def directions(self) -> Array:
        """x_s and x_t (f, 2, q, 3) in m at rest, in the order in which x_s x x_t looks outwards."""
        found = np.einsum("faqk,fki->faqi", self._geometry[1], self._corners)
        middle = self.points.mean(axis=1) - self._corners.mean(axis=1)
        inwards = np.einsum("fi,fi->f", np.cross(found[:, 0], found[:, 1]).mean(axis=1), middle) < 0
        if inwards.any():
            found[inwards] = found[inwards, ::-1]
            self.along[inwards] = self.along[inwards, ::-1]
        return np.asarray(found)

    @cached_property
    def areas(self) -> Array:
        """Oriented areas (f, q, 3) in m^2 at rest, weights included."""
        s, t = self.directions[:, 0], self.directions[:, 1]
        return np.asarray(np.cross(s, t) * self.weights[:, None])

    def deformed(self, u: Array) -> Array:
        """x_s and x_t (f, 2, q, 3) in m where the nodes are displaced by u (3 * nodes,)."""
        rest = self.directions  # first: it decides the order of s and t
        moved = ghosted(self.operator, u)[self.dofs]
        return np.asarray(rest + np.einsum("faqk,fki->faqi", self.along, moved))

    def nodal(self, force: Array) -> Array:
        """Nodal forces (3 * nodes,) in N of forces (f, q, 3) in N at the points; collective."""
        return add_at_nodes(self.operator, self.dofs, np.einsum("fqk,fqi->fki", self.shape, force))


def ghosted(operator: StrainOperator, u: Array) -> Array:
    """Displacement (nodes, 3) in m of owned nodes and ghosts, of u whose first 3 * nodes are nodal; collective."""
    function = dolfinx.fem.Function(operator.displacements)
    function.x.array[: 3 * operator.owned_nodes] = u[: 3 * operator.owned_nodes]
    function.x.scatter_forward()
    return np.asarray(function.x.array.reshape(-1, 3))


def add_at_nodes(operator: StrainOperator, dofs: Index, values: Array) -> Array:
    """Sum (3 * nodes,) over all ranks of values (m, k, 3) at nodes (m, k); collective."""
    function = dolfinx.fem.Function(operator.displacements)
    np.add.at(function.x.array.reshape(-1, 3), dofs.reshape(-1), values.reshape(-1, 3))
    function.x.scatter_reverse(dolfinx.la.InsertMode.add)
    return np.array(function.x.array[: 3 * operator.owned_nodes])


def _without_shared(mesh: dolfinx.mesh.Mesh, facets: list[int]) -> list[int]:
    """Those facets that no cell of another rank is at: a ghost cell that is not here leaves them looking like outer."""
    outer = set(dolfinx.mesh.exterior_facet_indices(mesh.topology).tolist())
    return [f for f in facets if f in outer]


def _tabulated(element: Any, points: Array, ends: Array, place: Index) -> tuple[Array, Array]:
    """Functions (f, q, k) of a basix element at reference points (6, q, 3) of the facets ``place``, and along s, t."""
    values = np.array([element.tabulate(1, at)[..., 0] for at in points])  # (6, 4, q, k)
    along = np.einsum("fai,fiqk->faqk", ends, values[:, 1:])
    return values[place, 0], along[place]
