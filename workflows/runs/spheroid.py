"""tsgdd spheroid: a ball of blocks, prestressed towards its core, under pressure or shrunk at its surface."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tsg_micro.bodies.sheet import memory_needed
from tsg_micro.bodies.spheroid import (
    LOADS,
    Compression,
    Spheroid,
    build_spheroid,
    check_spheroid_load,
    compress_spheroid,
)
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.response import compressed_tendons
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path, output_folder
from tsg_micro.equilibrium.linear_solvers import choose_backend
from workflows.runs.progress import progress
from workflows.store.limits import check_count, check_memory
from workflows.store.record import peak_memory, write_summary

__all__ = ["LEVELS", "spheroid"]

LEVELS = {"pressure": 100.0, "displacement": 0.02}
"""Loads to their default levels: Pa, and a linear strain.

The pressure is of the order of the bar force at the rim over the area of a cell, exp(-2) 50 nN / (10 um)^2 = 68 Pa:
there the prestress decides the stiffness. Under several times that the members' own stiffness does, which is the same
everywhere, and the rise towards the core fades; the kPa of the experiments are beyond what cells of Table 1 bear.
"""

_UNKNOWNS = 4.19 * 8 * 39
"""Of a body of radius 1: cells in a ball, and unknowns a cell."""


def spheroid(
    out: Path,
    *,
    radius: float = 5.0,
    f_max: float = 5e-8,
    profile: str = "exponential",
    decay: float = 2.0,
    load: str = "pressure",
    level: float | None = None,
    steps: int = 5,
    tissue: Tissue = Tissue(),
    linear_solver: str = "auto",
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Compress a spheroid of blocks and find the radial stress of every block.

    The load is a ``pressure`` (Pa) that follows the surface, the free body kept by its mean displacement and rotation
    alone, or a ``displacement``: all surface nodes go towards the middle by ``level`` times their distance from it. It
    is recorded at ``steps`` equal levels, each a stable equilibrium; between them the step adapts. Where the
    equilibrium is lost the run ends with what was reached. The cells are those of ``tissue``, their bar force ``f_max``
    (N) at the centre. Writes blocks.csv, summary.json, and with ``plots`` figures, a VTU file for each level and
    spheroid.pvd into ``out``.

    Raises:
        InputError: an argument is not valid.
    """
    level = _check(load, level, steps, f_max)
    unknowns = int(_UNKNOWNS * min(max(radius, 1.0), 1e9) ** 3)
    backend = choose_backend(min(unknowns, 10**9), linear_solver).backend
    check_memory(f"radius: {radius:g} blocks", memory_needed(unknowns, backend))
    begin = time.perf_counter()
    tissue = replace(tissue, bar_force=f_max)
    parameters = {**tissue.as_dict(), "radius": radius, "f_max": f_max, "profile": profile, "decay": decay}
    parameters |= {"load": load, "level": level, "steps": steps, "linear_solver": linear_solver}
    body = build_spheroid(tissue, radius=radius, profile=profile, decay=decay)
    out = output_folder(out)
    levels = level * np.arange(1, steps + 1) / steps
    with progress("levels", steps) as told:
        result = compress_spheroid(body, load, levels, linear_solver=linear_solver, say=say, progress=told)
    reached = result.records[-1].level
    stiffness = result.lowest_stiffness() if reached < level else None
    seconds = time.perf_counter() - begin
    _write_blocks(out / "blocks.csv", result)
    unit, newton = LOADS[load], result.solver.newton
    summary = write_summary(
        out,
        command="spheroid",
        parameters=parameters,
        figures={
            **_counts(body),
            "dofs": (newton.pattern.size, ""),
            "level": (level, unit),
            "reached": (reached, unit),
            "reason": (result.reason, ""),
            "lowest_stiffness": (stiffness, "N/m"),
            **_path(result),
            **_radial(result),
            "factorisations": (newton.factorisations, ""),
            "linear_solver": (newton.choice.backend, ""),
            "linear_solver_reason": (newton.choice.reason, ""),
            "seconds": (seconds, "s"),
            "peak_memory": (peak_memory(), "B"),
        },
    )
    if plots:
        from tsg_micro.figures.spheroid import draw_spheroid

        draw_spheroid(out, result)
    return summary


def _check(load: str, level: float | None, steps: int, f_max: float) -> float:
    """The level to reach, the load's own where none is given.

    Raises:
        InputError: an argument is not valid.
    """
    check_spheroid_load(load)
    level = LEVELS[load] if level is None else level
    if not (np.isfinite(level) and level > 0.0) or (load == "displacement" and level >= 1.0):
        limit = "" if load == "pressure" else " below 1"
        raise InputError(f"level: expected a positive number{limit} (compression), got {level}")
    check_count("steps", steps)
    if not (np.isfinite(f_max) and f_max > 0.0):
        raise InputError(f"f_max: expected a positive force in N, got {f_max}")
    return level


def _counts(body: Spheroid) -> dict[str, tuple[Any, str]]:
    """The paper's Table 2, and the surface."""
    structure = body.structure
    numbers = {
        "blocks": len(structure.blocks),
        "cells": len(structure.cells),
        "bars": int(structure.bars.sum()),
        "tendons": int((~structure.bars).sum()),
        "nodes": len(structure.nodes),
        "surface_nodes": len(body.surface.nodes),
    }
    return {name: (number, "") for name, number in numbers.items()}


def _path(result: Compression) -> dict[str, tuple[Any, str]]:
    """How the equilibrium went from level to level."""
    records, tendons = result.records, ~result.body.structure.bars
    states = [record.state for record in records]
    last = states[-1]
    return {
        "level_history": ([record.level for record in records], LOADS[result.load]),
        "residual_history": ([state.residual for state in states], "mean member force"),
        "iterations_history": ([state.iterations for state in states], ""),
        "load_steps_history": ([state.load_steps for state in states], ""),
        "negative_pivots_history": ([state.negative_pivots for state in states], ""),
        "most_negative_pivots": (max((i.negative_pivots for s in states for i in s.history), default=0), ""),
        "slack_tendons": (last.slack, ""),
        "compressed_tendons": (compressed_tendons(result.body.structure, last.members), ""),
        "lowest_tendon_force": (float(last.members.force[tendons].min()), "N"),
        "support_force": (float(np.abs(last.reaction).max() / np.abs(last.members.force).mean()), "mean member force"),
        "volume_history": ([record.volume for record in records], "m^3"),
        "volume_change": (records[-1].volume / records[0].volume - 1.0, "1"),
        "equivalent_pressure_history": ([record.mean_pressure for record in records], "Pa"),
    }


def _radial(result: Compression) -> dict[str, tuple[Any, str]]:
    """Radial stress: profiles, and whether its compression rises towards the core."""
    before, last = result.records[0].stress, result.records[-1].stress
    figures: dict[str, tuple[Any, str]] = {}
    for name, values in (
        ("sigma_rr", last.cauchy),
        ("sigma_rr_before", before.cauchy),
        ("sigma_rr_difference", last.cauchy - before.cauchy),
        ("tau_rr", last.kirchhoff),
        ("sigma_rr_halves", last.halves),
        ("sigma_rr_halves_before", before.halves),
    ):
        profile = result.body.profile(values)
        figures[name] = ({"mean": profile.mean, "std": profile.std}, "Pa")
        figures["r_over_R"], figures["blocks_in_shell"] = (profile.r, "1"), (profile.count, "")
    shells = [result.body.profile(record.stress.cauchy).mean for record in result.records[1:]]
    ratios = result.core_over_rim()
    rises = [bool((np.diff(mean) > 0.0).all()) for mean in shells]
    return figures | {
        "sigma_rr_largest": (float(np.abs(last.cauchy).max()), "Pa"),
        "rises_to_core": (rises[-1] if rises else None, ""),
        "rises_to_core_history": (rises, ""),
        "core_over_rim": (ratios[-1] if ratios else None, "1"),
        "core_over_rim_history": (ratios, "1"),
        "core_over_rim_halves_history": (result.core_over_rim("halves"), "1"),
    }


def _write_blocks(path: Path, result: Compression) -> None:
    """One line a block: where it is, its bar force, and its radial stress before and after."""
    body, before, last = result.body, result.records[0].stress, result.records[-1].stress
    columns = {
        "x_m": last.midpoint[:, 0],
        "y_m": last.midpoint[:, 1],
        "z_m": last.midpoint[:, 2],
        "r_over_R": body.r,
        "bar_force_N": body.bar_force,
        "volume_ratio": last.J,
        "sigma_rr_before_Pa": before.cauchy,
        "sigma_rr_Pa": last.cauchy,
        "tau_rr_Pa": last.kirchhoff,
        "sigma_rr_halves_before_Pa": before.halves,
        "sigma_rr_halves_Pa": last.halves,
    }
    with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
