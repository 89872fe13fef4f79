"""Figures of data: sampled strains and p-q paths (paper, Section 4.2), stress curves, maps over blocks."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike, NDArray

from tsg_micro.data.dataset import Dataset
from tsg_micro.data.figure_style import STYLE, block_outlines, finite, new_figure, plot_maps, tidy
from tsg_micro.data.mandel import COMPONENTS, from_mandel, pressure, von_mises
from tsg_micro.data.stress import measure_words

__all__ = ["plot_blocks", "plot_curve", "plot_dataset"]

Array = NDArray[np.float64]

_MOST_PATHS = 12


def plot_dataset(dataset: Dataset) -> Figure:
    """Two strain components, the sampled ones or those that vary most, and p against q; some paths are drawn out."""
    tensors = from_mandel(dataset.strain)
    rows, columns = np.array([["xyz".index(axis) for axis in name] for name in COMPONENTS]).T
    strain = 100.0 * tensors[:, rows, columns]
    sampled = [COMPONENTS.index(name) for name in dataset.parameters.get("box", {}).get("ranges", ())]
    among = np.array(sampled if len(sampled) > 1 else range(6))
    first, second = np.sort(among[np.argsort(np.ptp(strain[:, among], axis=0))[-2:]])
    p, q = pressure(dataset.stress), von_mises(dataset.stress)
    shown = np.unique(dataset.path)
    shown = shown[np.linspace(0, len(shown) - 1, min(len(shown), _MOST_PATHS)).astype(int)]
    with mpl.rc_context(STYLE):
        figure = new_figure(12, 4.8)
        left, right = figure.subplots(1, 2)
        colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.9, len(shown)))
        for axes, x, y in ((left, strain[:, first], strain[:, second]), (right, p, q)):
            axes.scatter(x, y, s=4, color="0.75", linewidths=0, rasterized=True)
            for path, colour in zip(shown, colours, strict=True):
                member = np.flatnonzero(dataset.path == path)
                member = member[np.argsort(dataset.step[member])]
                axes.plot(x[member], y[member], "o-", color=colour, markersize=3.5, linewidth=1.2)
            tidy(axes)
        left.set_xlabel(rf"$\varepsilon_{{{COMPONENTS[first]}}}$ / %")
        left.set_ylabel(rf"$\varepsilon_{{{COMPONENTS[second]}}}$ / %")
        left.set_title(f"{len(dataset)} points on {len(np.unique(dataset.path))} paths")
        right.set_xlabel("pressure $p$ / Pa")
        right.set_ylabel("effective stress $q$ / Pa")
        right.set_title(f"{measure_words(dataset.stress_measure)} stress")
        handles = [
            Line2D([], [], color="0.75", marker="o", linestyle="", markersize=4, label="data"),
            Line2D([], [], color=colours[0], marker="o", markersize=4, label=f"{len(shown)} of the paths"),
        ]
        left.legend(handles=handles, fontsize=11, framealpha=0.9)
    return figure


def plot_blocks(
    midpoint: Array,
    fields: Mapping[str, tuple[ArrayLike, str]],
    *,
    displacement: Array | None = None,
    columns: int = 2,
    single: float = 20e-6,
) -> Figure:
    """Fields per block of a box of blocks, each on a scale of its own; of several layers the uppermost is drawn.

    Args:
        midpoint: reference midpoints (b, 3) of the blocks, m.
        fields: title -> (values (b,), unit); stresses in Pa.
        displacement: of the midpoints (b, 3), m; given, the blocks are drawn deformed.
        columns: of panels.
        single: edge length in m of a block that is alone, so that no distance tells it.

    Raises:
        InputError: the midpoints are not those of a full regular grid, or a field is of another length or not finite.
    """
    top = midpoint[:, 2] >= midpoint[:, 2].max() - 1e-6 * np.ptp(midpoint, axis=0).max()
    midpoint = midpoint[top]
    if displacement is not None:
        displacement = finite("displacement", displacement, (len(top), 3))[top]
    shown = {title: (finite(f"field {title}", v, (len(top),))[top], unit) for title, (v, unit) in fields.items()}
    return plot_maps(block_outlines(midpoint, displacement, single), shown, columns=columns)


def plot_curve(
    strain: ArrayLike, stress: ArrayLike, *, strain_label: str = "nominal strain", stress_label: str = "nominal stress"
) -> Figure:
    """Stress (steps,) in Pa over strain (steps,), each step a marker.

    Raises:
        InputError: the arrays differ in length, are empty, or hold NaN.
    """
    strain = finite("strain", strain, (np.size(strain),))
    stress = finite("stress", stress, strain.shape)
    unit, factor = ("kPa", 1e-3) if np.abs(stress).max(initial=0.0) >= 2e3 else ("Pa", 1.0)
    with mpl.rc_context(STYLE):
        figure = new_figure(6.5, 4.5)
        axes = figure.add_subplot()
        axes.plot(100 * strain, factor * stress, "o-", color="#20639b", markersize=5)
        axes.set_xlabel(f"{strain_label} / %")
        axes.set_ylabel(f"{stress_label} / {unit}")
        tidy(axes)
    return figure
