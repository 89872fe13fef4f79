"""Figures of macroscopic solves. Plain arrays in, a Matplotlib figure out; lengths in m, stresses in Pa."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from dd_macro.methods.reference import NewtonIteration
from dd_macro.results.compare import ErrorMap
from tsg_micro.data.figure_style import (
    FIELD,
    STYLE,
    aspect_ratio,
    colour_bar,
    draw_field,
    label_maps,
    limits,
    new_figure,
    plain_log,
    tidy,
    without_round_off,
)

__all__ = [
    "ROUNDS",
    "plot_boundary",
    "plot_comparison",
    "plot_convergence",
    "plot_newton",
    "plot_rounds",
]

Array = NDArray[np.float64]

_ERROR = "magma"
_MANY = 100
"""Blocks from which on errors are drawn as a histogram."""
_PAIR = ("#20639b", "#c8553d")
ROUNDS = {
    "gap": ("strain from the nearest datum", "s:", "tab:gray"),
    "surprise": ("error of stress at the last RVEs before they were added", "^--", "tab:orange"),
    "change": ("change of the state since the last round", "o-", "tab:blue"),
    "error": ("estimated error of the state", "D-", "tab:green"),
}
"""Of a round: its meaning, relative to the whole, and how it is drawn."""


def plot_convergence(distance: Sequence[float], changed: Sequence[int], omega: Sequence[float]) -> Figure:
    """Normalised distance |y - z| / |z| and changed data by iteration; the phase with over-relaxed queries is shaded.

    Distances that are round-off are drawn as zero.
    """
    percent = 100.0 * without_round_off(distance, 1.0)
    with mpl.rc_context(STYLE):
        figure = new_figure(7.5, 6.0)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
        n = np.arange(1, len(percent) + 1)
        relaxed = np.flatnonzero(np.asarray(omega) > 1)
        for axes, values, style, colour in ((upper, percent, "o-", "#20639b"), (lower, changed, "s-", "#c8553d")):
            if relaxed.size:
                label = rf"over-relaxed, at first $\omega$ = {omega[relaxed[0]]:g}"
                axes.axvspan(0.5, relaxed[-1] + 1.5, color="0.92", label=label)
            axes.plot(n, values, style, color=colour, markersize=4, clip_on=False)
            tidy(axes)
        if percent.min() < 0.5 * percent.max() or percent.max() == 0.0:
            upper.set_ylim(0.0, 1.05 * percent.max() or 1.0)
        upper.set_ylabel("normalised distance / %")
        lower.set_ylabel("points with\na new datum")
        lower.set_xlabel("iteration")
        lower.set_xlim(0.5, len(percent) + 0.5)
        lower.xaxis.get_major_locator().set_params(integer=True, min_n_ticks=1)
        lower.set_ylim(bottom=0)
        if relaxed.size:
            figure.legend(*upper.get_legend_handles_labels(), loc="outside upper center", frameon=False)
    return figure


def plot_comparison(
    outline: Array,
    *,
    material: Array | None,
    mechanical: Array,
    tensegrity: Array,
    inner: NDArray[np.bool_],
    symbol: str,
) -> Figure:
    """Maps of the data-driven material and mechanical solution and of the tensegrity on one colour scale, of the
    relative error of the mechanical solution, and histograms of the errors of both, or of few blocks all of them.

    Args:
        outline: polygons (n, corners, 2) in m.
        material, mechanical, tensegrity: the field (n,) in Pa; material None is that of FE2, which has only one.
        inner: which blocks (n,) count; the histograms leave the others out.
        symbol: of the field, as in the paper: p or q.

    Raises:
        InputError: a field of another length, or not finite.
    """
    size = np.maximum(np.abs(tensegrity), 1e-12 * max(np.abs(tensegrity).max(initial=0.0), 1e-300))
    error = 100 * (mechanical - tensegrity) / size
    solved = "FE2" if material is None else "mechanical"
    errors = {solved: error[inner]}
    panels = {f"tensegrity ${symbol}$": tensegrity}
    if material is None:
        panels = {f"FE2 ${symbol}$": mechanical} | panels
    else:
        both = {f"data-driven, material ${symbol}$": material, f"data-driven, mechanical ${symbol}$": mechanical}
        panels = both | panels
        errors["material"] = (100 * (material - tensegrity) / size)[inner]
    states = {solved: mechanical[inner]} | ({} if material is None else {"material": material[inner]})
    ends = limits(list(panels.values()))
    with mpl.rc_context(STYLE):
        maps = 2 * (0.8 + 4.8 * aspect_ratio(outline))
        heights = (maps / 2, maps / 2, 3.6)[: 2 + (material is not None)]  # of three maps the fourth place is free
        figure = new_figure(13, sum(heights))
        grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
        axes = [figure.add_subplot(grid[i // 2, i % 2]) for i in range(len(panels) + 1)]
        for place, (title, values) in zip(axes, panels.items(), strict=False):
            drawn = draw_field(place, outline, values, ends, FIELD)
            place.set_title(title)
            colour_bar(figure, drawn, place, f"${symbol}$ / Pa")
        top = max(float(np.percentile(np.abs(error), 95)), 1e-12) if error.size else 1.0
        drawn = draw_field(axes[-1], outline, np.abs(error), (0.0, top), _ERROR)
        axes[-1].set_title(f"relative error of {solved} ${symbol}$, its size")
        colour_bar(figure, drawn, axes[-1], "error / %", extend="max")
        label_maps(axes, 2)
        last = figure.add_subplot(grid[1, 1] if material is None else grid[2, :])
        if inner.sum() < _MANY:
            _block_by_block(last, states, tensegrity[inner], errors, symbol)
        else:
            _histogram(last, errors, symbol)
    return figure


def plot_boundary(outline: Array, maps: Mapping[str, ErrorMap]) -> Figure:
    """Share of every block in the squared error, and how the error falls with the rings of blocks that are left out.

    Args:
        outline: polygons (n, corners, 2) in m.
        maps: title -> where the error of that field sits, blocks as in ``outline``.

    Raises:
        InputError: a map of another length.
    """
    with mpl.rc_context(STYLE):
        rows = -(-len(maps) // 2)
        heights = [0.9 + 4.4 * aspect_ratio(outline)] * rows + [4.2]
        figure = new_figure(13, sum(heights))
        grid = figure.add_gridspec(rows + 1, 2, height_ratios=heights)
        axes = [figure.add_subplot(grid[i // 2, i % 2]) for i in range(len(maps))]
        top = max(max(found.share.max() for found in maps.values()), 1e-12)
        left, right = (figure.add_subplot(grid[rows, i]) for i in range(2))
        for i, (place, (title, found)) in enumerate(zip(axes, maps.items(), strict=True)):
            share = np.maximum(100 * found.share, 1e-4 * top)
            drawn = draw_field(place, outline, share, (1e-4 * top, 100 * top), _ERROR)
            drawn.set_norm(LogNorm(1e-4 * top, 100 * top))
            outer, held = 100 * found.rings[0], 100 * found.clamped_rows
            place.set_title(f"{title}\n{outer:.0f} % in the outer ring, {held:.0f} % in the clamped rows", fontsize=12)
            colour_bar(figure, drawn, place, "share of the\nsquared error / %", extend="min")
            style, colour = ("o-", "s--")[i % 2 if len(maps) > 2 else 0], _PAIR[i * 2 // len(maps)]
            for side, values in ((left, found.error), (right, found.rings)):
                side.semilogy(range(len(values)), 100 * values, style, color=colour, markersize=4, label=title)
        label_maps(axes, 2)
        left.set_xlabel("outer rings of blocks left out")
        left.set_ylabel("error of the blocks left / %")
        right.set_xlabel("ring of blocks, from outside")
        right.set_ylabel("share of the squared error / %")
        for place in (left, right):
            place.xaxis.get_major_locator().set_params(integer=True)
            plain_log(place.yaxis)
            tidy(place)
            place.legend(frameon=False)
    return figure


def plot_rounds(data: Sequence[int], rounds: Mapping[str, Sequence[float | None]]) -> Figure:
    """What the rounds of an adaptive solve were off by, under the names in ROUNDS, over the data that they had."""
    with mpl.rc_context(STYLE):
        figure = new_figure(10, 8)
        axes = figure.subplots()
        for name, (label, style, color) in ROUNDS.items():
            pairs = [(n, value) for n, value in zip(data, rounds[name], strict=True) if value]
            if pairs:
                axes.loglog(*zip(*pairs, strict=True), style, color=color, label=label)
        plain_log(axes.xaxis)
        axes.set_xlabel("data")
        axes.set_ylabel("relative to the whole, in the metric")
        tidy(axes)
        figure.legend(loc="outside upper center")
    return figure


def plot_newton(history: Sequence[NewtonIteration]) -> Figure:
    """Residuals of the iterations, a line for each load."""
    loads = list(dict.fromkeys(it.load for it in history))
    with mpl.rc_context(STYLE):
        figure = new_figure(8, 5.5)
        axes = figure.subplots()
        for k, load in enumerate(loads):
            own = [(i, it.residual) for i, it in enumerate(history, start=1) if it.load == load and it.residual > 0.0]
            shade = mpl.colormaps["viridis"](0.85 * (1.0 - (k + 1) / len(loads)))
            axes.semilogy(*zip(*own, strict=True), "o-", color=shade, label=f"{load:.3g} of the load")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("linear solves")
        axes.set_ylabel("out-of-balance force\nover that of the supports")
        tidy(axes)
        if 1 < len(loads) <= 8:
            figure.legend(loc="outside upper center", ncols=4)
    return figure


def _block_by_block(
    axes: Axes, states: Mapping[str, Array], tensegrity: Array, errors: Mapping[str, Array], symbol: str
) -> None:
    """The value of every block against that of the tensegrity."""
    ends = limits([tensegrity, *states.values()])
    axes.axline((ends[0], ends[0]), slope=1.0, color="0.6", linewidth=1.0)
    for (name, values), colour, marker in zip(states.items(), cycle(_PAIR), cycle("os")):
        axes.plot(tensegrity, values, marker, color=colour, alpha=0.7, label=f"{name}: {_spread(errors[name])}")
    axes.set_xlabel(f"${symbol}$ of the tensegrity / Pa, {len(tensegrity)} inner blocks")
    axes.set_ylabel(f"${symbol}$ of the solution / Pa")
    tidy(axes)
    axes.legend(frameon=False, fontsize=11, loc="lower left", bbox_to_anchor=(0.0, 1.0))


def _spread(error: Array) -> str:
    return f"mean error {error.mean():+.1f} %, standard deviation {error.std():.1f} %"


def _histogram(axes: Axes, errors: Mapping[str, Array], symbol: str) -> None:
    """Histograms of relative errors in percent; errors beyond the 99th percentile are in the outermost bins."""
    limit = max(float(np.percentile(np.abs(np.concatenate(list(errors.values()))), 99)), 1e-12)
    bins = np.linspace(-limit, limit, 41)
    for (name, values), colour in zip(errors.items(), cycle(_PAIR), strict=False):
        clipped = np.clip(values, -limit, limit)
        axes.hist(clipped, bins, alpha=0.55, color=colour, label=f"{name}: {_spread(values)}")
    axes.axvline(0.0, color="0.3", linewidth=0.8)
    axes.set_xlabel(f"relative error of ${symbol}$ / %, outer blocks left out;\nthe last bins hold all beyond")
    axes.set_ylabel("blocks")
    tidy(axes)
    axes.set_axisbelow(True)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, fontsize=11)
