"""The mesh of a scene's body, and its tissues' cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

import dd_macro as dd
from dd_macro.parallel import span, total
from tsg_micro.cells.lattice import box_cells, spheroid_cells
from tsg_micro.data.errors import InputError
from tsg_micro.data.voxels import SIDES
from workflows.scenes.grading import halved_sides_of
from workflows.scenes.model import Body, SceneModel
from workflows.store.limits import check_memory

__all__ = ["MOST_BLOCKS", "PER_ELEMENT", "block_counts", "extent", "make_body", "tissue_of_cells"]

MOST_BLOCKS = 1e5
"""Across a body; one of more, or of less than one, is most often in another unit."""
PER_ELEMENT = 15e3
"""Bytes that an element of degree 1 takes at least: its points, their operator, and its part of the matrix."""


def make_body(comm: MPI.Comm, scene: SceneModel, block: float) -> dd.TaggedMesh:
    """The mesh of the scene's body, whose blocks have the edge ``block`` (m); collective.

    Raises:
        InputError: it is not valid, too large, or smaller than a block.
    """
    body = scene.body
    if body.mesh is not None:
        size = (block, MOST_BLOCKS * block)
        return dd.read_msh(body.mesh, comm, unit=body.unit, size=size, merge_nodes=body.merge_nodes)
    if body.spheroid is not None:
        count = 4.2 * body.spheroid**3
        _check(comm, "spheroid", count * body.refine**3)
        try:
            blocks = np.unique(spheroid_cells(body.spheroid) // 2, axis=0)
        except InputError as error:
            raise InputError(f"body.spheroid: {error}") from None
        return dd.voxel_mesh(comm, blocks, edge=block, refine=body.refine)
    counts = block_counts(body, block)
    halved = halved_sides_of(scene, counts)
    most = [min(2 * n, n + 2 * sum(SIDES.index(s) // 2 == axis for s in halved)) for axis, n in enumerate(counts)]
    _check(comm, "blocks", math.prod(most) * body.refine**3)
    x, y, z = body.box or (*(body.sheet or (block, block)), block)
    if body.blocks is not None or np.allclose((x, y, z), block * np.array(counts), rtol=1e-9, atol=0):
        if not halved:
            return dd.voxel_mesh(comm, box_cells(*counts), edge=block, refine=body.refine)
        x, y, z = (block * n for n in counts)
    domain = dd.box(comm, elements=counts, size=(x, y, z), refine=body.refine, halved=halved)
    first, *others = domain.names.values()
    return replace(domain, names=domain.names | {"surface": first}, shared={"surface": tuple(others)})


def _check(comm: MPI.Comm, name: str, elements: float) -> None:
    dd.parallel.together(comm, lambda: check_memory(f"body.{name}: {elements:.0f} elements", PER_ELEMENT * elements))


def block_counts(body: Body, block: float) -> tuple[int, int, int]:
    """Numbers of blocks of a box or sheet; those nearest to its lengths.

    Raises:
        InputError: a length is too small, or too large.
    """
    if body.blocks is not None:
        return body.blocks
    lengths = body.box or (*(body.sheet or ()), block)
    for length in lengths:
        if not 0.5 * block <= length <= MOST_BLOCKS * block:
            raise InputError(
                f"body: expected lengths between half a block, {0.5 * block:.3g} m, and {MOST_BLOCKS:.0e} blocks, got "
                f"{length:.3g} m"
            )
    x, y, z = (max(1, round(length / block)) for length in lengths)
    return x, y, z


def extent(domain: dd.TaggedMesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and largest coordinates (3,) of the mesh, m; collective."""
    return span(domain.comm, domain.mesh.geometry.x)


def tissue_of_cells(domain: dd.TaggedMesh, scene: SceneModel) -> NDArray[np.int64]:
    """Number of the tissue, in the order of the file, of every owned cell; collective.

    Raises:
        InputError: a region is not in the mesh, two tissues meet in a cell, a cell has none, or a tissue has no cell.
    """
    names = list(scene.tissue)
    found = np.full(domain.owned_cells, -1, dtype=np.int64)
    twice = 0
    for number, name in enumerate(names):
        region = scene.tissue[name].region
        if region is None:
            continue
        try:
            cells = domain.cells_of(region)
        except InputError as error:
            raise InputError(f"tissue.{name}.region: {error}") from None
        twice += int((found[cells] >= 0).sum())
        found[cells] = number
    rest = [number for number, name in enumerate(names) if scene.tissue[name].region is None]
    if len(rest) > 1:
        raise InputError(
            f"tissue: expected a region for all tissues but one, got none of {', '.join(names[k] for k in rest)}"
        )
    found[found < 0] = rest[0] if rest else -1
    counts = total(domain.comm, [twice, (found < 0).sum(), *np.bincount(found[found >= 0], minlength=len(names))])
    if counts[0]:
        raise InputError(f"tissue: expected regions that do not overlap, got {counts[0]:.0f} cells in two")
    if counts[1]:
        raise InputError(
            f"tissue: expected one for every cell, got none for {counts[1]:.0f}; a tissue without region takes the rest"
        )
    _check_used(names, counts[2:])
    return found


def _check_used(names: Sequence[str], counts: NDArray[np.float64]) -> None:
    for name, count in zip(names, counts, strict=True):
        if count == 0:
            raise InputError(f"tissue.{name}: expected some cells of it, got none")
