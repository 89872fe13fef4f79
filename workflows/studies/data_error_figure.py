"""The figure of ``tsgdd study data-error``: error against FE2 over the number of RVE states, and fitted slopes."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from tsg_micro.data.figure_style import STYLE, new_figure
from workflows.studies.data_error_fits import ADAPTIVE, mean_errors

__all__ = ["plot_data_error"]

_COLOURS = ("#c8553d", "#20639b", "#3caea3")
_MARKERS = "osD^v"


def plot_data_error(summary: Mapping[str, Any]) -> Figure:
    """Error of p or q of the inner blocks, and of the whole state; dots are draws, lines their geometric means.

    Colours are methods, markers and line styles the data, black is adaptive sampling; slopes are in the legend.
    """
    rows, symbol = summary["rows"], summary["symbol"]
    sources = [name for name in dict.fromkeys(row["source"] for row in rows) if name != ADAPTIVE]
    methods = dict.fromkeys(row["method"] for row in rows)
    colours = dict(zip(methods, cycle(_COLOURS), strict=False))
    with mpl.rc_context(STYLE):
        figure = new_figure(15, 9.2)
        panels = ((symbol, rf"error of ${symbol}$, inner blocks / %"), ("state", "error of the state, all of it / %"))
        for axes, (name, label) in zip(figure.subplots(1, 2), panels, strict=True):
            for fit in summary["fits"]:
                source, method = fit["source"], fit["method"]
                own = [r for r in rows if (r["source"], r["method"]) == (source, method) and r[name] is not None]
                sizes, errors = mean_errors(rows, source, method, name)
                adaptive = source == ADAPTIVE
                place = 0 if adaptive else sources.index(source)
                colour = "k" if adaptive else colours[method]
                style = {
                    "color": colour,
                    "marker": "*" if adaptive else _MARKERS[place % len(_MARKERS)],
                    "markersize": 5,
                }
                style |= {"linestyle": ("-", "--", ":", "-.")[place % 4], "linewidth": 1.2}
                slope = fit[f"slope_{name}"]
                shown = "no slope, at its floor" if slope is None else f"slope {slope:.2f}"
                text = f"{source}: {shown}" if adaptive else f"{source}; {method}: {shown}"
                axes.plot(sizes, 100 * errors, **style, label=text)
                axes.plot(
                    *([row["states"] for row in own], [100 * row[name] for row in own]),
                    color=colour,
                    marker=".",
                    markersize=3,
                    linestyle="",
                    alpha=0.5,
                )
                if slope is not None:
                    ends = sizes[[0, -1]]
                    line = fit[f"at_one_{name}"] * ends**slope
                    axes.plot(ends, 100 * line, color=colour, linewidth=0.6, alpha=0.5)
            axes.axhline(1.0, color="0.5", linewidth=0.8)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_locator(LogLocator(subs=np.arange(2, 10)))
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.xaxis.set_major_formatter("{x:g}")
            axes.set_xlabel("number of RVE states")
            axes.set_ylabel(f"{label.removesuffix(' / %')} against FE2 / %")
            axes.grid(alpha=0.3)
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.11), fontsize=9, frameon=False)
    return figure
