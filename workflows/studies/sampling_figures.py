"""Figures of the study of sampling. Plain arrays and data sets in, a Matplotlib figure out; stresses in Pa."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from tsg_micro.continuum.sampling import StrainBox
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.figure_style import STYLE, new_figure, plain_log, tidy
from tsg_micro.data.mandel import COMPONENTS, pressure, von_mises
from tsg_micro.data.stress import measure_words
from workflows.studies.coverage import BoxCoverage

__all__ = ["plot_coverage", "plot_paths", "plot_visited"]

Array = NDArray[np.float64]
_FAINT = "0.78"
_COLOURS = {"mechanical": "#c8102e", "material": "#20639b"}
_MOST_PATHS = 12


def plot_paths(datasets: Mapping[str, Dataset]) -> Figure:
    """p-q paths from zero of some sampled loadings, a panel a load, all data faint (paper, Section 4.2)."""
    with mpl.rc_context(STYLE):
        figure = new_figure(6.4 * len(datasets), 5.0)
        for axes, (load, data) in zip(
            figure.subplots(1, len(datasets), squeeze=False)[0], datasets.items(), strict=True
        ):
            p, q = pressure(data.stress), von_mises(data.stress)
            axes.scatter(p, q, s=4, color=_FAINT, linewidths=0, rasterized=True)
            numbers = np.unique(data.path)[:_MOST_PATHS]  # a path's number says nothing about where it goes
            ends = {n: np.flatnonzero(data.path == n) for n in numbers}
            # colours by the direction in p-q, so that neighbours can be told apart
            order = sorted(numbers, key=lambda n: np.arctan2(q[ends[n][-1]], p[ends[n][-1]]))
            colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.92, len(order)))
            for colour, number in zip(colours, order, strict=True):
                member = ends[number][np.argsort(data.step[ends[number]])]
                path = np.concatenate([[[0.0, 0.0]], np.column_stack([p, q])[member]]).T
                axes.plot(*path, "-", color=colour, linewidth=1.6)
                axes.plot(*path[:, 1:], "o", color=colour, markersize=3.5)
            axes.set_xlabel("pressure $p$ / Pa")
            axes.set_ylabel("effective stress $q$ / Pa")
            paths = f"{len(order)} of {len(np.unique(data.path))} paths, {len(data)} points"
            axes.set_title(f"{load}: {paths}, {measure_words(data.stress_measure)}")
            _plain(axes)
    return figure


def plot_coverage(strain: Array, box: StrainBox, coverage: BoxCoverage) -> Figure:
    """Sampled strains in their box, points in each of its cells, and the gaps against the number of points.

    Args:
        strain: Mandel (N, 6).
        box: what was sampled.
        coverage: of these points.
    """
    x, y = _axes_strain(strain, box)
    (x0, x1), (y0, y1) = _limits(box)
    with mpl.rc_context(STYLE):
        figure = new_figure(15.5, 4.8)
        data, cells, gaps = figure.subplots(1, 3)
        data.scatter(x, y, s=3, color="#20639b", linewidths=0, rasterized=True)
        _outline(data, box)
        data.set_title(f"{len(strain)} points, {coverage.outside} outside the box")
        drawn = cells.imshow(
            coverage.counts.T, origin="lower", extent=(x0, x1, y0, y1), aspect="auto", cmap="viridis", vmin=0
        )
        figure.colorbar(drawn, ax=cells, label="points in a cell")
        counts = coverage.counts
        cells.set_title(f"min {counts.min()}, mean {counts.mean():.3g}, max {counts.max()}")
        for axes in (data, cells):
            _strain_labels(axes, box)
        series = {
            "largest gap (fill distance)": (coverage.fill_by_size, "o", "#d55e00"),
            "mean gap": (coverage.gap_by_size, "s", "#0072b2"),
        }
        for name, (values, marker, colour) in series.items():
            label = f"{name}, slope {coverage.slope(values):.2f}".replace("-", "−")
            gaps.loglog(coverage.sizes, values, marker=marker, color=colour, label=label)
        guide = coverage.gap_by_size[0] * np.sqrt(coverage.sizes[0] / coverage.sizes)
        gaps.loglog(coverage.sizes, 0.6 * guide, "--", color="0.4", label="slope −1/2")
        gaps.set_xlabel("number of points $N$")
        gaps.set_ylabel("distance to the nearest point / box side")
        gaps.set_ylim(top=4.0 * coverage.fill_by_size.max())  # room for the legend
        plain_log(gaps.xaxis)
        plain_log(gaps.yaxis)
        gaps.legend(frameon=False, fontsize=11, loc="upper right")
        _plain(gaps)
    return figure


def plot_visited(
    box: StrainBox,
    *,
    data: tuple[Array, Array, Array],
    strains: Mapping[str, Array],
    invariants: Mapping[str, tuple[Array, Array]],
    rms: Mapping[str, Array],
    rms_stress: Mapping[str, Array],
    stress_measure: str,
) -> Figure:
    """States of a data-driven solution over the data, in the sampled strains and in p-q, and both by component.

    Args:
        box: what was sampled.
        data: Mandel strain (N, 6), p and q (N,) of all data.
        strains: "mechanical" and "material" -> Mandel strain (m, 6) at the quadrature points.
        invariants: "mechanical" and "material" -> p and q (m,) at the quadrature points.
        rms: "mechanical", "material", "data" and "gap" -> root mean square strain (6,), Mandel.
        rms_stress: the same of the stress, Pa.
        stress_measure: of all stresses.
    """
    with mpl.rc_context(STYLE):
        figure = new_figure(13.0, 10.0)
        (left, middle), bars = figure.subplots(2, 2)
        left.scatter(*_axes_strain(data[0], box), s=4, color=_FAINT, linewidths=0, rasterized=True, label="data")
        middle.scatter(data[1], data[2], s=4, color=_FAINT, linewidths=0, rasterized=True, label="data")
        for (name, colour), size in zip(_COLOURS.items(), (3, 7), strict=True):
            style = {"color": colour, "s": size, "linewidths": 0, "rasterized": True}
            left.scatter(*_axes_strain(strains[name], box), label=f"{name} states", **style)
            middle.scatter(*invariants[name], label=f"{name} states", **style)
        _outline(left, box)
        _strain_labels(left, box)
        middle.set_xlabel("pressure $p$ / Pa")
        middle.set_ylabel("effective stress $q$ / Pa")
        left.set_title("a  strain", loc="left")
        middle.set_title(f"b  {measure_words(stress_measure)} stress", loc="left")
        _plain(middle)
        _bars(bars[0], {name: 100.0 * values for name, values in rms.items()})
        bars[0].set_ylabel("root mean square strain (Mandel) / %")
        bars[0].set_title("c  strain by component", loc="left")
        _bars(bars[1], rms_stress)
        bars[1].set_ylabel("root mean square stress (Mandel) / Pa")
        bars[1].set_title(f"d  {measure_words(stress_measure)} stress by component", loc="left")
        handles, names = left.get_legend_handles_labels()
        gap = bars[1].get_legend_handles_labels()[0][-1]
        figure.legend(
            [*handles, gap], [*names, "mechanical less material"], loc="outside upper center", ncols=5, frameon=False,
            markerscale=3,
        )  # fmt: skip
    return figure


def _bars(axes: Axes, rms: Mapping[str, Array]) -> None:
    """Root mean squares (6,) of data, states and gap side by side, a group a component."""
    shown = {"data": _FAINT, **_COLOURS, "gap": "#e69f00"}
    for i, (name, colour) in enumerate(shown.items()):
        axes.bar(np.arange(6) + 0.2 * (i - 1.5), rms[name], 0.2, color=colour, label=name)
    axes.set_xticks(np.arange(6), [f"${name}$" for name in COMPONENTS])
    axes.spines[["top", "right"]].set_visible(False)


def _axes_strain(strain: Array, box: StrainBox) -> tuple[Array, Array]:
    """The two sampled components in percent, of Mandel strains (..., 6); the shear as gamma."""
    x, y = (100.0 * strain[..., COMPONENTS.index(c)] * (1.0 if c[0] == c[1] else np.sqrt(2.0)) for c in box.ranges)
    return x, y


def _limits(box: StrainBox) -> list[tuple[float, float]]:
    """Sides of the box in percent; the shear as gamma."""
    scale = {c: 100.0 if c[0] == c[1] else 200.0 for c in box.ranges}
    return [(scale[c] * low, scale[c] * high) for c, (low, high) in box.ranges.items()]


def _strain_labels(axes: Axes, box: StrainBox) -> None:
    names = [rf"$\varepsilon_{{{c}}}$ / %" if c[0] == c[1] else rf"$\gamma_{{{c}}}$ / %" for c in box.ranges]
    axes.set_xlabel(names[0])
    axes.set_ylabel(names[1])


def _outline(axes: Axes, box: StrainBox) -> None:
    (x0, x1), (y0, y1) = _limits(box)
    axes.add_patch(
        Rectangle(
            (x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor="black", linewidth=1.3, label="sampled box", zorder=3
        )
    )


def _plain(axes: Axes) -> None:
    axes.set_axisbelow(True)
    tidy(axes)
