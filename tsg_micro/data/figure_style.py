"""One look for the figures of both scales, and what all of them draw with; nothing but figures imports it.

Lengths in m, stresses in Pa go in; a Matplotlib figure that needs no display comes out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
from numpy.typing import ArrayLike, NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path

__all__ = [
    "FIELD",
    "MICRO",
    "ROUND_OFF",
    "STYLE",
    "aspect_ratio",
    "block_outlines",
    "colour_bar",
    "draw_field",
    "finite",
    "label_maps",
    "limits",
    "new_figure",
    "plain_log",
    "plot_maps",
    "save_figure",
    "shades",
    "tidy",
    "without_round_off",
]

Array = NDArray[np.float64]

STYLE = {"font.size": 13, "axes.titlesize": 14, "axes.linewidth": 0.8, "savefig.dpi": 200}
MICRO = 1e6
FIELD = "viridis"
"""Colours of a field, and of curves that have an order."""
ROUND_OFF = 1e-9
"""What a value is beside those that it is drawn with, or their difference, that is none."""
_FLAT = 0.2
"""Height over width of maps that are drawn below each other."""


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, sizes in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)  # no display, whatever backend is set
    return figure


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write the figure, whole or not at all; the suffix chooses the format.

    Raises:
        InputError: the folder cannot be written.
    """
    with atomic_path(path) as temporary, mpl.rc_context(STYLE):
        figure.savefig(temporary)


def tidy(axes: Axes) -> None:
    """The look that curves share."""
    axes.grid(color="0.92", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)


def shades(count: int) -> list[tuple[float, float, float, float]]:
    """Colours from dark to light for curves that have an order."""
    return [tuple(colour) for colour in mpl.colormaps[FIELD](np.linspace(0.0, 0.85, count))]


def finite(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """``values`` as an array; InputError where it has another shape or NaN."""
    array = np.asarray(values, dtype=float)
    if array.shape != shape or array.size == 0 or not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite numbers of shape {shape}, got shape {array.shape} or NaN")
    return array


def limits(fields: Sequence[Array]) -> tuple[float, float]:
    """Common limits of the fields; one that is constant but for round-off gets some room."""
    low, high = min(map(np.min, fields)), max(map(np.max, fields))
    if high - low <= ROUND_OFF * max(abs(low), abs(high)):
        low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    return float(low), float(high)


def without_round_off(values: ArrayLike, size: float) -> Array:
    """``values``, zero where they are round-off beside ``size``."""
    array = np.asarray(values, dtype=float)
    return np.where(np.abs(array) <= ROUND_OFF * size, 0.0, array)


def plain_log(axis: Axis) -> None:
    """A logarithmic axis whose ticks are plain numbers, 1, 2 and 5 times a power of ten."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_locator(NullLocator())


def aspect_ratio(outline: Array) -> float:
    """Height over width of a map of polygons (n, corners, 2), within reason."""
    extent = np.ptp(outline.reshape(-1, 2), axis=0)
    return float(np.clip(extent[1] / extent[0], 0.25, 1.5))


def block_outlines(midpoint: Array, displacement: Array | None = None, single: float = 20e-6) -> Array:
    """Quadrilaterals (b, 4, 2) in m of the blocks of one layer, from their midpoints (b, 3) and displacements.

    A block that is alone has the edge ``single``, m.

    Raises:
        InputError: the midpoints are not those of a full regular grid.
    """
    extent = np.ptp(midpoint[:, :2], axis=0)
    places = [np.unique(np.round(midpoint[:, i] / (extent.max() or 1.0), 6), return_inverse=True) for i in (0, 1)]
    shape = tuple(len(values) for values, _ in places)
    flat = places[0][1] * shape[1] + places[1][1]
    steps = [np.diff(values) for values, _ in places]
    if len(np.unique(flat)) != np.prod(shape) or any(len(d) and np.ptp(d) > 0.01 * d.mean() for d in steps):
        raise InputError(f"block midpoints: expected a full regular grid, got {len(midpoint)} blocks that are none")
    pitch = [extent[i] / (shape[i] - 1) if shape[i] > 1 else 0.0 for i in (0, 1)]
    half = 0.5 * np.array([p or max(pitch) or single for p in pitch])
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    outline = midpoint[:, None, :2] + (2 * corners - 1) * half
    if displacement is not None:
        at_corners = np.empty((*shape, 2))
        at_corners[places[0][1], places[1][1]] = displacement[:, :2]
        for axis in (0, 1):  # means between the midpoints, straight on at the sides
            u = np.moveaxis(at_corners, axis, 0)
            i = min(1, len(u) - 1)
            first, last = 1.5 * u[0] - 0.5 * u[i], 1.5 * u[-1] - 0.5 * u[-1 - i]
            ends = [first[None], 0.5 * (u[1:] + u[:-1]), last[None]]
            at_corners = np.moveaxis(np.concatenate(ends), 0, axis)
        outline = outline + at_corners[places[0][1][:, None] + corners[:, 0], places[1][1][:, None] + corners[:, 1]]
    return outline


def draw_field(axes: Axes, outline: Array, values: Array, ends: tuple[float, float], cmap: str) -> PolyCollection:
    """One value (n,) a polygon (n, corners, 2), in m, as a map in µm on ``axes``; colours from ``ends`` to ``ends``.

    Raises:
        InputError: values of another length, or not finite.
    """
    values = np.asarray(values, dtype=float)
    if values.shape != (len(outline),) or not np.isfinite(values).all():
        raise InputError(f"field to draw: expected {len(outline)} finite numbers, got shape {values.shape} or NaN")
    drawn = PolyCollection(list(MICRO * outline), array=values, cmap=cmap, edgecolors="face", linewidths=0.2)
    drawn.set_clim(*ends)
    axes.add_collection(drawn)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0)
    return drawn


def colour_bar(figure: Figure, drawn: ScalarMappable, axes: Axes, label: str, extend: str = "neither") -> None:
    """A colour bar exactly as high as its map."""
    figure.colorbar(drawn, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)), label=label, extend=extend)


def label_maps(grid: Sequence[Axes], columns: int) -> None:
    """x and y in µm at the outer sides of maps that stand in ``columns``."""
    for i, axes in enumerate(grid):
        if i >= len(grid) - columns:
            axes.set_xlabel(r"$x$ / µm")
            axes.tick_params(labelbottom=True)
        if i % columns == 0:
            axes.set_ylabel(r"$y$ / µm")


def plot_maps(outline: Array, fields: Mapping[str, tuple[Array, str]], *, columns: int = 2) -> Figure:
    """Fields per polygon; those of one label share a scale.

    Args:
        outline: polygons (n, corners, 2) in m.
        fields: title -> (values (n,), label with the unit); stresses in Pa.
        columns: of panels; long bodies have one.

    Raises:
        InputError: a field of another length, or not finite.
    """
    extent = np.ptp(outline.reshape(-1, 2), axis=0)
    flat = bool(extent[1] < _FLAT * extent[0])
    columns = 1 if flat else columns
    with mpl.rc_context(STYLE):
        rows = -(-len(fields) // columns)
        height = 1.1 + 9.0 * max(extent[1] / extent[0], 0.08) if flat else 0.9 + 4.4 * aspect_ratio(outline)
        figure = new_figure(11.0 if flat else 6.2 * columns, height * rows)
        grid = list(figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel())
        for axes, (title, (values, label)) in zip(grid, fields.items(), strict=False):
            ends = limits([other for other, of in fields.values() if of == label])
            drawn = draw_field(axes, outline, values, ends, FIELD)
            axes.set_title(title)
            if flat:
                figure.colorbar(drawn, ax=axes, label=label, aspect=8, pad=0.01)
            else:
                colour_bar(figure, drawn, axes, label)
        for axes in grid[len(fields) :]:
            axes.set_visible(False)
        label_maps(grid[: len(fields)], columns)
    return figure
