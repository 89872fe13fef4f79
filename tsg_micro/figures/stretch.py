"""Figures of a stretched sheet (paper, Section 3.2).

What was ``measured`` comes as a label and a modulus of the sheet over that of the single cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tsg_micro.bodies.sheet import Stretch
from tsg_micro.bodies.sheet_means import CellStrain, histogram_edges
from tsg_micro.data.figure_style import (
    FIELD,
    MICRO,
    STYLE,
    block_outlines,
    new_figure,
    plain_log,
    save_figure,
    shades,
    tidy,
    without_round_off,
)
from tsg_micro.equilibrium.members import MemberSystem
from tsg_micro.figures.parts import part
from tsg_micro.figures.sheet import plot_sheet
from tsg_micro.figures.space import View, plot_views

__all__ = ["draw_band", "draw_convergence", "draw_stretch"]

Array = NDArray[np.float64]
Measured = tuple[str, float]

_BLUE, _RED = "#20639b", "#b5332a"
_MANY = 30
"""Cells in a bin of a histogram from which on its axis is logarithmic."""
_CORNER = (6, 4)
"""Cells along x and y."""
_LABELS = {
    "eps_xx": r"$\varepsilon_{xx}$",
    "eps_yy": r"$\varepsilon_{yy}$",
    "eps_xy": r"$\varepsilon_{xy}$",
}


def draw_stretch(out: Path, result: Stretch, cells: CellStrain, modulus: float, measured: Measured) -> None:
    """The curve beside ``modulus`` (Pa) of a cell, the strain of the cells, the sheet before and after, from above."""
    save_figure(_curve(result, modulus, measured), out / "stress_strain.png")
    save_figure(_strain(result, cells), out / "strain.png")
    _before_and_after(out, result)
    save_figure(plot_sheet(result.structure, result.final.displacement, result.final.members.force), out / "sheet.png")


def _before_and_after(out: Path, result: Stretch) -> None:
    """The whole sheet, and the corner at its origin so near that bars and tendons are seen."""
    structure, u, force = result.structure, result.final.displacement, result.final.members.force
    system = MemberSystem(structure)
    rest = system.state(np.zeros(system.size)).force
    after = f"after {result.steps[-1].strain:.0%} stretch along $y$"
    views = [View("before", None, rest), View(after, u, force)]
    save_figure(plot_views(structure, views, azimuth=-78.0, elevation=48.0, width=9.0), out / "monolayer.png")
    height = result.sheet.tissue.cell.height
    ends = structure.nodes[structure.members]
    near = (ends[..., :2] <= height * np.array(_CORNER) * (1 + 1e-9)).all(axis=(1, 2))
    corner = part(structure, near)
    views = [View("before", None, rest[near]), View(after, u, force[near])]
    save_figure(plot_views(corner, views, azimuth=-72.0, elevation=40.0, width=7.5), out / "corner.png")


def _curve(result: Stretch, modulus: float, measured: Measured) -> Figure:
    """Nominal stress, and the tangent modulus beside that of a single cell and what was measured."""
    strain = 100.0 * np.array(result.column("strain"))
    with mpl.rc_context(STYLE):
        figure = new_figure(12.5, 4.8)
        left, right = figure.subplots(1, 2)
        left.plot(strain, result.column("nominal_stress"), "o-", color=_BLUE, markersize=4)
        left.set_ylabel("nominal stress / Pa")
        right.semilogy(strain, result.column("tangent_modulus"), "o-", color=_BLUE, markersize=4, label="monolayer")
        right.axhline(modulus, color="0.35", linestyle="--", label="single cell, apparent, 3 nN")
        source, ratio = measured
        label = f"{ratio:g} × single cell ({source})"
        right.axhline(ratio * modulus, color=_RED, linestyle=":", linewidth=2, label=label)
        right.set_ylabel("modulus / Pa")
        for axes in (left, right):
            axes.set_xlabel("nominal strain / %")
            tidy(axes)
        figure.legend(
            *right.get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False, fontsize=11
        )
    return figure


def _strain(result: Stretch, cells: CellStrain) -> Figure:
    """Fields on the deformed cells (of several layers the uppermost) and histograms over all of them."""
    top = cells.midpoint[:, 2] >= cells.midpoint[:, 2].max() * (1 - 1e-6)
    shape = MICRO * block_outlines(cells.midpoint[top], cells.displacement[top], result.sheet.tissue.cell.height)
    extent = np.ptp(shape.reshape(-1, 2), axis=0)
    aspect = float(np.clip(extent[1] / extent[0], 0.3, 1.6))
    with mpl.rc_context(STYLE):
        figure = new_figure(17.0, 4.3 + 4.6 * aspect)
        grid = figure.subplots(2, 3, height_ratios=[aspect, 0.75])
        for (field, histogram), (name, strain) in zip(grid.T, cells.components().items(), strict=True):
            values = 100.0 * without_round_off(strain, 1.0)
            _field(field, shape, name, values, top)
            field.set_title(f"{_LABELS[name]} at {result.steps[-1].strain:.0%} stretch")
            _histogram(histogram, name, values)
        grid[0, 0].set_ylabel(r"$y$ / µm")
        grid[1, 0].set_ylabel("number of cells")
    return figure


def _field(axes: Axes, shape: Array, name: str, values: Array, top: NDArray[np.bool_]) -> None:
    """One strain of the cells on ``top`` as a map; shear is centred at zero."""
    sheared = name == "eps_xy"
    reach = max(float(np.abs(values).max()), 0.1)
    low, high = (-reach, reach) if sheared else histogram_edges(values)[[0, -1]]
    drawn = PolyCollection(list(shape), array=values[top], cmap="RdBu_r" if sheared else FIELD, linewidths=0.1)
    drawn.set_edgecolor("face")
    drawn.set_clim(low, high)
    axes.add_collection(drawn)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_xlabel(r"$x$ / µm")
    axes.figure.colorbar(drawn, ax=axes, location="right", shrink=0.85, pad=0.02, label=f"{_LABELS[name]} / %")


def _histogram(axes: Axes, name: str, values: Array) -> None:
    """How many cells have which strain."""
    middle = float(np.median(values))
    count, _, _ = axes.hist(values, bins=histogram_edges(values), color=_BLUE)
    if np.max(count) > _MANY:
        axes.set_yscale("log")  # a few cells among thousands are seen too
        axes.set_ylim(bottom=0.7)
    axes.axvline(middle, color=_RED, linewidth=1.5)
    axes.set_xlabel(f"{_LABELS[name]} / %")
    means = (("median", middle), ("mean", values.mean()))
    words = [f"{word} {round(float(value), 1) + 0.0:.1f} %" for word, value in means]
    axes.set_title(", ".join(words), fontsize=12, color="0.3")
    axes.set_axisbelow(True)
    axes.locator_params(axis="x", nbins=6)
    tidy(axes)


def draw_convergence(out: Path, results: Sequence[Stretch]) -> None:
    """Curves of sheets of several sizes, and their distance to the largest, which is the last."""
    names = [f"{nx} × {ny} blocks" for nx, ny in (result.sheet.blocks for result in results)]
    colours, last = shades(len(results)), np.array(results[-1].column("nominal_stress"))
    with mpl.rc_context(STYLE):
        figure = new_figure(12.5, 4.8)
        left, right = figure.subplots(1, 2)
        for result, name, colour in zip(results, names, colours, strict=True):
            strain, stress = 100.0 * np.array(result.column("strain")), np.array(result.column("nominal_stress"))
            left.plot(strain, stress, "-", color=colour, linewidth=1.8, label=name)
            if result is not results[-1]:
                relative = 100.0 * (stress[1:] / last[1:] - 1.0)
                right.plot(strain[1:], relative, "o-", color=colour, markersize=3.5)
        left.set_ylabel("nominal stress / Pa")
        right.axhline(0.0, color=colours[-1], linewidth=1.8)
        right.set_ylabel(f"difference to {names[-1]} / %")
        for axes in (left, right):
            axes.set_xlabel("nominal strain / %")
            tidy(axes)
        left.legend(frameon=False)
        save_figure(figure, out / "convergence.png")


def draw_band(out: Path, band: Sequence[tuple[Stretch, float]], measured: Measured) -> None:
    """Curves for a band of bar forces, and the modulus of the sheet over that (Pa) of the single cell, its pair."""
    results = [result for result, _ in band]
    with mpl.rc_context(STYLE):
        figure = new_figure(13.5, 5.0)
        left, right = figure.subplots(1, 2)
        for result, colour in zip(results, shades(len(results)), strict=True):
            strain = 100.0 * np.array(result.column("strain"))
            label = f"{1e9 * result.sheet.tissue.bar_force:g} nN"
            left.plot(strain, result.column("nominal_stress"), "-", color=colour, linewidth=1.8, label=label)
        nx, ny = results[0].sheet.blocks
        left.set_title(f"{nx} × {ny} blocks")
        left.set_xlabel("nominal strain / %")
        left.set_ylabel("nominal stress / Pa")
        left.legend(title="bar force $f_b$", frameon=False)
        forces = [1e9 * result.sheet.tissue.bar_force for result in results]
        for at, style, label in ((0, "o-", "at rest"), (-1, "s-", f"at {results[0].steps[-1].strain:.0%} stretch")):
            ratio = [result.steps[at].tangent_modulus / modulus for result, modulus in band]
            right.loglog(forces, ratio, style, color="0.25", markerfacecolor="white", markersize=7, label=label)
        right.set_xticks(forces, [f"{force:g}" for force in forces])
        right.set_xticks([], minor=True)
        plain_log(right.yaxis)
        right.axhline(measured[1], color=_RED, linestyle=":", linewidth=2, label=measured[0])
        right.set_xlabel("bar force $f_b$ / nN")
        right.set_ylabel("tangent modulus of the sheet\nover apparent modulus of one cell")
        right.set_ylim(top=300.0)
        handles, labels = right.get_legend_handles_labels()
        right.legend(handles, labels, frameon=False, fontsize=11, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
        for axes in (left, right):
            tidy(axes)
        save_figure(figure, out / "band.png")
