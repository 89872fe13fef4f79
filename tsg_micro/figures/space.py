"""Structures in space: members as shaded tubes (pyvista, off screen), framed, scaled and labelled by Matplotlib.

Tendons are thick; bars are thin, as they are, and seen closely cased in black. The projection is parallel, so one
scale bar holds for all of a picture, and views side by side share their scale and their colours. Where pyvista is not
installed the members are drawn as lines, far ones fading, in the same frame.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from tsg_micro.cells.structure import Structure
from tsg_micro.cells.unit_cell import KINDS
from tsg_micro.data.errors import InputError
from tsg_micro.data.figure_style import MICRO, STYLE, finite, new_figure
from tsg_micro.figures.parts import is_deep, middle_layer, part
from tsg_micro.figures.sheet import (
    BAR_WIDTH,
    cased_lines,
    force_scale,
    frame,
    member_handles,
    member_segments,
    scale_bar,
    triad,
)

__all__ = ["RENDERERS", "View", "camera_of", "choose_renderer", "plot_body", "plot_structure", "plot_views"]

Array = NDArray[np.float64]

RENDERERS = ("pyvista", "matplotlib")
_COLOURS = ("#0072b2", "#e69f00", "#45454f")  # by kind; told apart with any colour vision
_WIDTHS = np.array([1.0, 1.0, BAR_WIDTH])
_RADIUS = 0.018
"""Of a tendon in the picture, over the cell height; it is 0.05 with the usual tendons, which would hide the bars."""
_DOTS_PER_INCH = 200
_WIDE = 1.8
"""Width over height of views that stand below each other."""
_CLOSE = 2000
"""Up to so many members a tube is smooth, its joints are round, and bars are cased."""


@dataclass(frozen=True)
class View:
    """One panel: a state of the structure."""

    title: str = ""
    displacement: Array | None = None
    """Of the nodes (n, 3), m; none for the reference."""
    force: Array | None = None
    """Of the members (m,), N, tension positive, to colour them by; else colours tell the kinds."""


def choose_renderer(wanted: str = "auto") -> str:
    """``wanted``, or the best that works here.

    Without a display VTK before 9.4 would end the process, so it is passed over there.

    Raises:
        InputError: it is unknown, or pyvista cannot be imported.
    """
    if wanted not in ("auto", *RENDERERS):
        raise InputError(f"renderer: expected auto or one of {', '.join(RENDERERS)}, got {wanted!r}")
    if wanted == "matplotlib":
        return wanted
    try:
        import pyvista
    except ImportError as error:  # not installed, or a library of the system that VTK needs is not
        if wanted == "pyvista":
            raise InputError(f"renderer: expected one that is installed, got pyvista ({error})") from None
        return "matplotlib"
    headless = sys.platform.startswith("linux") and not os.environ.get("DISPLAY")
    return "matplotlib" if wanted == "auto" and headless and pyvista.vtk_version_info < (9, 4) else "pyvista"


def plot_structure(
    structure: Structure, displacement: Array | None = None, force: Array | None = None, *, renderer: str = "auto"
) -> Figure:
    """The structure in one view; arguments as in :class:`View` and :func:`plot_views`."""
    return plot_views(structure, [View("", displacement, force)], renderer=renderer)


def plot_body(structure: Structure, views: Sequence[View], *, renderer: str = "auto", width: float = 6.0) -> Figure:
    """As :func:`plot_views`; of a lattice with many cells along all axes the middle layer of cells, from above."""
    if not is_deep(structure):
        return plot_views(structure, views, renderer=renderer, width=width)
    shown = middle_layer(structure)
    layer = [
        View(f"{view.title}\nmiddle layer of cells".strip(), view.displacement, _of_members(structure, view, shown))
        for view in views
    ]
    return plot_views(part(structure, shown), layer, azimuth=-90.0, elevation=90.0, renderer=renderer, width=width)


def _of_members(structure: Structure, view: View, shown: NDArray[np.bool_]) -> Array | None:
    return None if view.force is None else finite("force", view.force, (len(structure.members),))[shown]


def plot_views(
    structure: Structure,
    views: Sequence[View],
    *,
    azimuth: float = -64.0,
    elevation: float = 22.0,
    renderer: str = "auto",
    width: float = 8.0,
) -> Figure:
    """States of one structure beside each other, or below, at one scale; angles of the camera in degrees.

    ``width`` in inches is the larger side of a panel. Colours of force end at the 98th percentile over all views.

    Raises:
        InputError: no view, an array that does not fit or is not finite, forces in some views only, or a renderer
            that is not there.
    """
    if not views or len({view.force is None for view in views}) != 1:
        raise InputError("views: expected at least one, and forces in all of them or in none")
    renderer = choose_renderer(renderer)
    camera = camera_of(azimuth, elevation)
    few = len(structure.members) <= _CLOSE
    ends = [MICRO * member_segments(structure, view.displacement) @ camera for view in views]
    everywhere: Array = np.concatenate(ends).reshape(-1, 3)
    low, high = everywhere.min(axis=0), everywhere.max(axis=0)
    extent = high - low
    scale = width / max(extent[:2].max(), 1e-300)  # inches per µm
    forces = [
        None if view.force is None else 1e9 * finite("force", view.force, (len(structure.members),)) for view in views
    ]
    colours, mappable, extend = _colours(structure, forces)
    size = np.maximum(extent[:2] * scale + (0.5, 1.2), (3.5, 2.2))
    with mpl.rc_context(STYLE):
        below = len(views) > 1 and extent[0] > _WIDE * extent[1]
        rows, columns = (len(views), 1) if below else (1, len(views))
        figure = new_figure(size[0] * columns + (1.2 if mappable else 0.0), size[1] * rows + 0.4)
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, view, segments, colour in zip(panels, views, ends, colours, strict=True):
            if renderer == "pyvista":
                shown = colour if mappable else _faded(segments, colour, low, high)  # of forces the colour is the value
                _tubes(axes, structure, segments, shown, (low, high), scale)
            else:
                _lines(axes, structure, segments, colour, (low, high), scale)
            frame(axes, low, high, 0.02)
            axes.set_axis_off()
            axes.set_title(view.title)
            scale_bar(axes, low, extent)
            triad(axes, camera)
        figure.legend(
            handles=_handles(mappable is not None, few and renderer == "pyvista"),
            loc="outside upper center",
            ncols=3,
            frameon=False,
        )
        if mappable:
            figure.colorbar(
                mappable, ax=list(panels), label="member force / nN", extend=extend, shrink=0.8, pad=0.02, aspect=30
            )
    return figure


def camera_of(azimuth: float, elevation: float) -> Array:
    """Columns right, up and towards the eye (3, 3) for angles in degrees."""
    a, e = np.radians(azimuth), np.radians(elevation)
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return np.column_stack([right, np.cross(towards, right), towards])


def _colours(structure: Structure, forces: list[Array | None]) -> tuple[list[Array], ScalarMappable | None, str]:
    """Colours (m, 3) of each view's members, their scale if they show forces, and where it is exceeded."""
    given = [force for force in forces if force is not None]
    if not given:
        return [np.array([to_rgb(c) for c in _COLOURS])[structure.kind]] * len(forces), None, "neither"
    mappable, extend = force_scale(*given, room=1e-3)
    return [mappable.to_rgba(force)[:, :3] for force in given], mappable, extend


def _handles(by_force: bool, cased: bool) -> list[Line2D]:
    """What thick and thin, or the colours, stand for."""
    if not by_force:
        return [Line2D([], [], color=_COLOURS[k], linewidth=4 * _WIDTHS[k], label=KINDS[k]) for k in (0, 1, 2)]
    return member_handles(cased=cased)


def _faded(segments: Array, colour: Array, low: Array, high: Array) -> Array:
    """Colours (m, 3) of the members, the far ones nearer to that of the paper."""
    far = (high[2] - segments[..., 2].mean(axis=1)) / max(high[2] - low[2], 1e-300)
    # One cell needs no haze; of a dense body only the near half is seen.
    haze = min(1.0, len(colour) / 400) * min(1.0 + len(colour) / 40000, 2.0)
    fade = 0.7 * np.clip(haze * far, 0.0, 1.25)[:, None]
    return np.asarray(colour * (1 - fade) + 0.97 * fade)


def _lines(
    axes: Axes, structure: Structure, segments: Array, colour: Array, bounds: tuple[Array, Array], scale: float
) -> None:
    """Members as lines, the far ones first and faded."""
    order = np.argsort(segments[..., 2].mean(axis=1))
    segments, kind, colour = segments[order], structure.kind[order], colour[order]
    points = 72 * scale * float(np.median(np.linalg.norm(np.diff(segments[..., :2], axis=1), axis=2)))
    width = np.clip(0.075 * points, 0.6, 6.0) * _WIDTHS[kind]
    cased_lines(axes, segments[..., :2], _faded(segments, colour, *bounds), width, np.ones_like(colour))


def _tubes(
    axes: Axes, structure: Structure, segments: Array, colour: Array, bounds: tuple[Array, Array], scale: float
) -> None:
    """Members as tubes, rendered off screen in camera coordinates and put into the axes where they belong."""
    import pyvista as pv
    from vtkmodules.vtkCommonCore import vtkLogger

    low, high = bounds
    room = 0.02 * (high - low)[:2].max()
    centre, half = 0.5 * (low + high), 0.5 * (high - low) + room
    pixels = np.maximum(np.ceil(2 * half[:2] * scale * _DOTS_PER_INCH), 64).astype(int)
    radius, thinnest = _RADIUS * _cell_height(structure), 0.6 / (scale * _DOTS_PER_INCH)  # or nothing would be seen
    few = len(structure.members) <= _CLOSE
    sides = 20 if few else 7
    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)  # without a display it says so, and goes on
    plotter: Any = pv.Plotter(off_screen=True, window_size=[int(n) for n in pixels], lighting="light kit")
    try:
        plotter.set_background("white")
        for bars in (False, True):
            chosen = structure.bars == bars
            if not chosen.any():
                continue
            r = max(radius * (BAR_WIDTH if bars else 1.0), thinnest)
            mesh = _polydata(pv, segments[chosen], colour[chosen])
            for part in (mesh.tube(radius=r, n_sides=sides), *([_balls(mesh, r)] if few else [])):
                plotter.add_mesh(part, scalars="colour", rgb=True, smooth_shading=few, ambient=0.3, specular=0.15)
            if bars and few:  # the far side of a wider black tube: what remains to be seen of it is an outline
                shell = mesh.tube(radius=1.3 * r, n_sides=sides)
                plotter.add_mesh(shell, color="black", lighting=False, culling="front")
        plotter.enable_parallel_projection()
        plotter.camera.focal_point = centre
        plotter.camera.position = centre + np.array([0.0, 0.0, 4.0 * np.linalg.norm(half)])
        plotter.camera.up = (0.0, 1.0, 0.0)
        plotter.camera.parallel_scale = half[0] * pixels[1] / pixels[0]
        plotter.renderer.ResetCameraClippingRange()
        plotter.enable_anti_aliasing("ssaa")
        image = plotter.screenshot(return_img=True)
    finally:
        plotter.close()
        vtkLogger.SetStderrVerbosity(vtkLogger.ConvertToVerbosity(verbosity))
    up = half[0] * pixels[1] / pixels[0]
    extent = (centre[0] - half[0], centre[0] + half[0], centre[1] - up, centre[1] + up)
    axes.imshow(image, extent=extent, interpolation="antialiased")


def _polydata(pv: Any, segments: Array, colour: Array) -> Any:
    """Lines (m, 2, 3) as a mesh, each with its colour (m, 3) in bytes."""
    m = len(segments)
    lines = np.column_stack([np.full(m, 2), np.arange(2 * m).reshape(m, 2)]).ravel()
    mesh = pv.PolyData(segments.reshape(-1, 3), lines=lines)
    mesh.cell_data["colour"] = np.round(255 * colour).astype(np.uint8)
    return mesh


def _balls(mesh: Any, radius: float) -> Any:
    """A ball at each end of the lines, which rounds the joints."""
    import pyvista as pv

    ball = pv.Sphere(radius=radius, theta_resolution=20, phi_resolution=20)
    balls = pv.PolyData(np.array(mesh.points)).glyph(geom=ball, scale=False, orient=False)
    balls.cell_data["colour"] = np.repeat(mesh.cell_data["colour"], 2 * ball.n_cells, axis=0)
    return balls


def _cell_height(structure: Structure) -> float:
    """What member radii are measured by, µm: the cell's height, or of other structures 1.4 median member lengths."""
    if len(structure.cells):
        return MICRO * structure.height
    return 1.4 * MICRO * float(np.median(np.linalg.norm(np.diff(member_segments(structure, None), axis=1), axis=2)))
