"""The figure of ``tsgdd study causes``: a pair of points for every change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from tsg_micro.data.figure_style import STYLE, new_figure

__all__ = ["plot_causes"]


def plot_causes(rows: Sequence[Mapping[str, Any]], symbol: str) -> Figure:
    """Error of p or q of both solutions and the normalised distance, outer blocks left out; lines: nothing changed."""
    place = -np.arange(len(rows), dtype=float)
    panels = (
        (
            rf"error of ${symbol}$ / %",
            ("error_mech", "mechanical", "#20639b", "o"),
            ("error_mat", "material", "#c8553d", "s"),
        ),
        (
            "normalised distance, in the metric of the row / %",
            ("distance", "data of the RVE", "#20639b", "o"),
            ("own_distance", "data of the tensegrity itself", "#c8553d", "s"),
        ),
    )
    with mpl.rc_context(STYLE):
        figure = new_figure(14, 1.6 + 0.4 * len(rows))
        for axes, (label, *series) in zip(figure.subplots(1, 2, sharey=True), panels, strict=True):
            for name, title, colour, marker in series:
                values = np.array([np.nan if row[name] is None else 100 * row[name] for row in rows])
                axes.plot(values, place, marker, color=colour, label=title)
                axes.axvline(values[0], color=colour, linewidth=0.8, linestyle=":")
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.xaxis.set_minor_locator(NullLocator())
            axes.xaxis.set_major_formatter("{x:g}")
            axes.set_xlabel(label)
            axes.set_yticks(place, [f"{row['cause']}: {row['change']}" for row in rows], fontsize=11)
            axes.grid(alpha=0.3)
            axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    return figure
