"""Sheets of cells seen from above, and what draws members.

Lengths in m, forces in N, stresses in Pa go in; a Matplotlib figure that needs no display comes out.
"""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from tsg_micro.cells.structure import Structure, member_vectors
from tsg_micro.data.errors import InputError
from tsg_micro.data.figure_style import MICRO, STYLE, draw_field, finite, new_figure
from tsg_micro.figures.parts import top_cells

__all__ = [
    "BAR_WIDTH",
    "FORCE",
    "cased_lines",
    "force_scale",
    "frame",
    "member_handles",
    "member_segments",
    "plot_sheet",
    "scale_bar",
    "triad",
]

Array = NDArray[np.float64]

# grey, not white, in the middle: thin members of a small force must not vanish
FORCE = LinearSegmentedColormap.from_list("force", ["#053061", "#2f79b5", "#c0c0c0", "#d6604d", "#67001f"])

BAR_WIDTH = 0.45
"""Of a bar in a picture, over that of a tendon; the real bars, 0.1 µm, are ten times thinner than the tendons."""
_THIN = 30.0
"""Width of a cell in points below which its members are not told apart."""


def plot_sheet(structure: Structure, displacement: Array, force: Array) -> Figure:
    """A deformed lattice seen from above, members coloured by axial force, and a few blocks of a corner enlarged.

    Where the members of the whole are too thin to be told apart, its uppermost cells are coloured by the mean force of
    their tendons instead. The colours end at the 98th percentile of the absolute force.

    Args:
        structure: a lattice.
        displacement: (n, 3), m.
        force: (m,), N, tension positive.

    Raises:
        InputError: an array of another shape, or not finite, or the structure is no lattice.
    """
    if len(structure.cells) == 0:
        raise InputError("structure: expected a lattice of cells, got a structure without")
    force = finite("force", force, (len(structure.members),)) * 1e9
    tendon_force = _tendon_force(structure, force)
    segments = MICRO * member_segments(structure, displacement)
    order = np.argsort(segments[..., 2].mean(axis=1))  # what lies above is drawn last
    segments, force, bars = segments[order, :, :2], force[order], structure.bars[order]

    low, high = segments.reshape(-1, 2).min(axis=0), segments.reshape(-1, 2).max(axis=0)
    block = 2 * MICRO * structure.height
    side = min(2.6 * block, *(0.6 * (high - low)))
    window_high = high + 0.03 * side  # the corner next to its enlargement
    aspect = float(np.clip((high - low)[0] / (high - low)[1], 0.25, 4.0))
    scale, extend = force_scale(force)
    colour = scale.to_rgba(force)[:, :3]
    with mpl.rc_context(STYLE):
        height = float(np.clip(9.5 / aspect, 3.4, 7.0))
        figure = new_figure(height * (aspect + 1.0) + 2.2, height + 0.7)
        grid = figure.subplots(1, 2, width_ratios=[aspect, 1.0])
        windows = [(low, high), (window_high - side, window_high)]
        for axes, (start, end) in zip(grid, windows, strict=True):
            cell = 72 * height * 0.5 * block / (end - start)[1]  # points
            frame(axes, start, end, 0.01 if axes is grid[0] else 0.0)
            axes.set_xlabel(r"$x$ / µm")
            if axes is grid[0] and cell < _THIN:
                _draw_cells(axes, structure, displacement, tendon_force, scale)
                continue
            inside = ((segments.max(axis=1) >= start) & (segments.min(axis=1) <= end)).all(axis=1)
            width = np.clip(0.055 * cell, 0.7, 5.0) * np.where(bars, BAR_WIDTH, 1.0)[inside]
            edge = np.where(bars[inside, None], 0.1, 1.0) * np.ones(3)
            cased_lines(axes, segments[inside], colour[inside], width, edge)
        grid[0].set_ylabel(r"$y$ / µm")
        grid[1].tick_params(labelleft=False)  # the guide lines run there
        grid[0].indicate_inset_zoom(grid[1], edgecolor="black", linewidth=1.2, alpha=0.9)
        grid[1].legend(
            handles=member_handles(cased=True), loc="lower left", bbox_to_anchor=(0, 1), ncols=2, frameon=False
        )
        cax = grid[1].inset_axes((1.04, 0.0, 0.05, 1.0))
        figure.colorbar(scale, cax=cax, label="member force / nN", extend=extend)
    return figure


def member_handles(*, cased: bool) -> list[Line2D]:
    """What thick and thin stand for in a legend; bars are cased in black where they are so in the picture."""
    case = [withStroke(linewidth=4.5, foreground="0.1")] if cased else []
    return [
        Line2D([], [], color="0.55", linewidth=4.0, label="tendon"),
        Line2D([], [], color="0.55", linewidth=4.0 * BAR_WIDTH, label="bar", path_effects=case),
    ]


def _tendon_force(structure: Structure, force: Array) -> Array:
    """Mean force (c,) of the tendons of every cell."""
    tendon = ~structure.bars
    sums, counts = np.zeros((2, len(structure.cells) + 1))  # the last one stands for "no cell"
    for cell in structure.member_cells[tendon].T:
        np.add.at(sums, cell, force[tendon])
        np.add.at(counts, cell, 1.0)
    return np.asarray(sums[:-1] / counts[:-1])


def _draw_cells(
    axes: Axes, structure: Structure, displacement: Array, tendon_force: Array, scale: ScalarMappable
) -> None:
    """The uppermost cells, coloured by the mean force of their tendons, nN."""
    top, outline = top_cells(structure, displacement)
    draw_field(axes, outline, tendon_force[top], scale.get_clim(), FORCE)
    axes.set_title("cells, by the mean force of their tendons")


def force_scale(*forces: Array, room: float = 0.0) -> tuple[ScalarMappable, str]:
    """One scale of colours for member forces (m,) in nN, to the 98th percentile of their size.

    And which of its ends are exceeded, by more than ``room`` of it.
    """
    everything = np.concatenate(forces)
    top = float(np.percentile(np.abs(everything), 98)) or 1.0
    beyond = top * (1.0 + room)
    extend = (("neither", "max"), ("min", "both"))[bool(everything.min() < -beyond)][bool(everything.max() > beyond)]
    return ScalarMappable(Normalize(-top, top), FORCE), extend


def member_segments(structure: Structure, displacement: Array | None) -> Array:
    """Ends (m, 2, 3) of the members, m; a member to a periodic image is drawn as far as that image."""
    start, vector = structure.nodes[structure.members[:, 0]], member_vectors(structure)
    ends = np.stack([start, start + vector], axis=1)
    if displacement is None:
        return ends
    return ends + finite("displacement", displacement, structure.nodes.shape)[structure.members]


def cased_lines(axes: Axes, segments: Array, colour: Array, width: Array, edge: Array) -> None:
    """Members in the order given, each with an edge around it that parts it from what lies behind."""
    if width.max(initial=0.0) >= 1.2:
        inset = 0.04 * (segments[:, 1] - segments[:, 0])  # no edge around what meets at a node
        segments = np.stack([segments + np.stack([inset, -inset], axis=1), segments], axis=1).reshape(-1, 2, 2)
        colour = np.stack([np.broadcast_to(edge, colour.shape), colour], axis=1).reshape(-1, 3)
        width = np.column_stack([1.35 * width + 0.3 * np.minimum(width, 2.3), width]).ravel()
    lines = LineCollection(segments, colors=colour, linewidths=width, capstyle="round", rasterized=True)
    axes.add_collection(lines, autolim=False)


def frame(axes: Axes, low: Array, high: Array, margin: float) -> None:
    """Limits around ``low`` and ``high`` with a ``margin`` relative to the larger extent, at one scale."""
    room = margin * (high - low)[:2].max()
    axes.set_xlim(low[0] - room, high[0] + room)
    axes.set_ylim(low[1] - room, high[1] + room)
    axes.set_aspect("equal")


def scale_bar(axes: Axes, low: Array, extent: Array) -> None:
    """A bar of 1, 2 or 5 times a power of ten µm, below the structure."""
    wanted = 0.25 * max(extent[:2])
    power = 10.0 ** np.floor(np.log10(wanted))
    length = max(k * power for k in (1, 2, 5) if k * power <= wanted)
    y = low[1] - 0.06 * extent[:2].max()
    axes.plot([low[0], low[0] + length], [y, y], color="black", linewidth=3, solid_capstyle="butt")
    axes.annotate(
        f"{length:g} µm", (low[0] + 0.5 * length, y), (0, -5), textcoords="offset points", ha="center", va="top"
    )
    axes.set_ylim(bottom=y - 0.07 * extent[:2].max())


def triad(axes: Axes, camera: Array) -> None:
    """The directions x, y, z in the lower right corner."""
    extent = np.array([np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())])
    width, height = np.minimum(0.12 * extent.max() / extent, 0.5)
    corner = axes.inset_axes((1.0 - width, 0.0, width, height))
    corner.set(xlim=(-0.7, 1.3), ylim=(-0.7, 1.3), aspect="equal")
    corner.set_axis_off()
    for name, (x, y) in zip("xyz", camera[:, :2], strict=True):
        if np.hypot(x, y) < 0.1:  # it points to the eye
            continue
        corner.annotate(
            "", (x, y), (0, 0), arrowprops={"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, "color": "0.2"}
        )
        corner.text(1.3 * x, 1.3 * y, f"${name}$", ha="center", va="center", fontsize=11)
