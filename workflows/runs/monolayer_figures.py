"""Figures and ParaView files of ``tsgdd monolayer`` (paper, Section 3.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import PolyCollection

from tsg_micro.bodies.sheet import CellStrain, Stretch, histogram_edges
from tsg_micro.cells.structure import Structure
from tsg_micro.data.figure_style import MICRO, STYLE, new_figure, save_figure, shades, tidy
from tsg_micro.data.series import write_pvd
from tsg_micro.equilibrium.load_path import Equilibrium
from tsg_micro.equilibrium.members import MemberSystem
from tsg_micro.figures.data import outlines
from tsg_micro.figures.sheet import plot_sheet
from tsg_micro.figures.space import View, plot_views
from tsg_micro.figures.vtu import write_vtu
from workflows.experiments import published

__all__ = ["SeriesWriter", "draw_band", "draw_convergence", "draw_monolayer"]

_CORNER = (6, 4)
"""Cells along x and y."""
_LABELS = {
    "eps_xx": r"$\varepsilon_{xx}$",
    "eps_yy": r"$\varepsilon_{yy}$",
    "eps_xy": r"$\varepsilon_{xy}$",
}


class SeriesWriter:
    """Writes every n-th load step as VTU while the run goes on, and at its end the list of them for ParaView."""

    def __init__(self, out: Path, *, every: int, last: int) -> None:
        self.out, self.every, self.last = out, every, last
        self.files: list[tuple[float, str | Path]] = []

    def __call__(self, step: int, strain: float, structure: Structure, state: Equilibrium) -> None:
        """Take one step."""
        if step == 0:
            (self.out / "steps").mkdir(exist_ok=True)
        if step % self.every == 0 or step == self.last:
            name = f"steps/{step:03d}.vtu"
            write_vtu(self.out / name, structure, state.displacement, state.members)
            self.files.append((float(step), name))

    def close(self) -> None:
        """Write monolayer.pvd; its time is the number of the load step."""
        write_pvd(self.out / "monolayer.pvd", self.files)


def draw_monolayer(out: Path, result: Stretch, cells: CellStrain, modulus: float) -> None:
    """The curve, the strain of the cells, the sheet before and after, and the sheet from above."""
    save_figure(_curve(result, modulus), out / "stress_strain.png")
    save_figure(_strain(result, cells), out / "strain.png")
    _before_and_after(out, result)
    save_figure(plot_sheet(result.structure, result.final.displacement, result.final.members.force), out / "sheet.png")


def _before_and_after(out: Path, result: Stretch) -> None:
    """The whole sheet, and the corner at its origin so near that bars and tendons are seen."""
    structure, u, force = result.structure, result.final.displacement, result.final.members.force
    system = MemberSystem(structure)
    rest = system.state(np.zeros(system.size)).force
    after = f"after {result.strain[-1]:.0%} stretch along $y$"
    views = [View("before", None, rest), View(after, u, force)]
    save_figure(plot_views(structure, views, azimuth=-78.0, elevation=48.0, width=9.0), out / "monolayer.png")
    height = result.sheet.parameters.height
    ends = structure.nodes[structure.members]
    near = (ends[..., :2] <= height * np.array(_CORNER) * (1 + 1e-9)).all(axis=(1, 2))
    part = dataclasses.replace(
        structure,
        **{
            name: getattr(structure, name)[near]
            for name in ("members", "kind", "EA", "rest_length", "shift", "member_cells")
        },
    )
    views = [View("before", None, rest[near]), View(after, u, force[near])]
    save_figure(plot_views(part, views, azimuth=-72.0, elevation=40.0, width=7.5), out / "corner.png")


def _curve(result: Stretch, modulus: float) -> Any:
    """Nominal stress, and the tangent modulus beside that of a single cell and what was measured."""
    strain = 100.0 * np.array(result.strain)
    with mpl.rc_context(STYLE):
        figure = new_figure(12.5, 4.8)
        left, right = figure.subplots(1, 2)
        left.plot(strain, result.nominal_stress, "o-", color="#20639b", markersize=4)
        left.set_ylabel("nominal stress / Pa")
        right.semilogy(strain, result.tangent_modulus, "o-", color="#20639b", markersize=4, label="monolayer")
        right.axhline(modulus, color="0.35", linestyle="--", label="single cell, apparent, 3 nN")
        measured = published("harris_2012")["modulus_ratio"]
        label = f"100 × single cell ({measured.label})"
        right.axhline(measured.low * modulus, color="#b5332a", linestyle=":", linewidth=2, label=label)
        right.set_ylabel("modulus / Pa")
        for axes in (left, right):
            axes.set_xlabel("nominal strain / %")
            tidy(axes)
        figure.legend(
            *right.get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False, fontsize=11
        )
    return figure


def _strain(result: Stretch, cells: CellStrain) -> Any:
    """Fields on the deformed cells (of several layers the uppermost) and histograms over all of them."""
    top = cells.midpoint[:, 2] >= cells.midpoint[:, 2].max() * (1 - 1e-6)
    shape = MICRO * outlines(cells.midpoint[top], cells.displacement[top], result.sheet.parameters.height)
    extent = np.ptp(shape.reshape(-1, 2), axis=0)
    with mpl.rc_context(STYLE):
        figure = new_figure(17.0, 4.3 + 4.6 * float(np.clip(extent[1] / extent[0], 0.3, 1.6)))
        grid = figure.subplots(2, 3, height_ratios=[float(np.clip(extent[1] / extent[0], 0.3, 1.6)), 0.75])
        for column, (name, values) in enumerate(cells.components().items()):
            field, histogram = grid[:, column]
            middle = float(np.median(values))
            means = (("median", middle), ("mean", values.mean()))
            reach = max(float(np.abs(values).max()), 1e-3)
            low, high = (-reach, reach) if name == "eps_xy" else histogram_edges(values)[[0, -1]]
            drawn = PolyCollection(
                list(shape), array=values[top], cmap="RdBu_r" if name == "eps_xy" else "viridis", linewidths=0.1
            )
            drawn.set_edgecolor("face")
            drawn.set_clim(low, high)
            field.add_collection(drawn)
            field.autoscale_view()
            field.set_aspect("equal")
            field.set_xlabel(r"$x$ / µm")
            field.set_title(f"{_LABELS[name]} at {result.strain[-1]:.0%} stretch")
            figure.colorbar(drawn, ax=field, location="right", shrink=0.85, pad=0.02)
            counts, _, _ = histogram.hist(values, bins=histogram_edges(values), color="#20639b")
            if counts.max() > 50:
                histogram.set_yscale("symlog", linthresh=10.0)  # a few cells among thousands are seen too
            histogram.axvline(middle, color="#b5332a", linewidth=1.5)
            histogram.set_xlabel(_LABELS[name])
            words = [f"{word} {round(float(value), 3) + 0.0:.3f}" for word, value in means]
            histogram.set_title(", ".join(words), fontsize=12, color="0.3")
            histogram.set_axisbelow(True)
            histogram.locator_params(axis="x", nbins=6)
            tidy(histogram)
        grid[0, 0].set_ylabel(r"$y$ / µm")
        grid[1, 0].set_ylabel("number of cells")
    return figure


def draw_convergence(out: Path, results: Sequence[Stretch]) -> None:
    """Curves of sheets of several sizes, and their distance to the largest."""
    reference = np.array(results[-1].nominal_stress)
    with mpl.rc_context(STYLE):
        figure = new_figure(12.5, 4.8)
        left, right = figure.subplots(1, 2)
        for result, colour in zip(results, shades(len(results)), strict=True):
            nx, ny = result.sheet.blocks
            strain = 100.0 * np.array(result.strain)
            left.plot(strain, result.nominal_stress, "-", color=colour, linewidth=1.8, label=f"{nx} × {ny} blocks")
            if result is not results[-1]:
                relative = 100.0 * (np.array(result.nominal_stress)[1:] / reference[1:] - 1.0)
                right.plot(strain[1:], relative, "o-", color=colour, markersize=3.5)
        left.set_ylabel("nominal stress / Pa")
        right.axhline(0.0, color=shades(len(results))[-1], linewidth=1.8)
        nx, ny = results[-1].sheet.blocks
        right.set_ylabel(f"difference to {nx} × {ny} blocks / %")
        for axes in (left, right):
            axes.set_xlabel("nominal strain / %")
            tidy(axes)
        left.legend(frameon=False)
        save_figure(figure, out / "convergence.png")


def draw_band(out: Path, results: Sequence[Stretch], moduli: Sequence[float]) -> None:
    """Curves for a band of bar forces, and the modulus of the sheet over that of the single cell."""
    with mpl.rc_context(STYLE):
        figure = new_figure(13.5, 5.0)
        left, right = figure.subplots(1, 2)
        for result, colour in zip(results, shades(len(results)), strict=True):
            strain = 100.0 * np.array(result.strain)
            label = f"{1e9 * result.sheet.bar_force:g} nN"
            left.plot(strain, result.nominal_stress, "-", color=colour, linewidth=1.8, label=label)
        nx, ny = results[0].sheet.blocks
        left.set_title(f"{nx} × {ny} blocks")
        left.set_xlabel("nominal strain / %")
        left.set_ylabel("nominal stress / Pa")
        left.legend(title="bar force $f_b$", frameon=False)
        band = [1e9 * result.sheet.bar_force for result in results]
        for at, style, label in ((0, "o-", "at rest"), (-1, "s-", f"at {results[0].strain[-1]:.0%} stretch")):
            ratio = [result.tangent_modulus[at] / modulus for result, modulus in zip(results, moduli, strict=True)]
            right.loglog(band, ratio, style, color="0.25", markerfacecolor="white", markersize=7, label=label)
        measured = published("harris_2012")["modulus_ratio"]
        right.axhline(measured.low, color="#b5332a", linestyle=":", linewidth=2, label=measured.label)
        right.set_xlabel("bar force $f_b$ / nN")
        right.set_ylabel("tangent modulus of the sheet\nover apparent modulus of one cell")
        right.set_ylim(top=300.0)
        handles, labels = right.get_legend_handles_labels()
        right.legend(handles, labels, frameon=False, fontsize=11, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
        for axes in (left, right):
            tidy(axes)
        save_figure(figure, out / "band.png")
