"""Hexahedral meshes with named sides: a box on any communicator, or a gmsh file. Lengths in m."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import dolfinx
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro import compat
from dd_macro.parallel import check_everywhere, span, total
from dd_macro.scene.hexahedra import Hexahedra, hexahedra
from dd_macro.scene.msh import read_msh_file
from tsg_micro.data.display import Displayed
from tsg_micro.data.errors import InputError
from tsg_micro.data.voxels import SIDES, UNITS

__all__ = ["SIDES", "UNITS", "TaggedMesh", "box", "distribute", "read_msh"]


@dataclass(frozen=True, repr=False)
class TaggedMesh(Displayed):
    """A distributed hexahedral mesh, the tags of its facets, and the names of the tags."""

    mesh: dolfinx.mesh.Mesh
    facet_tags: dolfinx.mesh.MeshTags
    names: dict[str, int]
    shared: dict[str, tuple[int, ...]] = field(default_factory=dict)
    """Further tags of a side: of facets that are on other sides too."""
    regions: dict[str, NDArray[np.int32]] = field(default_factory=dict)
    """Local cells of the named volumes, which may overlap."""
    parts: NDArray[np.int64] | None = None
    """Number of the connected part that each local cell is of; None where there is one."""

    def _display(self) -> tuple[str, dict[str, object]]:
        return f"TaggedMesh: {self.global_cells} hexahedra on {self.comm.size} rank{'s' * (self.comm.size > 1)}", {
            "sides": ", ".join(sorted(self.names)),
            "regions": ", ".join(sorted(self.regions)),
        }

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""
        return self.mesh.comm

    @property
    def owned_cells(self) -> int:
        """Number of cells that this rank owns; they come first in the local numbering."""
        return self.mesh.topology.index_map(3).size_local

    @property
    def global_cells(self) -> int:
        """Number of cells on all ranks."""
        return self.mesh.topology.index_map(3).size_global

    def facets(self, name: str) -> NDArray[np.int32]:
        """Local facets of the side ``name``.

        Raises:
            InputError: there is no such side.
        """
        if name not in self.names:
            raise InputError(f"side of the mesh: expected one of {', '.join(sorted(self.names))}, got {name!r}")
        tags = (self.names[name], *self.shared.get(name, ()))
        return np.sort(np.concatenate([self.facet_tags.find(tag) for tag in tags]))

    def cells_of(self, region: str) -> NDArray[np.int64]:
        """Owned cells of the named volume ``region``.

        Raises:
            InputError: there is no such region.
        """
        if region not in self.regions:
            known = ", ".join(sorted(self.regions)) or "none, the mesh has no named volumes"
            raise InputError(f"region of the mesh: expected one of {known}, got {region!r}")
        cells = self.regions[region]
        return cells[cells < self.owned_cells].astype(np.int64)

    def extent(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Least, largest and mean coordinates (3,) in m of the side's corners; collective.

        Raises:
            InputError: there is no such side, or no facet on it.
        """
        facets = self.facets(name)
        facets = facets[facets < self.mesh.topology.index_map(2).size_local]
        x = self.mesh.geometry.x[dolfinx.mesh.entities_to_geometry(self.mesh, 2, facets).reshape(-1)]
        low, high = span(self.comm, x)
        count, *mean = total(self.comm, [len(x), *x.sum(axis=0)])
        if count == 0:
            raise InputError(f"side of the mesh: expected facets on {name!r}, got none")
        return low, high, np.array(mean) / count


def box(
    comm: MPI.Comm,
    *,
    elements: tuple[int, int, int],
    size: tuple[float, float, float],
    refine: int = 1,
    halved: Collection[str] = (),
) -> TaggedMesh:
    """Box [0, Lx] x [0, Ly] x [0, Lz] of nx x ny x nz hexahedra, equal if none are halved, its sides named as in SIDES.

    Args:
        comm: of the mesh.
        elements: (nx, ny, nz).
        size: (Lx, Ly, Lz) in m.
        refine: parts of each element along each axis.
        halved: sides at which there are twice as many across the two outer rows of elements.

    Raises:
        InputError: not three positive integers, not three positive lengths, a refine below 1, or an unknown side.

    Example:
        >>> body = dd.box(MPI.COMM_WORLD, elements=(4, 2, 1), size=(8e-5, 4e-5, 2e-5))
        >>> body.global_cells
        8
    """
    if len(elements) != 3 or any(int(n) != n or n < 1 for n in elements):
        raise InputError(f"elements: expected three positive integers, got {elements}")
    if len(size) != 3 or not all(np.isfinite(s) and s > 0 for s in size):
        raise InputError(f"size: expected three positive lengths in m, got {size}")
    if int(refine) != refine or refine < 1 or isinstance(halved, str) or not set(halved) <= set(SIDES):
        raise InputError(
            f"refine, halved: expected a whole number of at least 1, and some of {', '.join(SIDES)}, got {refine} and "
            f"{halved!r}"
        )
    ends = [(SIDES[2 * axis] in halved, SIDES[2 * axis + 1] in halved) for axis in range(3)]
    planes = [size[axis] * _planes(int(elements[axis]), refine, ends[axis]) for axis in range(3)]
    n = [len(x) - 1 for x in planes]
    mesh = dolfinx.mesh.create_box(
        comm, [np.zeros(3), np.array(size, dtype=float)], n, dolfinx.mesh.CellType.hexahedron
    )
    facets, values = [], []
    for tag in range(6):
        axis, upper = divmod(tag, 2)
        place, near = upper * size[axis], 1e-3 * size[axis] / n[axis]
        found = dolfinx.mesh.locate_entities_boundary(
            mesh, 2, lambda x, axis=axis, place=place, near=near: np.abs(x[axis] - place) < near
        )
        facets.append(found)
        values.append(np.full(len(found), tag + 1, dtype=np.int32))
    if halved:
        x = mesh.geometry.x
        for axis in range(3):
            x[:, axis] = planes[axis][np.rint(x[:, axis] * (n[axis] / size[axis])).astype(np.int64)]
    return _tagged(mesh, np.concatenate(facets), np.concatenate(values), {name: i + 1 for i, name in enumerate(SIDES)})


def _planes(elements: int, refine: int, halved: tuple[bool, bool]) -> NDArray[np.float64]:
    """Where the elements of an axis meet, from 0 to 1."""
    parts = np.full(elements, refine)
    for end, there in zip((slice(2), slice(-2, None)), halved, strict=True):
        if there:
            parts[end] = 2 * refine
    places = np.interp(np.arange(parts.sum() + 1), np.cumsum([0, *parts]), np.arange(elements + 1))
    return np.asarray(places / elements)


def read_msh(
    path: str | Path,
    comm: MPI.Comm,
    *,
    unit: str = "m",
    size: tuple[float, float] | None = None,
    merge_nodes: bool = False,
) -> TaggedMesh:
    """Read a gmsh file (MSH 2.2 or 4.1) of 8-node hexahedra, sides as named physical surfaces.

    Rank 0 reads, and what is wrong with the file is raised on all ranks.

    Args:
        path: of the file; nothing in it is run.
        comm: of the mesh.
        unit: of the coordinates, one of UNITS.
        size: least and largest extent in m that the body may have, to notice another unit; any if None.
        merge_nodes: join nodes at one place; without, bodies that touch but share no node are refused.

    Raises:
        InputError: as read_msh_file and hexahedra, an unknown unit, or a body of another size.
    """
    if unit not in UNITS:
        raise InputError(f"unit of the mesh: expected one of {', '.join(UNITS)}, got {unit!r}")
    body, message = None, None
    if comm.rank == 0:
        try:
            body = hexahedra(read_msh_file(path), unit=UNITS[unit], merge_nodes=merge_nodes)
            _check_size(body.points, size, unit)
        except InputError as error:
            message = str(error) if str(error).startswith("mesh ") else f"mesh {path}: {error}"
    check_everywhere(comm, message)
    return distribute(comm, body)


def distribute(comm: MPI.Comm, body: Hexahedra | None) -> TaggedMesh:
    """The mesh, over the ranks of ``comm``, of the body that rank 0 has; the others have None. Collective."""
    nothing = np.zeros((0, 8), dtype=np.int64)
    mesh = compat.hexahedral_mesh(comm, np.zeros((0, 3)) if body is None else body.points, _of(body, "cells", nothing))
    facets, values = _of(body, "facets", nothing[:, :4]), _of(body, "facet_tags", nothing[:, 0])
    tags = compat.tag_facets(mesh, facets, values)
    sides, regions, parts = comm.bcast(None if body is None else (body.sides, body.regions, body.parts))
    cells = np.asarray(mesh.topology.original_cell_index)
    return TaggedMesh(
        mesh,
        tags,
        {name: own[0] for name, own in sides.items()},
        shared={name: own[1:] for name, own in sides.items() if len(own) > 1},
        regions={name: np.flatnonzero(np.isin(cells, inside)).astype(np.int32) for name, inside in regions.items()},
        parts=parts[cells] if parts.any() else None,
    )


def _of(body: Hexahedra | None, name: str, nothing: NDArray[np.int64]) -> NDArray[Any]:
    """The array of the body that rank 0 has."""
    return nothing if body is None else getattr(body, name)


def _check_size(points: NDArray[np.float64], size: tuple[float, float] | None, unit: str) -> None:
    extent = float(np.ptp(points, axis=0).max())
    if size is None or size[0] * (1 - 1e-6) <= extent <= size[1]:
        return
    fitting = [name for name, factor in UNITS.items() if size[0] <= extent / UNITS[unit] * factor <= size[1]]
    raise InputError(
        f"expected a body between {size[0]:.3g} and {size[1]:.3g} m across, got {extent:.3g} m, its coordinates taken "
        f"in {unit}; say their unit (--mesh-unit {' or '.join(fitting) or 'UNIT'}, unit in a scene)"
    )


def _tagged(
    mesh: dolfinx.mesh.Mesh, facets: NDArray[np.int32], values: NDArray[np.int32], names: dict[str, int]
) -> TaggedMesh:
    order = np.argsort(facets)
    tags = dolfinx.mesh.meshtags(mesh, 2, facets[order], values[order])
    return TaggedMesh(mesh, tags, names)
