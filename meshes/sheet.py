"""Sheets of structured hexahedra as gmsh files (format 4.1, m), for ``dd_macro.read_msh``.

Named sides as in ``dd_macro.SIDES``: left, right (x), bottom, top (y), back, front (z); and hole, where there is
one. They keep their names when the sheet is tapered or bent. Only a sheet with a whole hole needs gmsh.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.mapped import Elements, Masks, RegionOf, Size, check_box, write_mapped
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path

__all__ = ["box_with_inclusion", "curved_sheet", "flat_sheet", "quarter_with_hole", "sheet_with_hole", "tapered_sheet"]

Array = NDArray[np.float64]


def flat_sheet(path: str | Path, *, elements: Elements, size: Size, region: RegionOf | None = None) -> None:
    """Write the box [0, Lx] x [0, Ly] x [0, Lz] of nx x ny x nz hexahedra; size in m.

    ``region`` names the volume of every cell by its centre, all ``sheet`` if it is not given.

    Raises:
        InputError: counts or lengths that are not positive, not one name a cell, or the folder cannot be written.

    Example:
        >>> meshes.flat_sheet("sheet.msh", elements=(4, 2, 1), size=(8e-5, 4e-5, 2e-5))
        >>> dd.read_msh("sheet.msh", MPI.COMM_WORLD).global_cells
        8
    """
    write_mapped(path, elements, size, lambda x: x, region=region)


def tapered_sheet(
    path: str | Path, *, elements: Elements, size: Size, thickness_ratio: float, region: RegionOf | None = None
) -> None:
    """Write a sheet whose thickness goes linearly from Lz on the left to thickness_ratio * Lz on the right.

    Raises:
        InputError: as :func:`flat_sheet`, or thickness_ratio <= 0.
    """
    write_mapped(path, elements, size, _taper(size, thickness_ratio), region=region)


def curved_sheet(
    path: str | Path,
    *,
    elements: Elements,
    size: Size,
    radius: float,
    thickness_ratio: float = 1.0,
    region: RegionOf | None = None,
) -> None:
    """Write a sheet bent about an axis along y: part of a cylinder whose inner (back) face has the radius, in m.

    It is tapered before that; ``region`` sees centres of cells of the flat sheet.

    Raises:
        InputError: as :func:`tapered_sheet`, or a radius so small that the sheet would close on itself.
    """
    check_box(elements, size)
    if not (np.isfinite(radius) and radius > 0 and size[0] < 2 * np.pi * radius):
        raise InputError(f"radius: expected more than Lx / (2 pi) = {size[0] / (2 * np.pi):.3g} m, got {radius}")
    taper = _taper(size, thickness_ratio)

    def bend(flat: Array) -> Array:
        x = taper(flat)
        angle, r = (x[:, 0] - size[0] / 2) / radius, radius + x[:, 2]
        return np.column_stack([r * np.sin(angle), x[:, 1], r * np.cos(angle)])

    write_mapped(path, elements, size, bend, region=region)


def box_with_inclusion(
    path: str | Path, *, elements: Elements, size: Size, radius: float, centre: Size | None = None
) -> None:
    """Write a box whose cells within the radius, in m, of the centre are the region ``inclusion``, others ``matrix``.

    The centre is that of the box if not given; a cell is where its own centre is.

    Raises:
        InputError: as :func:`flat_sheet`, or an inclusion that holds no cell, or all.

    Example:
        >>> meshes.box_with_inclusion("cube.msh", elements=(4, 4, 4), size=(8e-5, 8e-5, 8e-5), radius=2e-5)
        >>> sorted(dd.read_msh("cube.msh", MPI.COMM_WORLD).regions)
        ['inclusion', 'matrix']
    """
    check_box(elements, size)
    middle = np.array(size) / 2 if centre is None else np.asarray(centre, dtype=float)

    def region(x: Array) -> NDArray[np.str_]:
        inside = np.linalg.norm(x - middle, axis=1) <= radius
        if not inside.any() or inside.all():
            raise InputError(f"radius: expected some of {len(x)} cells inside, got {int(inside.sum())} in {radius} m")
        return np.where(inside, "inclusion", "matrix")

    write_mapped(path, elements, size, lambda x: x, region=region)


def quarter_with_hole(path: str | Path, *, elements: Elements, size: Size, radius: float) -> None:
    """Write the quarter x > 0, y > 0 of a sheet with a round hole of the radius, in m, at the origin.

    ``left`` (x = 0) and ``bottom`` (y = 0) are its planes of symmetry; ``size`` is that of the quarter. ``elements`` =
    (along each half of the arc, from the hole outwards, through the thickness).

    Raises:
        InputError: as :func:`flat_sheet`, or a hole that does not fit.

    Example:
        >>> meshes.quarter_with_hole("hole.msh", elements=(3, 4, 1), size=(1.2e-4, 1.6e-4, 2e-5), radius=4e-5)
        >>> sorted(dd.read_msh("hole.msh", MPI.COMM_WORLD).names)
        ['back', 'bottom', 'front', 'hole', 'left', 'right', 'top']
    """
    check_box(elements, size)
    if not 0 < radius < min(size[:2]):
        raise InputError(f"radius: expected between 0 and the shorter side, {min(size[:2]):.3g} m, got {radius}")
    around, outwards, layers = elements
    width, height, _ = size

    def move(x: Array) -> Array:
        along, out = x[:, 0], x[:, 1]  # 0 .. 2 from the plane x = 0 to y = 0; 0 .. 1 outwards
        angle = 0.25 * np.pi * (2.0 - along)
        inner = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        outer = np.column_stack([width * along.clip(max=1.0), height * (2.0 - along).clip(max=1.0)])
        return np.column_stack([inner + out[:, None] * (outer - inner), x[:, 2]])

    def sides(box: Masks, centre: Array) -> Masks:
        far = box["top"]
        return {
            "left": box["left"],
            "right": far & (centre[:, 0] > 1.0),
            "bottom": box["right"],
            "top": far & (centre[:, 0] < 1.0),
            "back": box["back"],
            "front": box["front"],
            "hole": box["bottom"],
        }

    write_mapped(path, (2 * around, outwards, layers), (2.0, 1.0, size[2]), move, sides=sides)


def sheet_with_hole(path: str | Path, *, elements: Elements, size: Size, radius: float) -> None:
    """Write a sheet with a round hole of the radius, in m, in its middle.

    ``elements`` = (along each quarter of the hole, from the hole outwards, through the thickness).

    Raises:
        InputError: as :func:`flat_sheet`, or a hole that does not fit.
    """
    check_box(elements, size)
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
        _name_and_write(gmsh, path, sides, volumes)


def _name_and_write(gmsh: Any, path: str | Path, sides: dict[str, list[int]], volumes: list[int]) -> None:
    model = gmsh.model
    for name, surfaces in sides.items():
        model.addPhysicalGroup(2, surfaces, name=name)
    model.addPhysicalGroup(3, volumes, name="sheet")
    model.mesh.generate(3)
    with atomic_path(path) as temporary:
        gmsh.write(str(temporary))
        if not temporary.read_bytes().endswith(b"$EndElements\n"):  # gmsh does not tell of a full disk
            raise OSError("gmsh could not write all of it")


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


def _taper(size: Size, thickness_ratio: float) -> Callable[[Array], Array]:
    """How nodes of the flat sheet move; raises InputError where thickness_ratio <= 0."""
    if not (np.isfinite(thickness_ratio) and thickness_ratio > 0):
        raise InputError(f"thickness_ratio: expected a positive number, got {thickness_ratio}")

    def taper(x: Array) -> Array:
        return x * np.column_stack([*np.ones((2, len(x))), 1.0 + (thickness_ratio - 1.0) * x[:, 0] / size[0]])

    return taper
