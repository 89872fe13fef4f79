"""Figures of material data: the sampled strains, and the p-q paths they lead to (paper, Section 4.2)."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tsg_micro.dataset import Dataset
from tsg_micro.mandel import COMPONENTS, from_mandel, pressure, von_mises
from tsg_micro.plot import STYLE

__all__ = ["plot_dataset"]

_MOST_PATHS = 12


def plot_dataset(dataset: Dataset) -> Figure:
    """The two strain components that vary most, and pressure against effective stress; some paths are drawn out."""
    tensors = from_mandel(dataset.strain)
    rows, columns = np.array([["xyz".index(axis) for axis in name] for name in COMPONENTS]).T
    strain = 100.0 * tensors[:, rows, columns]
    first, second = np.sort(np.argsort(np.ptp(strain, axis=0))[-2:])
    p, q = pressure(dataset.stress), von_mises(dataset.stress)
    shown = np.unique(dataset.path)
    shown = shown[np.linspace(0, len(shown) - 1, min(len(shown), _MOST_PATHS)).astype(int)]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12, 4.8), layout="constrained")
        FigureCanvasAgg(figure)
        left, right = figure.subplots(1, 2)
        colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.9, len(shown)))
        for axes, x, y in ((left, strain[:, first], strain[:, second]), (right, p, q)):
            axes.scatter(x, y, s=4, color="0.75", linewidths=0, rasterized=True)
            for path, colour in zip(shown, colours, strict=True):
                member = np.flatnonzero(dataset.path == path)
                member = member[np.argsort(dataset.step[member])]
                axes.plot(x[member], y[member], "o-", color=colour, markersize=3.5, linewidth=1.2)
            axes.grid(color="0.92", linewidth=0.8)
            axes.spines[["top", "right"]].set_visible(False)
        left.set_xlabel(rf"$\varepsilon_{{{COMPONENTS[first]}}}$ / %")
        left.set_ylabel(rf"$\varepsilon_{{{COMPONENTS[second]}}}$ / %")
        left.set_title(f"{len(dataset)} points on {len(np.unique(dataset.path))} paths")
        right.set_xlabel("pressure $p$ / Pa")
        right.set_ylabel("effective stress $q$ / Pa")
        right.set_title(f"{dataset.stress_measure.replace('_', ' ')} stress")
        handles = [
            Line2D([], [], color="0.75", marker="o", linestyle="", markersize=4, label="data"),
            Line2D([], [], color=colours[0], marker="o", markersize=4, label=f"{len(shown)} of the paths"),
        ]
        left.legend(handles=handles, frameon=False, fontsize=11)
    return figure
