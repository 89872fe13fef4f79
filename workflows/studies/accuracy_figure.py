"""The figure of ``tsgdd bench accuracy``: the error of every case, and what it is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from tsg_micro.data.figure_style import STYLE, new_figure

__all__ = ["plot_accuracy"]

_PARTS = {
    "error": ("all of it", "0.25"),
    "data": ("data, against FE2", "#20639b"),
    "element": ("elements, against a mesh of half their size", "#3caea3"),
    "rest": ("the rest: blocks as a continuum, and its edges", "#c8553d"),
}
_TITLES = {"inner": "inner blocks", "rows": "clamped rows", "columns": "free columns", "all": "all blocks"}


def plot_accuracy(rows: Sequence[Mapping[str, Any]], model: Mapping[str, Any]) -> Figure:
    """A panel for every zone, a group of bars for every case; parts are no sum, as errors of different sign cancel."""
    zones = [zone for zone in _TITLES if any(row["zone"] == zone for row in rows)]
    cases = list(dict.fromkeys(row["case"] for row in rows))
    shown = {name: part for name, part in _PARTS.items() if any(row[name] is not None for row in rows)}
    y = -np.arange(len(cases), dtype=float)
    with mpl.rc_context(STYLE):
        figure = new_figure(4.6 * len(zones) + 1.5, 1.8 + 0.62 * len(cases))
        for axes, zone in zip(figure.subplots(1, len(zones), sharey=True, squeeze=False)[0], zones, strict=True):
            own = {row["case"]: row for row in rows if row["zone"] == zone}
            for k, (name, (label, colour)) in enumerate(shown.items()):
                values = [100 * (own[case][name] or 0.0) for case in cases]
                offset = 0.8 * (k + 0.5) / len(shown) - 0.4
                axes.barh(y - offset, values, 0.8 / len(shown), color=colour, label=label)
            for place, case in zip(y, cases, strict=True):
                if own[case]["error"] is None:
                    word = "failed" if own[case]["note"] else "none"
                    axes.text(0.02, place, word, transform=axes.get_yaxis_transform(), va="center", color="#c8553d")
            axes.set_title(_TITLES[zone])
            axes.set_xlabel("error of p (stretch) or q (shear) / %")
            axes.set_yticks(y, cases)
            axes.grid(axis="x", alpha=0.3)
        handles, labels = figure.axes[0].get_legend_handles_labels()
        words = ", ".join(f"{name} {value}" for name, value in model.items())
        figure.legend(handles, labels, loc="outside upper center", ncols=len(shown), title=words, title_fontsize=10)
    return figure
