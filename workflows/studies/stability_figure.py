"""Figure of the stability benchmark: where cases converged and in how many iterations, and where not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from tsg_micro.data.figure_style import FIELD, STYLE, new_figure, tidy

__all__ = ["plot_stability"]

Rows = Sequence[Mapping[str, Any]]
_MARKS = {
    "not converged": ("x", "#c8553d"),
    "refused": (".", "0.7"),
    "time limit": ("+", "#20639b"),
    "silent": ("*", "red"),
    "unnamed": ("P", "black"),
}
_COLUMNS = 4


def plot_stability(micro: Rows, macro: Rows) -> Figure:
    """A panel for every scene: bar force and ratio of moduli of micro states, data and metric of macroscopic solves.

    Its title says how many cases converged.
    """
    kinds = (
        (micro, ("bar_force", "E_ratio"), ("bar force / N", "E of bars / E of tendons")),
        (macro, ("data", "metric"), ("number of data", "metric / default metric")),
    )
    panels = [
        (scene, [row for row in rows if row["scene"] == scene], names, labels)
        for rows, names, labels in kinds
        for scene in dict.fromkeys(row["scene"] for row in rows)
    ]
    took = [row["iterations"] for _, rows, *_ in panels for row in rows if row["state"] == "converged"]
    norm = LogNorm(1, max(10, *took, 1))
    with mpl.rc_context(STYLE):
        lines = -(-len(panels) // _COLUMNS)
        figure = new_figure(17.0, 4.6 * lines + 0.8)
        grid = figure.subplots(lines, _COLUMNS, squeeze=False).ravel()
        for axes, (scene, rows, names, labels) in zip(grid, panels, strict=False):
            colours = _panel(axes, rows, names, norm)
            done = sum(row["state"] == "converged" for row in rows)
            axes.set(xscale="log", yscale="log", xlabel=labels[0], ylabel=labels[1])
            axes.set_title(f"{scene}: {done} of {len(rows)}")
            tidy(axes)
        for axes in grid[len(panels) :]:
            axes.set_axis_off()
        figure.colorbar(colours, ax=grid.tolist(), label="iterations", shrink=0.7)
        handles = {
            text: handle for axes in grid for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        if handles:
            figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=len(handles))
    return figure


def _panel(axes: Axes, rows: Rows, names: tuple[str, str], norm: LogNorm) -> PathCollection:
    """The cases of a scene, those that converged coloured by their iterations."""
    for state, (marker, colour) in _MARKS.items():
        here = [row for row in rows if row["state"] == state]
        if here:
            axes.scatter(*_values(here, names), marker=marker, color=colour, s=36, label=state)
    done = [row for row in rows if row["state"] == "converged"]
    took = np.array([max(1, row["iterations"]) for row in done], dtype=float)
    return axes.scatter(*_values(done, names), c=took, norm=norm, cmap=FIELD, s=16)


def _values(rows: Rows, names: tuple[str, str]) -> tuple[list[float], list[float]]:
    return [row[names[0]] for row in rows], [row[names[1]] for row in rows]
