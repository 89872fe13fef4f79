"""The figure of ``tsgdd bench frontier``: error against run time, with and without the sampling of the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

from tsg_micro.plot import STYLE, new_figure, save_figure

__all__ = ["plot_frontier", "save_figure"]

_COLOURS = ("#20639b", "#3caea3", "#7a5195", "#c8553d", "#ed9b40", "#8c6d31", "#444444", "#999999")
_MARKERS = "osDv^P*X"


def plot_frontier(rows: Sequence[Mapping[str, Any]], dns_seconds: float, summary: Mapping[str, Any]) -> Figure:
    """Errors of p or q, outer blocks left out; numbers at the points: data; dashed line: the full tensegrity."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    panels = (("time of the solve / s", 0.0), ("time of sampling and solve / s", 1.0))
    with mpl.rc_context(STYLE):
        figure = new_figure(14, 6.8)
        for axes, (label, sampling) in zip(figure.subplots(1, 2, sharey=True), panels, strict=True):
            for method, colour, marker in zip(methods, _COLOURS, _MARKERS, strict=False):
                own = [row for row in rows if row["method"] == method and row["error_mech"] is not None]
                time = [row["seconds_solve"] + sampling * row["seconds_sampling"] for row in own]
                error = [100 * row["error_mech"] for row in own]
                axes.plot(time, error, marker=marker, color=colour, linewidth=1.0, label=method)
                material = [100 * row["error_mat"] for row in own if row["error_mat"] is not None]
                if material:
                    axes.plot(time, material, f"{marker}:", color=colour, linewidth=0.8, fillstyle="none")
                if not sampling:
                    continue
                for row, x, y in zip(own, time, error, strict=True):
                    axes.annotate(
                        f"{row['data']}", (x, y), (3, 4), textcoords="offset points", fontsize=8, color=colour
                    )
            axes.axvline(dns_seconds, color="0.3", linestyle="--", label=f"{summary['reference']}, {dns_seconds:.3g} s")
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.yaxis.set_minor_locator(NullLocator())
            axes.yaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.grid(alpha=0.3)
            axes.set_xlabel(label)
        left = figure.axes[0]
        left.set_ylabel(rf"error of ${summary['symbol']}$ / %")
        left.plot([], [], "k:", fillstyle="none", marker="o", linewidth=0.8, label="the same, material solution")
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4, fontsize=10)
        machine = summary["machine"]
        figure.axes[1].set_title(f"{machine['processor']}, {machine['cores']} cores", fontsize=9, loc="right")
    return figure
