"""The figure of ``tsgdd fe2``: how Newton's method converges."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dd_macro.methods.newton import NewtonIteration
from tsg_micro.data.figure_style import STYLE, new_figure

__all__ = ["plot_newton"]


def plot_newton(history: Sequence[NewtonIteration]) -> Figure:
    """Residuals of the iterations, a line for each load."""
    loads = list(dict.fromkeys(it.load for it in history))
    with mpl.rc_context(STYLE):
        figure = new_figure(8, 5.5)
        axes = figure.subplots()
        for k, load in enumerate(loads):
            own = [(i, it.residual) for i, it in enumerate(history, start=1) if it.load == load and it.residual > 0.0]
            shade = mpl.colormaps["viridis"](0.85 * (1.0 - (k + 1) / len(loads)))
            axes.semilogy(*zip(*own, strict=True), "o-", color=shade, label=f"{load:.3g} of the load")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("linear solves")
        axes.set_ylabel("out-of-balance force over that of the supports")
        axes.grid(alpha=0.3)
        if 1 < len(loads) <= 8:
            figure.legend(loc="outside upper center", ncols=4)
    return figure
