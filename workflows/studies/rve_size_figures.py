"""Figures of the study of RVE size. Plain arrays in, a Matplotlib figure out; sizes in blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FormatStrFormatter, LogLocator, NullFormatter, ScalarFormatter
from numpy.typing import NDArray

from tsg_micro.data.figure_style import STYLE, new_figure, tidy

__all__ = ["plot_buckling", "plot_energies", "plot_errors"]

Array = NDArray[np.float64]
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#7b3294", "#8c6d31", "#444444")
_MARKERS = ("o", "s", "^", "D", "v", "P")
_FLOOR = 1e-16


def plot_errors(
    sizes: Sequence[int],
    loadings: Sequence[str],
    bar_forces: Sequence[float],
    errors: Mapping[str, Mapping[str, Array]],
) -> Figure:
    """Errors of energy change and stress against RVE size, log-log; duplicated images above, merged ones below.

    Args:
        sizes: n of the n x n x 1 blocks (N,).
        loadings: names (L,).
        bar_forces: (F,), N.
        errors: images -> "energy_change" and "stress" -> relative errors (F, L, N).
    """
    titles = {"energy_change": r"energy change $\Delta W$", "stress": "stress $P$"}
    n = np.asarray(sizes, dtype=float)
    with mpl.rc_context(STYLE):
        figure = new_figure(12.5, 8.2)
        grid = figure.subplots(2, 2, sharex=True, sharey="row", height_ratios=[3.0, 1.6])
        for column, (quantity, title) in enumerate(titles.items()):
            above, below = grid[:, column]
            values = errors["duplicated"][quantity]
            for i, j, style in _curves(bar_forces, loadings):
                above.loglog(n, values[i, j], **style)
                # 1x1 is the reference itself; round-off that is exactly zero is drawn at the floor
                below.loglog(n[1:], np.maximum(errors["merged"][quantity][i, j, 1:], _FLOOR), **style)
            guide = 2.0 * values.max(axis=(0, 1))[0] / n
            above.loglog(n, guide, color="0.3", linewidth=1.2, linestyle=(0, (5, 3)))
            above.annotate("slope $-1$", (n[0], guide[0]), (8, 2), textcoords="offset points", color="0.3", fontsize=12)
            slopes = [np.polyfit(np.log(n), np.log(v), 1)[0] for v in values.reshape(-1, len(n))]
            above.set_title(f"{title}, duplicated: slopes {min(slopes):.2f} to {max(slopes):.2f}".replace("-", "−"))
            digits, power = f"{errors['merged'][quantity].max():.0e}".split("e")
            below.set_title(rf"{title}, merged: at most {digits} $\cdot$ $10^{{{int(power)}}}$")
            below.text(1.0, 1e-13, "reference", rotation=90, ha="center", va="center", backgroundcolor="white")
            below.axhline(1e-8, color="0.3", linewidth=1.2, linestyle=":")
            below.annotate("$10^{-8}$", (n[-1], 1e-8), (0, -13), textcoords="offset points", ha="right", color="0.3")
            below.set_ylim(0.3 * _FLOOR, 1e-7)
            below.set_xlabel("RVE size $n$ ($n$ × $n$ × 1 blocks)")
            _sizes(below, sizes)
        for axes in grid[:, 0]:
            axes.set_ylabel("relative error")
        _legend(figure, loadings, bar_forces)
    return figure


def plot_energies(
    sizes: Sequence[int],
    loadings: Sequence[str],
    bar_forces: Sequence[float],
    energies: Mapping[str, Mapping[str, Array]],
) -> Figure:
    """Energies per reference volume against RVE size, log-log, as in the paper's study of RVE size.

    Args:
        sizes: n of the n x n x 1 blocks (N,).
        loadings: names (L,).
        bar_forces: (F,), N.
        energies: title -> images -> energy (F, L, N), J/m^3.
    """
    with mpl.rc_context(STYLE):
        figure = new_figure(12.5, 6.2)
        panels = figure.subplots(1, len(energies), squeeze=False)[0]
        for axes, (title, values) in zip(panels, energies.items(), strict=True):
            for i, j, style in _curves(bar_forces, loadings):
                axes.loglog(sizes, values["merged"][i, j], **style)
                dashed = style | {"linestyle": "--", "markerfacecolor": "white"}
                axes.loglog(sizes, values["duplicated"][i, j], **dashed)
            axes.set_title(title)
            axes.set_ylabel("energy per reference volume / J m$^{-3}$")
            axes.set_xlabel("RVE size $n$ ($n$ × $n$ × 1 blocks)")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
            axes.yaxis.set_minor_formatter(NullFormatter())
            _sizes(axes, sizes)
        _legend(figure, loadings, bar_forces, images=True)
    return figure


def plot_buckling(result: Mapping[str, Any]) -> Figure:
    """Where the state of one block becomes unstable in larger RVEs, and the stress at the end, by size.

    Args:
        result: "sizes" (N,), "onset" bar force -> fractions (N - 1,) and "stress_norm" bar force -> |P| (N,) in Pa;
            None where there is none.
    """
    sizes = result["sizes"]
    with mpl.rc_context(STYLE):
        figure = new_figure(12, 4.8)
        left, right = figure.subplots(1, 2)
        for marker, colour, (force, onset) in zip(_MARKERS, _COLOURS, result["onset"].items(), strict=False):
            style = {"color": colour, "marker": marker, "label": f"bar force {1e9 * float(force):g} nN"}
            left.plot(sizes[1:], 100.0 * np.array(onset, dtype=float), **style)
            stress = np.array(result["stress_norm"][force], dtype=float)
            right.loglog(sizes, stress, **style)
        left.set_ylim(0.0, 100.0)
        left.set_ylabel("onset of buckling / % of the corner strain")
        left.set_title("a  one block's state, repeated, becomes unstable", loc="left")
        right.set_ylabel("$|P|$ at the corner strain / Pa")
        right.set_title("b  stable state at the corner", loc="left")
        right.yaxis.set_major_formatter(ScalarFormatter())
        right.yaxis.set_minor_formatter(ScalarFormatter())
        for axes in (left, right):
            axes.set_xlabel("RVE size $n$ ($n$ × $n$ × 1 blocks), merged images")
            _sizes(axes, sizes)
        left.legend(frameon=False, loc="lower left")
    return figure


def _curves(bar_forces: Sequence[float], loadings: Sequence[str]) -> list[tuple[int, int, dict[str, Any]]]:
    """Row, column and line style of every curve: a colour a loading, a marker a bar force."""
    return [
        (i, j, {"color": _COLOURS[j % len(_COLOURS)], "marker": _MARKERS[i % len(_MARKERS)], "markersize": 5})
        for i in range(len(bar_forces))
        for j in range(len(loadings))
    ]


def _sizes(axes: Axes, sizes: Sequence[int]) -> None:
    """Every size as a tick, and a light grid."""
    axes.xaxis.set_major_locator(FixedLocator([float(n) for n in sizes]))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_minor_locator(FixedLocator([]))
    tidy(axes)


def _legend(figure: Figure, loadings: Sequence[str], bar_forces: Sequence[float], *, images: bool = False) -> None:
    """What colours, markers and line styles mean, above the panels."""
    handles = [Line2D([], [], color=_COLOURS[j % len(_COLOURS)], label=name) for j, name in enumerate(loadings)]
    handles += [
        Line2D([], [], color="0.3", marker=_MARKERS[i % len(_MARKERS)], linestyle="", label=f"$f_b$ = {1e9 * f:g} nN")
        for i, f in enumerate(bar_forces)
    ]
    if images:
        handles += [
            Line2D([], [], color="0.3", label="merged"),
            Line2D([], [], color="0.3", linestyle="--", label="duplicated"),
        ]
    figure.legend(
        handles=handles,
        loc="outside upper center",
        ncols=len(handles) if len(handles) < 9 else -(-len(handles) // 2),
        frameon=False,
    )
