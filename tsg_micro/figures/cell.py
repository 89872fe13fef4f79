"""Figures and ParaView files of a cell that is pressed down (paper, Section 3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tsg_micro.bodies.cell import Indentation
from tsg_micro.data.figure_style import STYLE, new_figure, save_figure, shades, tidy
from tsg_micro.figures.space import View, plot_views
from tsg_micro.figures.vtu import VtuSeries

__all__ = ["draw_cell"]


def draw_cell(out: Path, results: Sequence[Indentation]) -> None:
    """Force against displacement, twist, stiffness over the band; the first cell before and after; VTU files."""
    save_figure(_curves(results), out / "force_displacement.png")
    first = results[0]
    last = first.states[-1]
    views = [
        View(f"before: bar force {1e9 * first.tissue.bar_force:g} nN", None, first.states[0].members.force),
        View(f"after: {1e9 * first.force[-1]:g} nN on the top", last.displacement, last.members.force),
    ]
    save_figure(plot_views(first.structure, views, width=5.5), out / "cell.png")
    for result in results:
        name = f"cell_{1e9 * result.tissue.bar_force:g}nN"
        series = VtuSeries(out / f"{name}.pvd", result.structure, f"{name}_steps")
        for k, (force, state) in enumerate(zip(result.force, result.states, strict=True)):
            series.add(k, state, time=1e9 * float(force))


def _curves(results: Sequence[Indentation]) -> Figure:
    """Displacement and twist over the force, and of several bar forces the stiffness over them."""
    several = len(results) > 1
    with mpl.rc_context(STYLE):
        figure = new_figure(12.5 if not several else 17.5, 4.8)
        depth, twist, *band = figure.subplots(1, 2 + several)
        for result, colour in zip(results, shades(len(results)), strict=True):
            label = f"{1e9 * result.tissue.bar_force:g} nN"
            for axes, values in ((depth, 1e6 * result.displacement), (twist, result.twist_angle)):
                axes.plot(1e9 * result.force, values, "o-", color=colour, markersize=3.5, linewidth=1.6, label=label)
        for axes, text in ((depth, "displacement of the top / µm"), (twist, "twist angle of the side faces / degree")):
            axes.set_xlabel("force / nN")
            axes.set_ylabel(text)
            tidy(axes)
        depth.set_ylim(bottom=0.0)
        for axes in band:
            _stiffness(axes, results)
        handles, labels = depth.get_legend_handles_labels()
        figure.legend(handles, labels, title="bar force $f_b$", loc="outside right center", frameon=False)
    return figure


def _stiffness(axes: Axes, results: Sequence[Indentation]) -> None:
    """Stiffness at rest and at the full force over the bar force."""
    band = [1e9 * result.tissue.bar_force for result in results]
    full = f"{1e9 * results[0].force[-1]:g} nN"
    for stiffness, style, label in (
        ([result.initial_stiffness for result in results], "^--", "tangent, at rest"),
        ([result.secant_stiffness for result in results], "o-", f"secant, at {full}"),
        ([result.tangent_stiffness for result in results], "s-", f"tangent, at {full}"),
    ):
        values = [1e3 * value for value in stiffness]
        axes.loglog(band, values, style, label=label, color="0.25", markerfacecolor="white", markersize=7)
    axes.set_xticks(band, [f"{value:g}" for value in band])
    axes.set_xticks([], minor=True)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("bar force $f_b$ / nN")
    axes.set_ylabel("stiffness / (mN/m)")
    axes.legend(frameon=False)
    tidy(axes)
