"""The figure of ``tsgdd bench frontier``: error against run time, the sampling of the data or the RVEs included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

from tsg_micro.data.figure_style import STYLE, new_figure, tidy

__all__ = ["plot_frontier"]

_STYLES = {
    "FE2": {"color": "#222222", "marker": "X"},
    "data-driven, metric tangent": {"color": "#20639b", "marker": "o"},
    "second-order data": {"color": "#c8553d", "marker": "v"},
    "adaptive from nothing": {"color": "#d62f8a", "marker": "D"},
}
"""The methods that are drawn; frontier.csv has all."""
_LINES: tuple[dict[str, Any], ...] = (
    {"linestyle": "-", "fillstyle": "full"},
    {"linestyle": "--", "fillstyle": "none"},
    {"linestyle": ":", "fillstyle": "left"},
)
_FLOOR = "FE2"

Row = Mapping[str, Any]


def plot_frontier(rows: Sequence[Row], dns_seconds: float, summary: Mapping[str, Any]) -> Figure:
    """Errors of p or q of the mechanical solution, outer blocks left out; numbers at the points: data or RVEs.

    Left against the full tensegrity, whose time is the vertical line; horizontal ones are FE2. Right against FE2.
    Drawn are data as points, data with tangents, data that a solve asks for, and FE2.
    """
    methods = [name for name in _STYLES if name in {row["method"] for row in rows}]
    styles = {name: {**_STYLES[name], "markersize": 7, "linewidth": 1.2} for name in methods}
    models = dict(zip(dict.fromkeys(row["model"] for row in rows), cycle(_LINES), strict=False))
    symbol = summary["symbol"]
    labels = (
        f"error of ${symbol}$ against the tensegrity / %",
        f"error of ${symbol}$ against FE2 of the same model / %",
    )
    with mpl.rc_context(STYLE):
        figure = new_figure(14, 7.0)
        for axes, error, label in zip(
            figure.subplots(1, 2, sharex=True), ("error_mech", "error_fe2"), labels, strict=True
        ):
            for model, lines in models.items():
                for method in methods:
                    own = [row for row in rows if row["method"] == method and row["model"] == model]
                    _curve(axes, [row for row in own if row[error]], error, {**styles[method], **lines})
            axes.axvline(dns_seconds, color="0.3", linestyle=(0, (5, 1)), linewidth=1.2)
            _scales(axes)
            axes.set_ylabel(label)
            axes.set_xlabel("time of sampling and solve / s")
        _legend(figure, styles, models, f"{summary['reference']}, {dns_seconds:.3g} s")
        machine = summary["machine"]
        figure.text(0.995, 0.005, f"{machine['processor']}, {machine['cores']} cores", fontsize=8, ha="right")
    return figure


def _curve(axes: Axes, rows: Sequence[Row], error: str, style: Mapping[str, Any]) -> None:
    """Points of one method and model, joined; a line across at the error of FE2, which no data can lower."""
    times = [row["seconds_solve"] + row["seconds_sampling"] for row in rows]
    errors = [100 * row[error] for row in rows]
    axes.plot(times, errors, **style)
    for row, x, y in zip(rows, times, errors, strict=True):
        if row["method"] == _FLOOR:
            axes.axhline(y, color=style["color"], linestyle=style["linestyle"], linewidth=0.8, alpha=0.6, zorder=0)
        axes.annotate(f"{row['data']}", (x, y), (4, 4), textcoords="offset points", fontsize=9, color=style["color"])


def _scales(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(x=0.1)  # for the numbers at the points
    low, high = axes.get_ylim()
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 300 * low else (1,), numticks=12))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    tidy(axes)


def _legend(
    figure: Figure, styles: Mapping[str, Mapping[str, Any]], models: Mapping[str, Mapping[str, Any]], dns: str
) -> None:
    """Colours and markers are methods, lines and fillings models."""
    handles = [Line2D([], [], label=name, **style) for name, style in styles.items()]
    handles += [Line2D([], [], color="0.4", marker="o", label=name, **lines) for name, lines in models.items()]
    handles.append(Line2D([], [], color="0.3", linestyle=(0, (5, 1)), label=dns))
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=11, frameon=False)
