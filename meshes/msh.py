"""Write hexahedra, their named sides and named volumes as a gmsh file (MSH 4.1, binary); gmsh itself is not needed."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path
from tsg_micro.data.voxels import combinations

__all__ = ["write_msh"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Masks = Mapping[str, NDArray[np.bool_]]

_QUADRANGLE, _HEXAHEDRON = 3, 5


def write_msh(path: str | Path, points: Array, cells: Ints, faces: Ints, *, sides: Masks, regions: Masks) -> None:
    """Write nodes at ``points`` (n, 3), hexahedra ``cells`` (m, 8) and the ``faces`` (k, 4) that are on sides.

    Corners are in the order of gmsh. ``sides`` are names of faces (k,), ``regions`` of cells (m,), True each; a face or
    a cell may be of several. Every cell must be in a region, or gmsh leaves it out.

    Raises:
        InputError: a name that gmsh cannot hold, or the folder cannot be written.
    """
    for name in (*sides, *regions):
        if not name or len(name) > 120 or not name.isprintable() or '"' in name:
            raise InputError(f"name of a side or region: expected up to 120 letters without quotes, got {name[:130]!r}")
    surfaces, volumes = _Entities(2, sides), _Entities(3, regions)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(b"$MeshFormat\n4.1 1 8\n" + struct.pack("=i", 1) + b"\n$EndMeshFormat\n$PhysicalNames\n")
        file.write(f"{len(sides) + len(regions)}\n".encode())
        for entities in (surfaces, volumes):
            file.writelines(
                f'{entities.dimension} {i + 1} "{name}"\n'.encode() for i, name in enumerate(entities.names)
            )
        file.write(b"$EndPhysicalNames\n$Entities\n" + struct.pack("=4Q", 0, 0, len(surfaces.sets), len(volumes.sets)))
        box = points.min(axis=0), points.max(axis=0)
        surfaces.write(file, *box)
        volumes.write(file, *box)
        file.write(b"\n$EndEntities\n$Nodes\n")
        numbers = np.arange(1, len(points) + 1, dtype=np.uint64)
        file.write(struct.pack("=4Q3iQ", 1, len(points), 1, len(points), 3, 1, 0, len(points)))
        file.write(numbers.tobytes() + np.ascontiguousarray(points, dtype=float).tobytes())
        count = len(faces) + len(cells)
        blocks = len(surfaces.sets) + len(volumes.sets)
        file.write(b"\n$EndNodes\n$Elements\n" + struct.pack("=4Q", blocks, count, 1, count))
        surfaces.write_elements(file, _QUADRANGLE, faces, 1)
        volumes.write_elements(file, _HEXAHEDRON, cells, 1 + len(faces))
        file.write(b"\n$EndElements\n")


class _Entities:
    """Entities of gmsh, one for each set of names that elements have, whose physical groups those names are."""

    def __init__(self, dimension: int, named: Masks) -> None:
        self.dimension, self.names = dimension, list(named)
        self.sets, self.which = combinations(named)

    def write(self, file: IO[bytes], low: Array, high: Array) -> None:
        for i, groups in enumerate(self.sets):
            tags = [group + 1 for group in groups]
            file.write(struct.pack(f"=i6dQ{len(tags)}iQ", i + 1, *low, *high, len(tags), *tags, 0))

    def write_elements(self, file: IO[bytes], kind: int, nodes: Ints, first: int) -> None:
        for i in range(len(self.sets)):
            own = np.flatnonzero(self.which == i)
            file.write(struct.pack("=3iQ", self.dimension, i + 1, kind, len(own)))
            file.write(np.column_stack([first + own, nodes[own] + 1]).astype(np.uint64).tobytes())
