"""The figure of ``tsgdd solve --adapt``: how the state settles as RVEs are added."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from tsg_micro.data.figure_style import STYLE, new_figure
from workflows.runs.adapt import Round

__all__ = ["plot_rounds"]

_CURVES = {
    "gap": ("strain from the nearest datum", "s:", "tab:gray"),
    "surprise": ("error of stress at the last RVEs before they were added", "^--", "tab:orange"),
    "change": ("change of the state since the last round", "o-", "tab:blue"),
    "error": ("estimated error of the state", "D-", "tab:green"),
}


def plot_rounds(rounds: Sequence[Round]) -> Figure:
    """Gap of strain, error of prediction, change and error of the state of every round over the data it had."""
    with mpl.rc_context(STYLE):
        figure = new_figure(10, 8)
        axes = figure.subplots()
        for name, (label, style, color) in _CURVES.items():
            pairs = [(r.data, value) for r in rounds if (value := getattr(r, name))]
            if pairs:
                axes.loglog(*zip(*pairs, strict=True), style, color=color, label=label)
        axes.set_xscale("log", base=2)
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel("data")
        axes.set_ylabel("relative to the whole, in the metric")
        axes.grid(alpha=0.3)
        figure.legend(loc="outside upper center")
    return figure
