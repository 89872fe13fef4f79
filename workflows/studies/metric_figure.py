"""The figure of ``tsgdd study metric``: error against the stiffness of the metric."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from tsg_micro.data.figure_style import STYLE, new_figure

__all__ = ["plot_metric"]

_COLOURS = (("#c8553d", "#ed9b40"), ("#20639b", "#3caea3"), ("#7a5195", "#d62f8a"))
"""Of all data and of fewer, method by method."""


def plot_metric(summary: Mapping[str, Any]) -> Figure:
    """Error of p or q of the mechanical and of the material solution; crosses: solves that did not converge."""
    rows, symbol = summary["rows"], summary["symbol"]
    with mpl.rc_context(STYLE):
        figure = new_figure(13, 5.8)
        grid = figure.subplots(1, 2, sharey=True)
        for axes, error, title in zip(grid, ("error_mech", "error_mat"), ("mechanical", "material"), strict=True):
            axes.set_yscale("log")
            axes.set_xscale("log")
            axes.axvspan(0.3, 3, color="0.93", zorder=0)
            sizes = sorted({row["data"] for row in rows}, reverse=True)
            names = dict.fromkeys(row["method"] for row in rows)
            colours = dict(zip(names, cycle(_COLOURS), strict=False))
            for name, size in dict.fromkeys((row["method"], row["data"]) for row in rows):
                own = [row for row in rows if (row["method"], row["data"]) == (name, size)]
                factor = [row["factor"] for row in own]
                value = np.array([np.nan if row[error] is None else 100 * row[error] for row in own])
                colour = colours[name][min(sizes.index(size), 1)]
                style = "o-" if size == sizes[0] else "s--"
                axes.plot(factor, value, style, color=colour, markersize=5, label=f"{name}, {size} data")
                bad = [f for f, v in zip(factor, value, strict=True) if np.isnan(v)]
                axes.plot(bad, [0.97] * len(bad), "x", color=colour, transform=axes.get_xaxis_transform())
            axes.set_title(f"{title} solution")
            axes.set_xlabel("metric $C$ / default metric")
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_minor_locator(NullLocator())
                axis.set_major_formatter("{x:g}")
            axes.grid(alpha=0.3)
            axes.tick_params(labelleft=True)
        grid[0].set_ylabel(rf"error of ${symbol}$ against the {summary['reference']} / %", fontsize=12)
        if summary["not_converged"]:
            grid[0].plot([], [], "x", color="0.3", label="did not converge")
        grid[0].fill_between([], [], color="0.93", label="0.3 to 3 times")
        handles, labels = grid[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=11)
    return figure
