"""Figure of the study of edges. Plain arrays in, a Matplotlib figure out; stresses in Pa."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tsg_micro.data.figure_style import STYLE, new_figure, tidy

__all__ = ["plot_rows"]

Array = NDArray[np.float64]
_LINES = (
    {"color": "0.15", "marker": "o", "markersize": 5, "linewidth": 1.8},
    {"color": "#d55e00", "marker": "s", "markersize": 4, "linewidth": 1.2, "linestyle": "--"},
    {"color": "#20639b", "marker": "^", "markersize": 5, "linewidth": 1.4},
)


def plot_rows(rows: Mapping[str, Array]) -> Figure:
    """P_xx, P_yy and P_zz of the rows of a sheet, from the clamp at the bottom to that at the top.

    Args:
        rows: mean stress (rows, 3) of each row, by what it is of; three of them.
    """
    with mpl.rc_context(STYLE):
        figure = new_figure(13.0, 4.2)
        panels = figure.subplots(1, 3)
        for k, axes in enumerate(panels):
            for (name, values), line in zip(rows.items(), _LINES, strict=True):
                axes.plot(np.arange(1, len(values) + 1), values[:, k], label=name, **line)
            axes.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
            axes.set_xlabel("row of blocks from the bottom")
            axes.set_ylabel(f"$P_{{{'xyz'[k] * 2}}}$ / Pa")
            tidy(axes)
        panels[0].legend(frameon=False)
    return figure
