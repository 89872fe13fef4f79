"""Meshes of voxels: one hexahedron, or refine^3, for each of equal cubes; sides and regions by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike, NDArray

from dd_macro.parallel import together
from dd_macro.scene.hexahedra import Hexahedra, connected_parts
from dd_macro.scene.mesh import TaggedMesh, distribute
from tsg_micro.data.errors import InputError
from tsg_micro.data.voxels import VoxelBody, check_region, combinations, voxel_body

__all__ = ["voxel_mesh"]

Where = Callable[[NDArray[np.float64]], NDArray[np.bool_]]


def voxel_mesh(
    comm: MPI.Comm,
    blocks: ArrayLike,
    *,
    edge: float,
    sides: Mapping[str, Where] | None = None,
    regions: Mapping[str, ArrayLike] | None = None,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    refine: int = 1,
) -> TaggedMesh:
    """The body of voxels at ``blocks`` (b, 3), whole numbers: that at (i, j, k) begins at origin + edge (i, j, k).

    Its sides are ``surface``, all outer faces, and those of SIDES, the outer faces in the outermost planes of the
    body. A face may be on several sides, an element in several regions. Rank 0 makes the mesh, of its arguments;
    what is wrong with them is raised on all ranks. Collective.

    Args:
        comm: of the mesh.
        blocks: places of the voxels, in edges.
        edge: of a voxel, m.
        sides: further names, and where they are: of centres of outer faces (k, 3) in m the ones on the side (k,).
        regions: names of volumes, and the numbers of their voxels, rows of ``blocks``.
        origin: of the lattice, m.
        refine: elements along each edge of a voxel.

    Raises:
        InputError: as voxel_body; an edge that is not positive, an origin that is not finite; a region without voxels
            or with others; a further side that is called as one that is there, or has no face; voxels that hang
            together at an edge or a corner only.

    Example:
        >>> body = dd.voxel_mesh(MPI.COMM_WORLD, [[0, 0, 0], [1, 0, 0], [0, 1, 0]], edge=20e-6)
        >>> body.global_cells, (1e6 * body.extent("right")[1]).round(3)
        (3, array([40., 20., 20.]))
    """
    if not (np.isfinite(edge) and edge > 0):
        raise InputError(f"edge: expected a positive length in m, got {edge}")
    if len(origin) != 3 or not np.isfinite(origin).all():
        raise InputError(f"origin: expected three finite coordinates in m, got {origin}")

    def make() -> Hexahedra | None:
        if comm.rank > 0:
            return None
        body = voxel_body(blocks, refine=refine)
        points = np.array(origin) + edge / refine * body.nodes
        voxels, per_voxel = len(body.cells) // refine**3, np.arange(refine**3)
        inside = {name: check_region(name, numbers, voxels) for name, numbers in (regions or {}).items()}
        named, tags = _named(_sides(body, points, sides or {}))
        elements = {name: (refine**3 * own[:, None] + per_voxel).reshape(-1) for name, own in inside.items()}
        return Hexahedra(
            points, body.cells, body.faces, tags, named, elements, connected_parts(body.cells, len(points))
        )

    return distribute(comm, together(comm, make))


def _sides(body: VoxelBody, points: NDArray[np.float64], more: Mapping[str, Where]) -> dict[str, NDArray[np.bool_]]:
    """The outer faces (k,) of every side."""
    found, centre = body.sides(), points[body.faces].mean(axis=1)
    for name, where in more.items():
        on = np.asarray(where(centre))
        if name in found:
            raise InputError(f"sides: expected names beside {', '.join(body.sides())}, got {name!r}")
        if on.shape != (len(centre),) or on.dtype != bool or not on.any():
            raise InputError(f"side {name}: expected some of {len(centre)} outer faces, True each, got none")
        found[name] = on
    return found


def _named(sides: Mapping[str, NDArray[np.bool_]]) -> tuple[dict[str, tuple[int, ...]], NDArray[np.int32]]:
    """Tags of every side, its own first, and of every face (k,): its side's own, or one of all sides it is on."""
    sets, which = combinations(sides)
    tag = [one[0] + 1 if len(one) == 1 else len(sides) + 1 + i for i, one in enumerate(sets)]
    named = {
        name: (i + 1, *(t for t, one in zip(tag, sets, strict=True) if i in one and len(one) > 1))
        for i, name in enumerate(sides)
    }
    return named, np.array(tag, dtype=np.int32)[which]
