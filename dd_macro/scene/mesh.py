"""Hexahedral meshes with named sides: a box on any communicator, or a gmsh file. Lengths in m."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import basix
import dolfinx
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro import compat
from dd_macro.parallel import check_everywhere
from tsg_micro.data.errors import InputError

__all__ = ["SIDES", "TaggedMesh", "box", "read_msh"]

SIDES = ("left", "right", "bottom", "top", "back", "front")
"""Sides of a box: left and right are normal to x, bottom and top to y, back and front to z."""

_GMSH_SOLIDS = {4: "tetrahedra", 5: "hexahedra", 6: "prisms", 7: "pyramids", 11: "second-order tetrahedra"}


@dataclass(frozen=True)
class TaggedMesh:
    """A distributed hexahedral mesh, the tags of its facets, and the names of the tags."""

    mesh: dolfinx.mesh.Mesh
    facet_tags: dolfinx.mesh.MeshTags
    names: dict[str, int]

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
        return self.facet_tags.find(self.names[name])


def box(comm: MPI.Comm, *, elements: tuple[int, int, int], size: tuple[float, float, float]) -> TaggedMesh:
    """Box [0, Lx] x [0, Ly] x [0, Lz] of nx x ny x nz equal hexahedra, its sides named as in SIDES.

    Args:
        elements: (nx, ny, nz).
        size: (Lx, Ly, Lz) in m.

    Raises:
        InputError: not three positive integers, or not three positive lengths.
    """
    if len(elements) != 3 or any(int(n) != n or n < 1 for n in elements):
        raise InputError(f"elements: expected three positive integers, got {elements}")
    if len(size) != 3 or not all(np.isfinite(s) and s > 0 for s in size):
        raise InputError(f"size: expected three positive lengths in m, got {size}")
    cell = dolfinx.mesh.CellType.hexahedron
    n = [int(k) for k in elements]
    mesh = dolfinx.mesh.create_box(comm, [np.zeros(3), np.array(size, dtype=float)], n, cell)
    facets, values = [], []
    for tag in range(6):
        axis, upper = divmod(tag, 2)
        place, near = upper * size[axis], 1e-3 * size[axis] / n[axis]
        found = dolfinx.mesh.locate_entities_boundary(
            mesh, 2, lambda x, axis=axis, place=place, near=near: np.abs(x[axis] - place) < near
        )
        facets.append(found)
        values.append(np.full(len(found), tag + 1, dtype=np.int32))
    return _tagged(mesh, np.concatenate(facets), np.concatenate(values), {name: i + 1 for i, name in enumerate(SIDES)})


def read_msh(path: str | Path, comm: MPI.Comm) -> TaggedMesh:
    """Read a gmsh file of 8-node hexahedra, coordinates in m, sides as named physical surfaces.

    Rank 0 reads, and what is wrong with the file is raised on all ranks.

    Raises:
        InputError: no such file, gmsh missing, not readable, other cells than hexahedra, no named surface,
            or degenerate cells.
    """
    model, message = None, None
    names: dict[str, int] = {}
    try:
        if comm.rank == 0:
            try:
                model, names = _open_gmsh(Path(path))
            except InputError as error:
                message = str(error)
        check_everywhere(comm, message)
        names = comm.bcast(names)
        mesh, tags = compat.gmsh_to_mesh(model, comm)
    finally:
        if comm.rank == 0:
            _close_gmsh()
    _check_cells(mesh, str(path))
    if tags is None:
        raise InputError(f"mesh {path}: expected named physical surfaces (its sides), got none with facets")
    return TaggedMesh(mesh, tags, names)


def _tagged(
    mesh: dolfinx.mesh.Mesh, facets: NDArray[np.int32], values: NDArray[np.int32], names: dict[str, int]
) -> TaggedMesh:
    order = np.argsort(facets)
    tags = dolfinx.mesh.meshtags(mesh, 2, facets[order], values[order])
    return TaggedMesh(mesh, tags, names)


def _open_gmsh(path: Path) -> tuple[Any, dict[str, int]]:
    """The gmsh model of ``path`` and its named surfaces; checked so that reading on cannot fail on rank 0 alone."""
    if not path.is_file():
        raise InputError(f"mesh {path}: no such file")
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise InputError(f"mesh {path}: reading it needs the Python package gmsh ({error})") from None
    if not gmsh.isInitialized():
        gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.clear()
    try:
        gmsh.merge(str(path))
    except Exception as error:  # gmsh raises bare Exception
        raise InputError(f"mesh {path}: gmsh cannot read it ({error})") from None
    model = gmsh.model
    kinds = set(model.mesh.getElementTypes(3))
    if kinds != {5}:
        found = (
            ", ".join(sorted(_GMSH_SOLIDS.get(k, f"gmsh type {k}") for k in kinds))
            or "no solid cells (a file with named surfaces holds only solids that are in a physical volume)"
        )
        raise InputError(f"mesh {path}: expected 8-node hexahedra only, got {found}")
    names = {model.getPhysicalName(2, tag): int(tag) for dim, tag in model.getPhysicalGroups(2)}
    names.pop("", None)
    if not names:
        raise InputError(f"mesh {path}: expected named physical surfaces (its sides), got none")
    for name, tag in names.items():
        if not any(len(model.mesh.getElements(2, e)[0]) for e in model.getEntitiesForPhysicalGroup(2, tag)):
            raise InputError(f"mesh {path}: expected facets on the side {name!r}, got none")
    if not model.getPhysicalGroups(3):
        model.addPhysicalGroup(3, [tag for _, tag in model.getEntities(3)])
    return model, names


def _close_gmsh() -> None:
    try:
        import gmsh
    except (ImportError, OSError):
        return
    if gmsh.isInitialized():
        gmsh.finalize()


def _check_cells(mesh: dolfinx.mesh.Mesh, name: str) -> None:
    """Raise on all ranks where a cell is flat or turned inside out: its Jacobian must keep one sign at all corners."""
    corners = basix.geometry(basix.CellType.hexahedron)
    element = basix.create_element(basix.ElementFamily.P, basix.CellType.hexahedron, 1)
    gradients = element.tabulate(1, corners)[1:, :, :, 0]  # (3, corner, node)
    x = mesh.geometry.x[compat.geometry_nodes(mesh)]
    jacobian = np.linalg.det(np.einsum("kqn,cni->cqik", gradients, x))
    extent = np.ptp(x, axis=1).max(axis=1, initial=0.0) ** 3
    good = np.abs(jacobian.sum(axis=1)) / 8 > 1e-9 * extent
    good &= (jacobian * np.sign(jacobian.sum(axis=1))[:, None] > 1e-12 * extent[:, None]).all(axis=1)
    bad = mesh.comm.allreduce(int((~good).sum()))
    if bad:
        raise InputError(f"mesh {name}: expected cells of positive volume, got {bad} degenerate or folded cells")
