"""The one place that knows the differences between DOLFINx 0.9, 0.10 and 0.11, and how it was installed.

The package imports this module before anything of DOLFINx or petsc4py: the wheel ``dolfinx_solver`` has to
come first where it is installed, and it is not there at all on conda-forge, Debian and Ubuntu.
"""

from __future__ import annotations

import contextlib
from typing import Any

with contextlib.suppress(ImportError):
    import dolfinx_solver  # type: ignore[import-not-found]  # noqa: F401

import basix.ufl
import dolfinx
import dolfinx.graph
import numpy as np
import ufl
from dolfinx.io.utils import distribute_entity_data
from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["KernelError", "compile_form", "geometry_nodes", "hexahedral_mesh", "tag_facets"]

VERSION = tuple(int(part) for part in dolfinx.__version__.split(".")[:2])

if np.issubdtype(PETSc.ScalarType, np.complexfloating):
    raise ImportError("dd_macro: expected a PETSc of real numbers, this petsc4py is of complex ones")


class KernelError(RuntimeError):
    """The finite element kernels could not be compiled; most often there is no C compiler."""


def compile_form(form: ufl.Form) -> Any:
    """Compile ``form`` on all ranks.

    Raises:
        KernelError: the compiler is missing or failed (on every rank: DOLFINx tells them all).
    """
    try:
        return dolfinx.fem.form(form)
    except Exception as error:  # the exception's type depends on the build tools that are installed
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise KernelError(
            f"finite element kernels: they need a working C compiler (cc, or the one in CC): {reason}"
        ) from None


def hexahedral_mesh(comm: MPI.Comm, points: np.ndarray, cells: np.ndarray) -> dolfinx.mesh.Mesh:
    """Mesh of the points (n, 3) and cells (m, 8), corners in VTK order, that rank 0 has (the others none)."""
    element = basix.ufl.element("P", "hexahedron", 1, shape=(3,))
    from_vtk = dolfinx.cpp.io.perm_gmsh(dolfinx.mesh.CellType.hexahedron, 8)
    cells = np.ascontiguousarray(cells[:, from_vtk], dtype=np.int64)
    return dolfinx.mesh.create_mesh(comm, cells=cells, e=ufl.Mesh(element), x=points)


def tag_facets(mesh: dolfinx.mesh.Mesh, facets: np.ndarray, values: np.ndarray) -> dolfinx.mesh.MeshTags:
    """Tags of the facets (k, 4) that rank 0 has, their corners as numbered in its points."""
    local, tags = distribute_entity_data(mesh, 2, facets.astype(np.int64), values.astype(np.int32))
    mesh.topology.create_connectivity(2, 3)
    return dolfinx.mesh.meshtags_from_entities(mesh, 2, dolfinx.graph.adjacencylist(local), tags.astype(np.int32))


def geometry_nodes(mesh: dolfinx.mesh.Mesh) -> np.ndarray:
    """Rows of ``mesh.geometry.x`` of the nodes of every cell this rank owns (cells, nodes per cell)."""
    geometry = mesh.geometry
    nodes = geometry.dofmap if VERSION < (0, 11) else geometry.dofmaps[0]
    return nodes[: mesh.topology.index_map(mesh.topology.dim).size_local]
