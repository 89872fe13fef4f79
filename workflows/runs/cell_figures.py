"""Figures and ParaView files of the cell scenes (paper, Section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl

from tsg_micro.data.figure_style import STYLE, new_figure, save_figure, shades, tidy
from tsg_micro.data.series import write_pvd
from tsg_micro.figures.space import View, plot_views
from tsg_micro.figures.vtu import write_vtu

if TYPE_CHECKING:
    from workflows.runs.cell import Indentation

__all__ = ["draw_cell"]


def draw_cell(out: Path, results: Sequence[Indentation], height: float) -> None:
    """Force against displacement, twist, stiffness over the band; the first cell before and after; VTU files."""
    several = len(results) > 1
    with mpl.rc_context(STYLE):
        figure = new_figure(12.5 if not several else 17.5, 4.8)
        panels = figure.subplots(1, 2 + several)
        for result, colour in zip(results, shades(len(results)), strict=True):
            label = f"{1e9 * result.bar_force:g} nN"
            for axes, values in ((panels[0], 1e6 * result.displacement), (panels[1], result.twist_angle)):
                axes.plot(1e9 * result.force, values, "o-", color=colour, markersize=3.5, linewidth=1.6, label=label)
        for axes, text in (
            (panels[0], "displacement of the top / µm"),
            (panels[1], "twist angle of the side faces / degree"),
        ):
            axes.set_xlabel("force / nN")
            axes.set_ylabel(text)
            tidy(axes)
        panels[0].set_ylim(bottom=0.0)
        if several:
            band = [1e9 * result.bar_force for result in results]
            rows = [result.figures(height) for result in results]
            full = f"{1e9 * results[0].force[-1]:g} nN"
            for name, style, label in (
                ("initial", "^--", "tangent, at rest"),
                ("secant", "o-", f"secant, at {full}"),
                ("tangent", "s-", f"tangent, at {full}"),
            ):
                stiffness = [1e3 * row[f"{name}_stiffness"] for row in rows]
                panels[2].loglog(
                    band, stiffness, style, label=label, color="0.25", markerfacecolor="white", markersize=7
                )
            panels[2].set_xticks(band, [f"{value:g}" for value in band])
            panels[2].set_xticks([], minor=True)
            panels[2].yaxis.set_major_formatter("{x:g}")
            panels[2].set_xlabel("bar force $f_b$ / nN")
            panels[2].set_ylabel("stiffness / (mN/m)")
            panels[2].legend(frameon=False)
            tidy(panels[2])
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, title="bar force $f_b$", loc="outside right center", frameon=False)
        save_figure(figure, out / "force_displacement.png")

    first = results[0]
    last = first.states[-1]
    views = [
        View(f"before: bar force {1e9 * first.bar_force:g} nN", None, first.states[0].members.force),
        View(f"after: {1e9 * first.force[-1]:g} nN on the top", last.displacement, last.members.force),
    ]
    save_figure(plot_views(first.structure, views, width=5.5), out / "cell.png")

    for result in results:
        name = f"cell_{1e9 * result.bar_force:g}nN"
        steps = out / f"{name}_steps"
        steps.mkdir(exist_ok=True)
        files: list[tuple[float, str | Path]] = []
        for k, (force, state) in enumerate(zip(result.force, result.states, strict=True)):
            write_vtu(steps / f"{k:03d}.vtu", result.structure, state.displacement, state.members)
            files.append((1e9 * float(force), f"{steps.name}/{k:03d}.vtu"))
        write_pvd(out / f"{name}.pvd", files)
