"""The one place that knows the differences between DOLFINx 0.9, 0.10 and 0.11, and how it was installed.

The package imports this module before anything of DOLFINx or petsc4py: the wheel ``dolfinx_solver`` has to
come first where it is installed, and it is not there at all on conda-forge, Debian and Ubuntu.
"""

from __future__ import annotations

import contextlib
from typing import Any

with contextlib.suppress(ImportError):
    import dolfinx_solver  # type: ignore[import-not-found]  # noqa: F401

import dolfinx
import numpy as np
import ufl
from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["KernelError", "compile_form", "geometry_nodes", "gmsh_to_mesh"]

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


def gmsh_to_mesh(model: Any, comm: MPI.Comm) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags | None]:
    """Mesh and facet tags of the gmsh ``model`` of rank 0 (None on the others), distributed over ``comm``."""
    if VERSION < (0, 10):
        from dolfinx.io import gmshio

        mesh, _, tags = gmshio.model_to_mesh(model, comm, 0, gdim=3)
        return mesh, tags
    from dolfinx.io import gmsh

    data = gmsh.model_to_mesh(model, comm, 0, gdim=3)
    return data.mesh, data.facet_tags


def geometry_nodes(mesh: dolfinx.mesh.Mesh) -> np.ndarray:
    """Rows of ``mesh.geometry.x`` of the nodes of every cell this rank owns (cells, nodes per cell)."""
    geometry = mesh.geometry
    nodes = geometry.dofmap if VERSION < (0, 11) else geometry.dofmaps[0]
    return nodes[: mesh.topology.index_map(mesh.topology.dim).size_local]
