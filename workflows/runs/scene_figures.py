"""The figures of a solution of a scene file, from what was written: fields on slices, and the steps of the load."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

import dd_macro as dd
from dd_macro.results.history_figures import history_figures
from tsg_micro.data.figure_style import MICRO, STYLE, new_figure, plot_maps, save_figure, tidy
from tsg_micro.data.slices import plot_slices, slices_of_cells
from tsg_micro.figures.hexahedra import plot_hexahedra

__all__ = ["draw_scene"]

_FLAT, _ROUND_OFF = 1.5, 1e-9
"""Thickness over the edge of its elements up to which a body is drawn as a map, and what a distance is that is none."""


def draw_scene(out: Path, solution: dd.Solution, rows: list[dict[str, Any]]) -> None:
    """Write fields.png, space.png of a body in space, steps.png where there are several, and those of the method."""
    fields = dd.read_quadrature(out / "quadrature.h5")
    shown = {
        "pressure $p$": (fields.cell_mean(fields.mechanical_p), "Pa"),
        "effective stress $q$": (fields.cell_mean(fields.mechanical_q), "Pa"),
    }
    if solution.normalised_distance > _ROUND_OFF:
        shown["local distance to the data"] = (fields.cell_mean(fields.local_distance), r"$\sqrt{\mathrm{J/m^3}}$")
    z = fields.corners[..., 2]
    if np.ptp(z) <= _FLAT * np.ptp(z, axis=1).max():
        save_figure(plot_maps(fields.corners[:, :4, :2], shown), out / "fields.png")
    else:
        save_figure(plot_slices(slices_of_cells(fields.corners), shown), out / "fields.png")
        pressure, unit = shown["pressure $p$"]
        save_figure(plot_hexahedra(fields.corners, pressure, f"pressure $p$ / {unit}"), out / "space.png")
    if len(rows) > 1:
        _draw_steps(out, rows)
    for name, figure in history_figures(solution).items():
        save_figure(figure, out / f"{name}.png")


def _draw_steps(out: Path, rows: list[dict[str, Any]]) -> None:
    """Mean displacement of the side that moves most, and the change of volume, over the load."""
    load = np.array([0.0, *(row["factor"] for row in rows)])
    moved = {
        side: np.array([[0.0] * 3, *(row["displacements"][side] for row in rows)]) for side in rows[0]["displacements"]
    }
    side = max(moved, key=lambda name: float(np.abs(moved[name]).max()))
    with mpl.rc_context(STYLE):
        figure = new_figure(10.0, 4.2)
        left, right = figure.subplots(1, 2)
        for axis, column in zip("xyz", moved[side].T, strict=True):
            left.plot(load, MICRO * column, "o-", label=f"$u_{axis}$")
        left.set(xlabel="part of the load", ylabel=f"mean displacement of {side} / µm")
        left.legend()
        right.plot(load, 100.0 * np.array([0.0, *(row["volume_change"] for row in rows)]), "o-")
        right.set(xlabel="part of the load", ylabel="change of volume / %")
        for axes in (left, right):
            tidy(axes)
        save_figure(figure, out / "steps.png")
