"""The figure of ``tsgdd bench scale``: time, memory, iterations against the number of elements, parts of the time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from tsg_micro.data.figure_style import STYLE, new_figure, plain_log

__all__ = ["plot_scale"]

_COLOURS = ("#222222", "#20639b", "#c8553d", "#3c8d5a", "#8a6bb8")
_PARTS = ("#bbbbbb", "#e3b23c", "#20639b", "#c8553d", "#eeeeee")
_LINES = ("-", "--", ":", "-.")
_SHOWN = (
    ("seconds", "time / s", 1.0),
    ("peak_memory", "memory of a process / GB", 1e9),
    ("iterations", "iterations", 1.0),
)


def plot_scale(rows: Sequence[Mapping[str, Any]], phases: Sequence[str]) -> Figure:
    """A curve for each method and number of ranks of ``rows``, as bench scale writes them.

    The time of the largest size of each is taken apart into ``phases``, numbers of the rows.
    """
    methods = list(dict.fromkeys(row["method"] for row in rows))
    ranks = list(dict.fromkeys(row["ranks"] for row in rows))
    with mpl.rc_context(STYLE):
        figure = new_figure(16, 11)
        *grid, parts = figure.subplots(2, 2).flat
        kinds = list(dict.fromkeys((row["method"], row["ranks"]) for row in rows))
        for axes, (name, label, unit) in zip(grid, _SHOWN, strict=True):
            for method, count in kinds:
                own = [row for row in rows if (row["method"], row["ranks"]) == (method, count)]
                if own[0][name] is None:
                    continue
                axes.loglog(
                    [row["elements"] for row in own],
                    [row[name] / unit for row in own],
                    color=_COLOURS[methods.index(method) % len(_COLOURS)],
                    linestyle=_LINES[ranks.index(count) % len(_LINES)],
                    marker="o",
                    markersize=3,
                    label=f"{method}, {count} rank{'s' * (count > 1)}",
                )
            plain_log(axes.xaxis)
            plain_log(axes.yaxis)
            axes.set_xlabel("elements")
            axes.set_ylabel(label)
        grid[0].legend(fontsize=8)
        last = [[row for row in rows if (row["method"], row["ranks"]) == kind][-1] for kind in kinds]
        begin = np.zeros(len(last))
        for name, colour in zip(phases, _PARTS, strict=True):
            part = np.array([row[name] / row["seconds"] for row in last])
            parts.barh(
                range(len(last)), part, left=begin, color=colour, label=name.removeprefix("seconds_").replace("_", " ")
            )
            begin += part
        parts.set_yticks(range(len(last)), [f"{row['method']}, {row['ranks']}: {row['elements']}" for row in last])
        parts.invert_yaxis()
        parts.set_xlabel("part of the time of the largest")
        figure.legend(*parts.get_legend_handles_labels(), loc="outside lower right", ncols=len(phases), fontsize=8)
    return figure
