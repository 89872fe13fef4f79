"""The figure of ``tsgdd bench scale``: time, memory and iterations against the number of elements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from tsg_micro.data.figure_style import STYLE, new_figure

__all__ = ["plot_scale"]

_COLOURS = ("#222222", "#20639b", "#c8553d")
_LINES = ("-", "--", ":", "-.")
_SHOWN = (
    ("seconds", "time / s", 1.0),
    ("peak_memory", "memory of a process / GB", 1e9),
    ("iterations", "iterations", 1.0),
)


def plot_scale(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """A curve for each method and number of ranks of ``rows``, as bench scale writes them."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    ranks = list(dict.fromkeys(row["ranks"] for row in rows))
    with mpl.rc_context(STYLE):
        figure = new_figure(16, 6.5)
        for axes, (name, label, unit) in zip(figure.subplots(1, len(_SHOWN)), _SHOWN, strict=True):
            for method, count in dict.fromkeys((row["method"], row["ranks"]) for row in rows):
                own = [row for row in rows if (row["method"], row["ranks"]) == (method, count)]
                axes.loglog(
                    [row["elements"] for row in own],
                    [row[name] / unit for row in own],
                    color=_COLOURS[methods.index(method) % len(_COLOURS)],
                    linestyle=_LINES[ranks.index(count) % len(_LINES)],
                    marker="o",
                    markersize=3,
                    label=f"{method}, {count} rank{'s' * (count > 1)}",
                )
            axes.set_xlabel("elements")
            axes.set_ylabel(label)
        figure.axes[0].legend(fontsize=6)
    return figure
