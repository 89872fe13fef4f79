"""Figure of the study of trust: estimated against true error. Plain rows in, a Matplotlib figure out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from tsg_micro.data.figure_style import STYLE, new_figure, tidy

__all__ = ["plot_trust"]

_STYLES = {"order 1": ("o", "#c8553d"), "order 2": ("s", "#20639b"), "adaptive": ("^", "#3caea3")}
_LEAST = 1e-6


def plot_trust(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Estimate over true error of every scene that was solved, in percent, with a band of a factor of 2.

    Open marks are bulk tissue, full ones sheets.
    """
    solved = [row for row in rows if row["true"] is not None and row["estimate"] is not None]
    with mpl.rc_context(STYLE):
        figure = new_figure(9.0, 8.0)
        axes = figure.subplots()
        for method, (marker, colour) in _STYLES.items():
            for kind, face in (("sheet", colour), ("bulk", "none")):
                here = [row for row in solved if (row["method"], row["kind"]) == (method, kind)]
                true, estimate = (100 * np.array([max(row[name], _LEAST) for row in here]) for name in _AXES)
                style = {"marker": marker, "markersize": 4, "markerfacecolor": face, "color": colour}
                axes.plot(true, estimate, linestyle="none", label=f"{method}, {kind}", **style)
        least, most = axes.get_xlim()
        line = np.array([max(min(least, 0.1), 100 * _LEAST), max(most, 100.0)])
        axes.fill_between(line, 0.5 * line, 2.0 * line, color="0.92", zorder=0, label="within a factor of 2")
        axes.plot(line, line, color="0.6", linewidth=0.8, zorder=1)
        axes.set(xscale="log", yscale="log", xlim=line, xlabel="true error / %", ylabel="estimated error / %")
        axes.legend(frameon=False, fontsize=7, loc="upper left")
        tidy(axes)
    return figure


_AXES = ("true", "estimate")
