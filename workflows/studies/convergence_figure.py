"""The figure of ``tsgdd study convergence``: a table of the grid, iterations as colour and how each solve ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from tsg_micro.data.figure_style import STYLE, new_figure

__all__ = ["plot_grid"]

_MARKS = {
    "fixed point": "",
    "distance settled": "~",
    "points held": "h",
    "cycle cut short": "c",
    "not converged": "×",
    "not verified": "!",
}


def plot_grid(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Iterations of every cell, one table a load; a mark says how a solve ended that is not at a fixed point."""
    loads, methods = (list(dict.fromkeys(row[name] for row in rows)) for name in ("load", "method"))
    columns = list(dict.fromkeys((row["metric"], row["data"]) for row in rows))
    sizes = len({size for _, size in columns})
    most = max(max(row["iterations"] for row in rows), 2)
    with mpl.rc_context(STYLE):
        figure = new_figure(5 + 0.55 * len(columns), 1.6 + (1.4 + 0.42 * len(methods)) * len(loads))
        for axes, load in zip(figure.subplots(len(loads), 1, squeeze=False, sharex=True)[:, 0], loads, strict=True):
            table = np.full((len(methods), len(columns)), np.nan)
            for row in (row for row in rows if row["load"] == load):
                i, j = methods.index(row["method"]), columns.index((row["metric"], row["data"]))
                table[i, j] = max(row["iterations"], 1)
                dark = table[i, j] > most**0.55
                axes.text(
                    *(j, i, f"{row['iterations']}{_MARKS[row['state']]}"),
                    ha="center",
                    va="center",
                    fontsize=9,
                    color="black" if dark else "white",
                )
            drawn = axes.imshow(table, norm=LogNorm(1, most), cmap="viridis", aspect="auto")
            axes.set_yticks(range(len(methods)), methods, fontsize=11)
            axes.set_xticks(range(len(columns)), [f"{size}" for _, size in columns], fontsize=9, rotation=90)
            axes.tick_params(labelbottom=True)
            axes.set_ylabel(load, fontsize=14)
            for first in range(0, len(columns), sizes):
                if first:
                    axes.axvline(first - 0.5, color="white", linewidth=4)
                axes.text(first + sizes / 2 - 0.5, -0.62, columns[first][0], ha="center", va="bottom", fontsize=12)
            figure.colorbar(drawn, ax=axes, pad=0.01).set_label("iterations", fontsize=12)
        axes.set_xlabel("number of data, for each metric")
        figure.suptitle(
            "Number: iterations. No mark: a fixed point. h: points held, the state would move by 1 % or less without;\n"
            "c: a cycle cut short, it would move by more. ~: distance settled. ×: not converged. !: not verified.",
            fontsize=11,
        )
    return figure
