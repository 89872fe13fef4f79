"""Closed surfaces of triangles from STL, PLY and OBJ files, and which points of a grid they hold.

Files are read as data by meshio, each by the reader of its own format. What a file says of its size is held against
its length before that, since meshio takes it at its word.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.voxels import UNITS

__all__ = ["Surface", "inside_grid", "read_surface"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
_FORMATS = ("stl", "ply", "obj")
_HEAD = 65536


@dataclass(frozen=True)
class Surface:
    """Points (n, 3) in m, and triangles (t, 3) of them, which close."""

    points: Array
    triangles: Ints


def read_surface(path: str | Path, *, unit: str = "m") -> Surface:
    """Read a closed surface, whose coordinates are in ``unit``, one of UNITS; polygons are cut into triangles.

    Raises:
        InputError: an unknown unit or format, no such file, damaged, coordinates that are not finite, no triangle, or
            edges where the surface is open.
    """
    path = Path(path)
    if unit not in UNITS:
        raise InputError(f"unit of the surface: expected one of {', '.join(UNITS)}, got {unit!r}")
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _FORMATS:
        raise InputError(f"surface {path}: expected a file .stl, .ply or .obj, got {path.suffix or 'no suffix'}")
    if not path.is_file():
        raise InputError(f"surface {path}: no such file")
    try:
        points, polygons = _read(path, kind)
        return _closed(UNITS[unit] * points, polygons)
    except InputError as error:
        raise InputError(f"surface {path}: {error}") from None


def _read(path: Path, kind: str) -> tuple[Array, list[Ints]]:
    """Points (n, 3) and polygons (k, corners) of the file."""
    import meshio

    try:
        _check_counts(path, kind)
        mesh = getattr(meshio, kind).read(str(path))
        points = np.asarray(mesh.points, dtype=float)
        polygons = [np.asarray(block.data, dtype=np.int64) for block in mesh.cells]
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})") from None
    except Exception as error:  # meshio meets damage with whatever it runs into
        raise InputError(f"damaged ({' '.join(f'{type(error).__name__} {error}'.split())[:160]})") from None
    if points.ndim != 2 or points.shape[1:] != (3,) or any(block.ndim != 2 for block in polygons):
        raise InputError("damaged (expected points of three coordinates, and faces of them)")
    return points, polygons


def _check_counts(path: Path, kind: str) -> None:
    """Raise InputError where the file says that it holds more than it can, or its header has no end."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if kind == "stl" and not head.lstrip().startswith(b"solid"):
        count = int.from_bytes(head[80:84], "little")
        if size != 84 + 50 * count:
            raise InputError(f"damaged (a binary STL of {count} triangles has {84 + 50 * count} bytes, got {size})")
    if kind == "ply":
        if not any(line.strip() == b"end_header" for line in head.split(b"\n")[:-1]):
            raise InputError("damaged (expected a header of PLY that ends in end_header)")
        for name, count_ in re.findall(rb"element\s+(\w+)\s+(\d+)", head):
            if int(count_) > size:
                raise InputError(f"damaged ({count_.decode()[:30]} of {name.decode()}, in {size} bytes)")


def _closed(points: Array, polygons: list[Ints]) -> Surface:
    """Triangles of points that come once each.

    Raises:
        InputError: points that are not there or not finite, no triangle, or open edges.
    """
    fans = [
        np.stack([block[:, [0, i, i + 1]] for i in range(1, block.shape[1] - 1)], axis=1).reshape(-1, 3)
        for block in polygons
        if block.shape[1] >= 3 and len(block)
    ]
    if not fans:
        raise InputError("expected triangles, got none")
    triangles = np.concatenate(fans)
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError(f"damaged (a triangle of point {triangles.max() + 1}, of {len(points)})")
    used = points[np.unique(triangles)]
    if not np.isfinite(used).all() or np.abs(used).max() > 1e15:
        raise InputError("expected finite coordinates, got others")
    points, same = np.unique(np.where(np.isfinite(points), points, 0.0) + 0.0, axis=0, return_inverse=True)
    triangles = same.reshape(-1)[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, count = np.unique(ends @ np.array([len(points), 1]), return_counts=True)
    if not len(triangles) or (count % 2).any():
        raise InputError(
            f"expected a closed surface, got {int((count % 2).sum())} open edges of {len(count)}: fill its holes first"
        )
    return Surface(points, triangles)


def inside_grid(surface: Surface, count: tuple[int, int, int], *, edge: float, origin: Array) -> NDArray[np.bool_]:
    """Which voxels (nx, ny, nz) of ``edge`` m from ``origin`` (3,) on have their centre inside the surface, by VTK.

    Raises:
        InputError: pyvista is not there.
    """
    try:
        import pyvista
    except ImportError as error:
        raise InputError(f"surface: which voxels are inside it is found by pyvista ({error}): tsgdd[plot3d]") from None
    faces = np.column_stack([np.full(len(surface.triangles), 3), surface.triangles])
    skin = pyvista.PolyData((surface.points - origin) / edge, faces.ravel())
    grid = pyvista.ImageData(dimensions=count, origin=(0.5, 0.5, 0.5), spacing=(1.0, 1.0, 1.0))
    mask = skin.voxelize_binary_mask(reference_volume=grid)
    return np.asarray(mask.point_data["mask"], dtype=bool).reshape(count, order="F")
