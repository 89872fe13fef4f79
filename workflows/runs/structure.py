"""tsgdd structure: build a lattice of cells, check its self-stress, draw it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from tsg_micro.cells.lattice import box_cells, spheroid_cells
from tsg_micro.cells.prestress import force_density_of_cells, out_of_balance, prestressed
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from tsg_micro.equilibrium.members import MemberSystem
from tsg_micro.equilibrium.self_stress_counts import self_stress_counts
from workflows.store.limits import check_memory
from workflows.store.record import write_summary

__all__ = ["structure"]

_PER_CELL = 1e4
"""Bytes, roughly: nodes, members and their equilibrium matrix."""


def structure(
    out: Path,
    *,
    cells: tuple[int, int, int] | None = None,
    shape: str = "box",
    radius: float | None = None,
    tissue: Tissue = Tissue(),
    plots: bool = True,
) -> dict[str, Any]:
    """Build a box of cells, or a spheroid of 2x2x2 blocks; figures and a ParaView file go to ``out``.

    Raises:
        InputError: an argument is not valid, or arguments of two shapes are mixed.
    """
    if shape not in ("box", "spheroid"):
        raise InputError(f"shape: expected box or spheroid, got {shape!r}")
    if shape == "spheroid" and (radius is None or cells is not None):
        raise InputError("shape spheroid: expected --radius in blocks, and no --cells")
    if shape == "box" and (cells is None or radius is not None):
        raise InputError("shape box: expected --cells NX NY NZ, and no --radius")
    count: float = math.prod(cells or (1, 1, 1))
    if radius is not None:
        count = 8 * 4.19 * min(max(radius, 0.0), 1e30) ** 3 if math.isfinite(radius) else 0.0
    check_memory(f"cells: {count:.3g}", _PER_CELL * count)
    where = spheroid_cells(radius) if radius is not None else box_cells(*(cells or (1, 1, 1)))
    built = prestressed(tissue.lattice(where), tissue.cell, tissue.bar_force)
    out = output_folder(out)
    residual = out_of_balance(built, force_density_of_cells(built, tissue.cell, tissue.bar_force)) / tissue.bar_force
    states, mechanisms, method = self_stress_counts(built)
    summary = write_summary(
        out,
        command="structure",
        parameters={
            "shape": shape,
            "cells": cells,
            "radius": radius,
            "bar_force": tissue.bar_force,
            "half_diagonal": tissue.cell.half_diagonal,
        },
        figures={
            "nodes": (len(built.nodes), ""),
            "bars": (int(built.bars.sum()), ""),
            "tendons": (int((~built.bars).sum()), ""),
            "cells": (len(built.cells), ""),
            "blocks": (len(built.blocks), ""),
            "self_stress_states": (states, ""),
            "mechanisms": (mechanisms, ""),
            "self_stress_method": (method, ""),
            "equilibrium_residual": (residual, "bar force"),
        },
    )
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from tsg_micro.data.voxels import voxel_body
        from tsg_micro.figures.parts import is_deep
        from tsg_micro.figures.space import View, plot_body
        from tsg_micro.figures.voxels import plot_voxels
        from tsg_micro.figures.vtu import write_vtu

        system = MemberSystem(built)
        write_vtu(out / "structure.vtu", built, np.zeros_like(built.nodes), system.state(np.zeros(system.size)))
        save_figure(plot_body(built, [View()], width=8.0), out / "structure.png")
        if is_deep(built):
            blocks = voxel_body(built.blocks)
            shape = plot_voxels(blocks, 2.0 * built.height, np.zeros(len(built.blocks)), ["tissue"])
            save_figure(shape, out / "blocks.png")
    return summary
