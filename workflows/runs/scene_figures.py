"""The figures of a solution of a scene file, from what was written: fields on slices, and the steps of the load."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

import dd_macro as dd
from dd_macro.results.history_figures import history_figures
from tsg_micro.data.figure_style import (
    MICRO,
    ROUND_OFF,
    STYLE,
    new_figure,
    plot_maps,
    save_figure,
    tidy,
    without_round_off,
)
from tsg_micro.data.slices import plot_slices, slices_of_cells
from tsg_micro.figures.hexahedra import plot_hexahedra

__all__ = ["draw_scene", "draw_solution"]

_FLAT = 1.5
"""Thickness over the edge of its elements up to which a body is drawn as a map."""
_P, _Q = "pressure $p$", "effective stress $q$"
_DISTANCE = r"distance / $\sqrt{\mathrm{J/m^3}}$"


def draw_solution(out: Path, solution: dd.Solution) -> None:
    """Write fields.png, space.png of a body in space, and the figures of the method, from quadrature.h5; rank 0 only.

    Bodies are drawn deformed, to scale.
    """
    fields = dd.read_quadrature(out / "quadrature.h5")
    q = fields.cell_mean(fields.mechanical_q)
    p, material = (
        without_round_off(fields.cell_mean(values), float(q.max()))
        for values in (fields.mechanical_p, fields.material_p)
    )
    if solution.normalised_distance > ROUND_OFF:
        shown = {f"{_P}, mechanical": (p, "$p$ / Pa"), f"{_P}, material": (material, "$p$ / Pa")}
        shown |= {f"{_Q}, mechanical": (q, "$q$ / Pa")}
        shown |= {"local distance to the data": (fields.cell_mean(fields.local_distance), _DISTANCE)}
    else:
        shown = {_P: (p, "$p$ / Pa"), _Q: (q, "$q$ / Pa")}
    corners, z = fields.deformed_corners, fields.corners[..., 2]
    if np.ptp(z) <= _FLAT * np.ptp(z, axis=1).max():
        save_figure(plot_maps(corners[:, :4, :2], shown), out / "fields.png")
    else:
        save_figure(plot_slices(slices_of_cells(fields.corners, corners), shown), out / "fields.png")
        save_figure(plot_hexahedra(corners, p, f"{_P} / Pa"), out / "space.png")
    for name, figure in history_figures(solution).items():
        save_figure(figure, out / f"{name}.png")


def draw_scene(out: Path, solution: dd.Solution, rows: list[dict[str, Any]]) -> None:
    """The same of a scene file, and steps.png where its load has several."""
    draw_solution(out, solution)
    if len(rows) > 1:
        _draw_steps(out, rows)


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
        reach = float(np.abs(moved[side]).max())
        for axis, style, column in zip("xyz", ("o-", "s--", "^:"), moved[side].T, strict=True):
            left.plot(load, MICRO * without_round_off(column, reach), style, label=f"$u_{axis}$")
        left.set(xlabel="part of the load", ylabel=f"mean displacement of {side} / µm")
        left.legend()
        right.plot(load, 100.0 * np.array([0.0, *(row["volume_change"] for row in rows)]), "o-")
        right.set(xlabel="part of the load", ylabel="change of volume / %")
        for axes in (left, right):
            tidy(axes)
        save_figure(figure, out / "steps.png")
