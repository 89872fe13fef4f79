"""Bodies that are a box of nx x ny x nz hexahedra whose nodes are moved, as gmsh files; gmsh itself is not needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.msh import write_msh
from tsg_micro.data.errors import InputError
from tsg_micro.data.voxels import voxel_body

__all__ = ["Elements", "Masks", "RegionOf", "Size", "check_box", "write_mapped"]

Array = NDArray[np.float64]
Masks = Mapping[str, NDArray[np.bool_]]
Size = tuple[float, float, float]
Elements = tuple[int, int, int]
RegionOf = Callable[[Array], ArrayLike]
"""Names (m,) of the regions of cells whose centres in the box are (m, 3) m, before its nodes are moved."""


def write_mapped(
    path: str | Path,
    elements: Elements,
    size: Size,
    move: Callable[[Array], Array],
    *,
    region: RegionOf | None = None,
    sides: Callable[[Masks, Array], Masks] | None = None,
) -> None:
    """Write the box [0, Lx] x [0, Ly] x [0, Lz] whose nodes (n, 3) are moved; one region ``sheet`` if none is given.

    ``sides`` makes the sides of the body from those of the box, and from the centres (k, 3), before the move, of outer
    faces; they are those of the box if not given.

    Raises:
        InputError: counts or lengths that are not positive, regions that are not one name a cell, or the folder cannot
            be written.
    """
    check_box(elements, size)
    counts = tuple(int(n) for n in elements)
    body = voxel_body(np.stack(np.unravel_index(np.arange(int(np.prod(counts))), counts), axis=1))
    points = body.nodes * (np.array(size) / counts)
    names = np.full(len(body.cells), "sheet") if region is None else np.asarray(region(points[body.cells].mean(axis=1)))
    if names.shape != (len(body.cells),) or names.dtype.kind != "U":
        raise InputError(f"region: expected a name for each of {len(body.cells)} cells, got shape {names.shape}")
    regions = {str(name): names == name for name in np.unique(names)}
    named: Masks = {name: on for name, on in body.sides().items() if name != "surface"}
    if sides is not None:
        named = sides(named, points[body.faces].mean(axis=1))
    write_msh(
        path,
        move(points),
        body.cells,
        body.faces,
        sides=named,
        regions=regions,
    )


def check_box(elements: Elements, size: Size) -> None:
    """Raise InputError where counts or lengths are not positive."""
    if len(elements) != 3 or any(int(n) != n or n < 1 for n in elements):
        raise InputError(f"elements: expected three positive integers, got {elements}")
    if len(size) != 3 or not all(np.isfinite(s) and s > 0 for s in size):
        raise InputError(f"size: expected three positive lengths in m, got {size}")
