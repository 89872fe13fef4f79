"""The figure of ``tsgdd study data-size``: error and distance against the number of data, as in the paper."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from tsg_micro.data.figure_style import STYLE, new_figure

__all__ = ["plot_data_size"]

_MECHANICAL, _MATERIAL = "#20639b", "#c8553d"


def plot_data_size(summary: Mapping[str, Any]) -> Figure:
    """(a) error of p or q of both solutions, (b) normalised distance; means of the draws, least to largest as bands."""
    symbol, sizes = summary["symbol"], summary["sizes"]
    with mpl.rc_context(STYLE):
        figure = new_figure(13, 5.4)
        left, right = figure.subplots(1, 2)
        for name, label, colour in (
            ("error_mech", "mechanical solution", _MECHANICAL),
            ("error_mat", "material solution", _MATERIAL),
        ):
            _band(left, sizes, summary[name], f"{label}, outer blocks left out", colour, "o-")
            _band(left, sizes, summary[f"{name}_all"], f"{label}, all blocks", colour, "s:")
        left.set_ylabel(rf"error of ${symbol}$ / %")
        left.set_title(f"(a) error of ${symbol}$ against the {summary['reference']}")
        _band(right, sizes, summary["distance"], "outer blocks left out", _MECHANICAL, "o-")
        _band(right, sizes, summary["distance_all"], "all blocks", _MATERIAL, "s-")
        for name, colour in (("distance", _MECHANICAL), ("distance_all", _MATERIAL)):
            value = 100 * summary["self_consistent"][name]
            right.axhline(value, color=colour, linestyle=":", label=f"data of the tensegrity itself: {value:.1f} %")
        right.set_ylabel(r"normalised distance $\\|y - z\\| / \\|z\\|$ / %".replace("\\\\", "\\"))
        right.set_title("(b) distance of material and mechanical solution")
        for axes in (left, right):
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_xlabel("number of data")
            low, high = axes.get_ylim()
            axes.set_ylim(low, high * (high / low) ** 0.45)  # room for the legend
            axes.grid(alpha=0.3, which="both")
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_locator(LogLocator(subs=(2, 3, 5)))
            axes.yaxis.set_minor_formatter("{x:g}")
            axes.legend(loc="upper right", fontsize=10)
    return figure


def _band(axes: Axes, sizes: list[int], values: Mapping[str, Any], label: str, colour: str, style: str) -> None:
    mean, low, high = (100 * np.asarray(values[name]) for name in ("mean", "smallest", "largest"))
    axes.plot(sizes, mean, style, color=colour, markersize=4, label=label)
    axes.fill_between(sizes, low, high, color=colour, alpha=0.15, linewidth=0)
