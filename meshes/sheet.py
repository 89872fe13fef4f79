"""Sheets of structured hexahedra as gmsh files (format 4.1, m), for ``dd_macro.read_msh``.

Named sides as in ``dd_macro.SIDES``: left, right (x), bottom, top (y), back, front (z); and hole, where there is
one. They keep their names when the sheet is tapered or bent.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path

__all__ = ["curved_sheet", "flat_sheet", "sheet_with_hole", "tapered_sheet"]

Array = NDArray[np.float64]
Size = tuple[float, float, float]
Elements = tuple[int, int, int]


def flat_sheet(path: str | Path, *, elements: Elements, size: Size) -> None:
    """Write the box [0, Lx] x [0, Ly] x [0, Lz] of nx x ny x nz hexahedra; size in m.

    Raises:
        InputError: counts or lengths that are not positive, gmsh missing, or the folder cannot be written.
    """
    _write_mapped(path, elements, size, lambda x: x)


def tapered_sheet(path: str | Path, *, elements: Elements, size: Size, thickness_ratio: float) -> None:
    """Write a sheet whose thickness goes linearly from Lz on the left to thickness_ratio * Lz on the right.

    Raises:
        InputError: as :func:`flat_sheet`, or thickness_ratio <= 0.
    """
    if not (np.isfinite(thickness_ratio) and thickness_ratio > 0):
        raise InputError(f"thickness_ratio: expected a positive number, got {thickness_ratio}")

    def taper(x: Array) -> Array:
        y = x.copy()
        y[:, 2] *= 1.0 + (thickness_ratio - 1.0) * x[:, 0] / size[0]
        return y

    _write_mapped(path, elements, size, taper)


def curved_sheet(path: str | Path, *, elements: Elements, size: Size, radius: float) -> None:
    """Write a sheet bent about an axis along y: part of a cylinder whose inner (back) face has the radius, in m.

    Raises:
        InputError: as :func:`flat_sheet`, or a radius so small that the sheet would close on itself.
    """
    if not (np.isfinite(radius) and radius > 0 and size[0] < 2 * np.pi * radius):
        raise InputError(f"radius: expected more than Lx / (2 pi) = {size[0] / (2 * np.pi):.3g} m, got {radius}")

    def bend(x: Array) -> Array:
        angle, r = (x[:, 0] - size[0] / 2) / radius, radius + x[:, 2]
        return np.column_stack([r * np.sin(angle), x[:, 1], r * np.cos(angle)])

    _write_mapped(path, elements, size, bend)


def sheet_with_hole(path: str | Path, *, elements: Elements, size: Size, radius: float) -> None:
    """Write a sheet with a round hole of the radius, in m, in its middle.

    ``elements`` = (along each quarter of the hole, from the hole outwards, through the thickness).

    Raises:
        InputError: as :func:`flat_sheet`, or a hole that does not fit.
    """
    _check(elements, size)
    if not 0 < radius < 0.5 * min(size[:2]):
        raise InputError(
            f"radius: expected between 0 and half the shorter side, {0.5 * min(size[:2]):.3g} m, got {radius}"
        )
    around, outwards, layers = elements
    with _gmsh() as gmsh:
        geo = gmsh.model.geo
        middle = np.array(size[:2]) / 2
        centre = geo.addPoint(*middle, 0)
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        outer = [geo.addPoint(*(middle + c * middle), 0) for c in corners]
        inner = [geo.addPoint(*(middle + c * radius / np.sqrt(2)), 0) for c in corners]
        edges = [geo.addLine(outer[i], outer[(i + 1) % 4]) for i in range(4)]
        arcs = [geo.addCircleArc(inner[i], centre, inner[(i + 1) % 4]) for i in range(4)]
        spokes = [geo.addLine(inner[i], outer[i]) for i in range(4)]
        back = []
        for i in range(4):
            loop = geo.addCurveLoop([spokes[i], edges[i], -spokes[(i + 1) % 4], -arcs[i]])
            back.append(geo.addPlaneSurface([loop]))
            geo.mesh.setTransfiniteCurve(edges[i], around + 1)
            geo.mesh.setTransfiniteCurve(arcs[i], around + 1)
            geo.mesh.setTransfiniteCurve(spokes[i], outwards + 1)
            geo.mesh.setTransfiniteSurface(back[i])
            geo.mesh.setRecombine(2, back[i])
        sides: dict[str, list[int]] = {"back": back, "front": [], "hole": []}
        volumes = []
        for name, surface in zip(("bottom", "right", "top", "left"), back, strict=True):
            # top, volume, then the lateral faces in the order of the loop: spoke, edge, spoke, arc
            made = geo.extrude([(2, surface)], 0, 0, size[2], numElements=[layers], recombine=True)
            sides["front"].append(made[0][1])
            volumes.append(made[1][1])
            sides[name] = [made[3][1]]
            sides["hole"].append(made[5][1])
        geo.synchronize()
        _name_and_write(gmsh, path, sides, volumes, lambda x: x)


def _write_mapped(path: str | Path, elements: Elements, size: Size, move: Callable[[Array], Array]) -> None:
    """A structured box whose nodes (n, 3) are then moved."""
    _check(elements, size)
    with _gmsh() as gmsh:
        geo = gmsh.model.geo
        corners = [geo.addPoint(x, y, 0) for x, y in ((0, 0), (size[0], 0), size[:2], (0, size[1]))]
        lines = [geo.addLine(corners[i], corners[(i + 1) % 4]) for i in range(4)]
        back = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        for i, line in enumerate(lines):
            geo.mesh.setTransfiniteCurve(line, elements[i % 2] + 1)
        geo.mesh.setTransfiniteSurface(back)
        geo.mesh.setRecombine(2, back)
        made = geo.extrude([(2, back)], 0, 0, size[2], numElements=[elements[2]], recombine=True)
        geo.synchronize()
        tags = [tag for _, tag in made]
        sides = dict(
            zip(("front", "bottom", "right", "top", "left"), ([tags[i]] for i in (0, 2, 3, 4, 5)), strict=True)
        )
        _name_and_write(gmsh, path, {"back": [back], **sides}, [tags[1]], move)


def _name_and_write(
    gmsh: Any, path: str | Path, sides: dict[str, list[int]], volumes: list[int], move: Callable[[Array], Array]
) -> None:
    model = gmsh.model
    for name, surfaces in sides.items():
        model.addPhysicalGroup(2, surfaces, name=name)
    model.addPhysicalGroup(3, volumes, name="sheet")
    model.mesh.generate(3)
    tags, x, _ = model.mesh.getNodes()
    before = x.reshape(-1, 3)
    after = move(before)
    if not np.array_equal(before, after):
        for tag, point in zip(tags, after, strict=True):
            model.mesh.setNode(tag, point, [])
    with atomic_path(path) as temporary:
        gmsh.write(str(temporary))
        if not temporary.read_bytes().endswith(b"$EndElements\n"):  # gmsh does not tell of a full disk
            raise OSError("gmsh could not write all of it")


def _check(elements: Elements, size: Size) -> None:
    if len(elements) != 3 or any(int(n) != n or n < 1 for n in elements):
        raise InputError(f"elements: expected three positive integers, got {elements}")
    if len(size) != 3 or not all(np.isfinite(s) and s > 0 for s in size):
        raise InputError(f"size: expected three positive lengths in m, got {size}")


@contextlib.contextmanager
def _gmsh() -> Iterator[Any]:
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise InputError(f"sheet: building a mesh needs the Python package gmsh ({error})") from None
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Geometry.Tolerance", 1e-14)  # cells are some 1e-5 m
        gmsh.option.setNumber("Mesh.ToleranceInitialDelaunay", 1e-18)
        yield gmsh
    finally:
        gmsh.finalize()
