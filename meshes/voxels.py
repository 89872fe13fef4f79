"""Bodies of voxels from a surface or a labelled image, as gmsh files with named sides and regions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from meshes.msh import write_msh
from tsg_micro.data.errors import InputError
from tsg_micro.data.voxels import VoxelBody, voxel_body

__all__ = ["Voxels", "grid_of", "largest_body", "write_voxels"]

_MOST_REGIONS = 1000
_NEAR = 1e-6
"""Of a voxel: a body that is so little longer than whole voxels has no further one."""


@dataclass(frozen=True)
class Voxels:
    """The largest part of a body that hangs together by faces: places (b, 3) in edges, labels (b,), and the rest."""

    places: NDArray[np.int64]
    labels: NDArray[np.int64]
    parts: int
    dropped: int
    """Voxels of the other parts."""


def grid_of(extent: Sequence[float], edge: float) -> tuple[int, int, int]:
    """Voxels of ``edge`` m along x, y, z that cover ``extent`` m (3,).

    Raises:
        InputError: the edge is not positive or longer than the body, or more voxels than can be numbered.
    """
    if not (np.isfinite(edge) and edge > 0):
        raise InputError(f"size: expected a positive length in m, got {edge}")
    counts = [float(length) / edge for length in extent]
    if not math.prod(max(count, 1.0) for count in counts) < 2**50:
        raise InputError(
            f"size: expected fewer voxels than 2^50, got some of {edge:.3g} m in a box of "
            f"{' x '.join(f'{length:.3g}' for length in extent)} m; look at the size and the unit"
        )
    if max(counts) < 1 - _NEAR:
        raise InputError(f"size: expected at most the extent of the body, {max(extent):.3g} m, got {edge:.3g} m")
    nx, ny, nz = (max(1, math.ceil(count - _NEAR)) for count in counts)
    return nx, ny, nz


def largest_body(labels: NDArray[Any]) -> Voxels:
    """The largest part that is joined by faces of the voxels (nx, ny, nz) whose label is above 0; the first of equals.

    Raises:
        InputError: no voxel.
    """
    part, parts = ndimage.label(labels > 0)
    if not parts:
        raise InputError(
            "size: expected the centre of at least one voxel inside the body, got none; take a smaller one"
        )
    count = np.bincount(part.reshape(-1))[1:]
    largest = int(np.argmax(count))
    inside = np.nonzero(part == largest + 1)
    return Voxels(
        np.stack(inside, axis=1).astype(np.int64),
        labels[inside].astype(np.int64),
        int(parts),
        int(count.sum() - count[largest]),
    )


def write_voxels(
    path: str | Path, voxels: Voxels, *, edge: float, origin: Sequence[float], labelled: bool
) -> VoxelBody:
    """Write the voxels of ``edge`` m from ``origin`` (3,) on, one hexahedron each; coordinates in m.

    Sides are ``surface`` and left, right, bottom, top, back, front; regions are ``label-1`` and so on where they are
    ``labelled``, else ``body``.

    Raises:
        InputError: more than a thousand labels, or the folder cannot be written.
    """
    body = voxel_body(voxels.places)
    regions = {"body": np.ones(len(voxels.places), dtype=bool)}
    if labelled:
        found = np.unique(voxels.labels)
        if len(found) > _MOST_REGIONS:
            raise InputError(f"labels: expected at most {_MOST_REGIONS}, which are tissues, got {len(found)}")
        regions = {f"label-{label}": voxels.labels == label for label in found}
    points = np.asarray(origin, dtype=float) + edge * body.nodes
    write_msh(path, points, body.cells, body.faces, sides=body.sides(), regions=regions)
    return body
