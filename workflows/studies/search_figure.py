"""The figure of ``tsgdd bench search``: time and memory against the number of data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from tsg_micro.data.figure_style import STYLE, new_figure

__all__ = ["plot_search"]

_TIMES = (
    ("processor_seconds", "whole process (processor time)", "#222222"),
    ("seconds_setup", "metric, tree, matrix (clock)", "#e3b23c"),
    ("seconds_search", "searches (clock)", "#20639b"),
    ("seconds_linear_solves", "linear solves (clock)", "#c8553d"),
)


def plot_search(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Curves over the number of data of ``rows``, as bench search writes them."""
    count = [row["data"] for row in rows]
    with mpl.rc_context(STYLE):
        figure = new_figure(16, 6.5)
        times, memory = figure.subplots(1, 2)
        for name, label, colour in _TIMES:
            times.loglog(count, [row[name] for row in rows], "o-", markersize=3, color=colour, label=label)
        times.set_ylabel("time / s")
        times.legend(fontsize=8)
        memory.loglog(count, [row["peak_memory"] / 1e9 for row in rows], "o-", markersize=3, color="#222222")
        memory.set_ylabel("memory / GB")
        for axes in (times, memory):
            axes.set_xlabel("data")
    return figure
