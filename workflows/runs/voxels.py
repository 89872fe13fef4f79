"""tsgdd mesh voxels: a mesh of voxels from a closed surface, or from a labelled image."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.labels import label_image, nearest_labels, read_labels
from meshes.surface import inside_grid, read_surface
from meshes.voxels import grid_of, largest_body, write_voxels
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from tsg_micro.data.voxels import UNITS
from workflows.scenes.quantities import quantity
from workflows.store.limits import check_memory
from workflows.store.record import drop_summary, write_summary

__all__ = ["voxels"]

_PER_FILE_BYTE = 40.0
"""Bytes in memory for each of a surface's file: numbers of text, and edges of triangles."""
_PER_PLACE = 16.0
"""Bytes for each voxel of the box around a body: its label, and the part that it is of."""
_PER_VOXEL = 1500.0
"""Bytes for each voxel of a body: nodes, faces, and the sort that numbers them."""


@dataclass(frozen=True)
class _Filled:
    """Labels (nx, ny, nz) of voxels from ``origin`` (3,) m on, 0 outside, and the volume of what they stand for, m³."""

    labels: NDArray[Any]
    origin: NDArray[np.float64]
    volume: float


def voxels(
    out: Path,
    *,
    size: str,
    surface: Path | None = None,
    unit: str | None = None,
    labels: Path | None = None,
    spacing: tuple[str, str, str] | None = None,
    plots: bool = True,
) -> dict[str, Any]:
    """Fill a closed surface (STL, PLY, OBJ), or the labels above 0 of a TIFF stack, with cubes of ``size``.

    A cube is there where its centre is inside. Of parts that do not hang together by faces the largest is kept. The
    mesh goes to ``out``, its picture and summary beside it.

    Raises:
        InputError: an argument or a file is not valid, or there are more voxels than memory holds.
    """
    if out.suffix != ".msh":
        raise InputError(f"out: expected a file name that ends in .msh, got {out}")
    if out.is_dir():
        raise InputError(f"out: expected a file, got the folder {out}")
    edge = _length("size", size)
    if (surface is None) == (labels is None):
        raise InputError("surface, labels: expected one of them, --surface FILE.stl or --labels FILE.tif")
    if surface is not None:
        if unit is None or spacing is not None:
            raise InputError("surface: expected --unit of its coordinates (m, mm, um, nm), and no --spacing")
        filled = _of_surface(surface, unit, edge)
    else:
        assert labels is not None
        if spacing is None or unit is not None:
            raise InputError("labels: expected --spacing X Y Z of its pixels, as 0.5um 0.5um 2um, and no --unit")
        x, y, z = (_length("spacing", text) for text in spacing)
        filled = _of_labels(labels, (x, y, z), edge)
    found = int((filled.labels > 0).sum())
    check_memory(f"voxels: {found}", _PER_VOXEL * found)
    body = largest_body(filled.labels)
    output_folder(out.parent)
    drop_summary(out)
    mesh = write_voxels(out, body, edge=edge, origin=filled.origin.tolist(), labelled=labels is not None)
    present, region = np.unique(body.labels, return_inverse=True)
    names = [f"label-{label}" for label in present] if labels is not None else ["body"]
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from tsg_micro.figures.voxels import plot_voxels

        save_figure(plot_voxels(mesh, edge, region.reshape(-1), names), out.with_suffix(".png"))
    count = len(body.places)
    low, high = edge * mesh.nodes.min(axis=0), edge * mesh.nodes.max(axis=0)
    return write_summary(
        out,
        command="mesh voxels",
        parameters={"size": edge, "surface": surface, "unit": unit, "labels": labels, "spacing": spacing},
        figures={
            "voxels": (count, ""),
            "volume": (count * edge**3, "m^3"),
            "volume_ratio": (count * edge**3 / filled.volume, "volume of the body that was given"),
            "surface_area": (len(mesh.faces) * edge**2, "m^2"),
            "extent": ((high - low).tolist(), "m"),
            "parts": (body.parts, ""),
            "dropped_voxels": (body.dropped, ""),
            "sides": (list(mesh.sides()), ""),
            "regions": (dict(zip(names, np.bincount(region.reshape(-1)).tolist(), strict=True)), "voxels"),
        },
    )


def _length(name: str, text: str) -> float:
    """The positive length in m of an option."""
    number: object = text
    with contextlib.suppress(ValueError):
        number = float(text)
    try:
        value = quantity(number, "m", "a length")
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None
    if value <= 0:
        raise InputError(f"{name}: expected a positive length, got {text!r}")
    return value


def _of_surface(path: Path, unit: str, edge: float) -> _Filled:
    """The voxels whose centre is inside the surface, in the middle of its box."""
    if unit not in UNITS:
        raise InputError(f"unit of the surface: expected one of {', '.join(UNITS)}, got {unit!r}")
    if path.is_file():
        check_memory(f"surface {path}: its triangles", _PER_FILE_BYTE * path.stat().st_size)
    skin = read_surface(path, unit=unit)
    low, high = skin.points.min(axis=0), skin.points.max(axis=0)
    count = grid_of((high - low).tolist(), edge)
    check_memory(f"size: {math.prod(count)} voxels in the box of the surface", _PER_PLACE * math.prod(count))
    origin = 0.5 * (low + high - edge * np.array(count))
    corners = skin.points[skin.triangles] - low
    volume = abs(float(np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])))) / 6.0
    return _Filled(inside_grid(skin, count, edge=edge, origin=origin), origin, volume)


def _of_labels(path: Path, spacing: tuple[float, float, float], edge: float) -> _Filled:
    """The nearest label at the centre of every voxel; the image begins at 0."""
    image = label_image(path)
    pixels = np.array(image.shape[::-1])
    check_memory(f"labels {path}: its {' x '.join(map(str, pixels))} pixels", 4.0 * image.size)
    extent = pixels * spacing
    count = grid_of(extent.tolist(), edge)
    check_memory(f"size: {math.prod(count)} voxels in the box of the image", _PER_PLACE * math.prod(count))
    there = read_labels(image)
    volume = float((there > 0).sum() * np.prod(spacing))
    return _Filled(nearest_labels(there, spacing, count, edge=edge), 0.5 * (extent - edge * np.array(count)), volume)
