"""The one figure of the demo: cells, data, and the pressure by both routes; drawn from the files of the run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import meshio
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dd_macro.results.compare import BlockStress, match_blocks
from dd_macro.results.quadrature_file import QuadratureFields, read_quadrature
from tsg_micro.cells.unit_cell import BAR
from tsg_micro.data.dataset import convert_dataset
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.figure_style import FIELD, MICRO, STYLE, colour_bar, draw_field, limits, new_figure
from tsg_micro.data.mandel import pressure
from tsg_micro.figures.sheet import force_scale

__all__ = ["plot_demo"]

Array = NDArray[np.float64]
_WINDOW = 2.2e-5  # m, the height of the part whose members are drawn, twice as wide
_MOST_ERROR = 20.0  # percent, the end of the error scale


def plot_demo(folder: Path, *, strain: float, errors: dict[str, Any]) -> Figure:
    """Six panels from the run in ``folder``: members, data with the states found, error; pressure three times."""
    fields = read_quadrature(folder / "dd" / "quadrature.h5")
    measure = fields.stress_measure
    blocks = convert_dataset(read_dataset(folder / "dns" / "blocks.h5"), measure)
    data = convert_dataset(read_dataset(folder / "data.h5"), measure)
    assert blocks.midpoint is not None
    mechanical, material = fields.cell_mean(fields.mechanical_stress), fields.cell_mean(fields.material_stress)
    found = match_blocks(
        BlockStress(fields.midpoint, mechanical, measure), BlockStress(blocks.midpoint, blocks.stress, measure)
    )
    reference = pressure(blocks.stress)[found]
    inner, everywhere = (
        {name: errors[key.format(name)][kind] for name in ("mech", "mat")}
        for key, kind in (("error_p_{}", "l2"), ("boundary_p_{}", "error"))
    )
    said = {name: f"{inner[name]:.1%} off inside, {everywhere[name][0]:.1%} in all" for name in inner}
    panels = {
        f"full tensegrity, {strain:.0%} stretch": reference,
        f"mechanical: {said['mech']}": pressure(mechanical),
        f"material: {said['mat']}": pressure(material),
    }
    ends = limits(list(panels.values()))
    outline = fields.deformed_corners[:, :4, :2]
    with mpl.rc_context({**STYLE, "font.size": 12}):
        figure = new_figure(17, 6.6)
        grid = figure.subplots(2, 3)
        _draw_members(figure, grid[0, 0], folder / "dns" / "structure.vtu")
        _draw_data(figure, grid[0, 1], data.strain, data.stress, fields)
        error = 100.0 * np.abs(pressure(mechanical) - reference) / np.abs(reference)
        drawn = draw_field(grid[0, 2], outline, error, (0.0, _MOST_ERROR), "magma")
        colour_bar(figure, drawn, grid[0, 2], "error of $p$ / %", extend="max")
        grid[0, 2].set_title("c  error of every block, e against d", loc="left")
        for axes in (grid[0, 2], *grid[1]):
            axes.set_xlabel("$x$ / µm")
            axes.set_ylabel("$y$ / µm")
        for letter, axes, (title, values) in zip("def", grid[1], panels.items(), strict=True):
            drawn = draw_field(axes, outline, values, ends, FIELD)
            axes.set_title(f"{letter}  {title}", loc="left")
            colour_bar(figure, drawn, axes, "pressure $p$ / Pa")
    return figure


def _draw_members(figure: Figure, axes: Axes, path: Path) -> None:
    """Members near the upper right corner of the deformed sheet, coloured by force."""
    mesh = meshio.read(path)
    ends = MICRO * mesh.points[mesh.cells[0].data]
    force, kind = 1e9 * mesh.cell_data["force"][0], mesh.cell_data["kind"][0]
    high = ends.reshape(-1, 3).max(axis=0)
    low = high - MICRO * _WINDOW * np.array([2.0, 1.0, 1.0])
    near = (ends[..., :2].max(axis=1) > low[:2]).all(axis=1)
    near &= ends[..., 2].min(axis=1) > 0.5 * high[2]  # of the two layers of cells the upper one
    order = np.flatnonzero(near)[np.argsort(ends[near][..., 2].mean(axis=1))]
    bars = kind[order] == BAR
    scale, _ = force_scale(force)
    lines = LineCollection(
        list(ends[order][..., :2]),
        colors=scale.to_rgba(force[order]),
        linewidths=np.where(bars, 1.6, 3.5),
        capstyle="round",
    )
    axes.add_collection(lines)
    axes.set_xlim(low[0], high[0] + 1.0)
    axes.set_ylim(low[1], high[1] + 1.0)
    axes.set_aspect("equal")
    axes.set_xlabel("$x$ / µm")
    axes.set_ylabel("$y$ / µm")
    axes.set_title("a  full tensegrity, a corner from above", loc="left")
    colour_bar(figure, scale, axes, "member force / nN", extend="both")


def _draw_data(figure: Figure, axes: Axes, strain: Array, stress: Array, fields: QuadratureFields) -> None:
    """The material data, and the states that the macroscopic solution takes."""
    cloud = axes.scatter(
        100 * strain[:, 1], stress[:, 1], c=100 * strain[:, 0], s=5, cmap="cividis", linewidths=0, rasterized=True
    )
    axes.plot(
        100 * fields.mechanical_strain[..., 1].ravel(),
        fields.mechanical_stress[..., 1].ravel(),
        ".",
        color="#c8102e",
        markersize=2.5,
        label="mechanical states",
        rasterized=True,
    )
    axes.set_xlabel(r"$\varepsilon_{yy}$ / %")
    axes.set_ylabel(r"$P_{yy}$ / Pa")
    axes.legend(frameon=False, markerscale=4, loc="upper left")
    axes.set_title(f"b  {len(strain)} RVE states, and the solution", loc="left")
    axes.set_box_aspect(0.5)
    colour_bar(figure, cloud, axes, r"$\varepsilon_{xx}$ of the data / %")
