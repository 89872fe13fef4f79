"""tsgdd spheroid: a ball of blocks, prestressed towards its core, under pressure or shrunk at its surface."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tsg_micro.bodies.spheroid import Record, Spheroid, build_spheroid, record_state
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.continuum.radial_profiles import core_over_rim, radial_profile
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import atomic_path, output_folder
from tsg_micro.equilibrium.linear_solvers import choose_backend
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver
from tsg_micro.equilibrium.newton import NewtonOptions
from tsg_micro.equilibrium.rigid import rigid_border
from tsg_micro.equilibrium.tangent import lowest_stiffness
from workflows.store.record import peak_memory, write_summary

__all__ = ["LEVELS", "spheroid"]

LEVELS = {"pressure": 100.0, "displacement": 0.02}
"""Loads and their default levels: Pa, and a linear strain.

The pressure is of the order of the bar force at the rim over the area of a cell, exp(-2) 50 nN / (10 um)^2 = 68 Pa:
there the prestress decides the stiffness. Under several times that the members' own stiffness does, which is the same
everywhere, and the rise towards the core fades; the kPa of the experiments are beyond what cells of Table 1 bear.
"""


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
    cell: CellParameters | None = None,
    linear_solver: str = "auto",
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Compress a spheroid of blocks and find the radial stress of every block.

    The load is a ``pressure`` (Pa) that follows the surface, the free body kept by its mean displacement and rotation
    alone, or a ``displacement``: all surface nodes go towards the middle by ``level`` times their distance from it. It
    is recorded at ``steps`` equal levels, each a stable equilibrium; between them the step adapts. Where the
    equilibrium is lost the run ends with what was reached. Writes blocks.csv, summary.json, and with ``plots``
    figures, a VTU file for each level and spheroid.pvd into ``out``.

    Raises:
        InputError: an argument is not valid.
    """
    if load not in LEVELS:
        raise InputError(f"load: expected one of {', '.join(LEVELS)}, got {load!r}")
    level = LEVELS[load] if level is None else level
    if not (np.isfinite(level) and level > 0.0) or (load == "displacement" and level >= 1.0):
        limit = "" if load == "pressure" else " below 1"
        raise InputError(f"level: expected a positive number{limit} (compression), got {level}")
    if steps < 1:
        raise InputError(f"steps: expected at least 1, got {steps}")
    choose_backend(1, linear_solver)
    begin = time.perf_counter()
    cell = cell or CellParameters()
    body = build_spheroid(radius=radius, f_max=f_max, profile=profile, decay=decay, cell=cell)
    out = output_folder(out)
    solver = _solver(body, load, linear_solver)
    say(f"{solver.newton.pattern.size} unknowns, {solver.newton.choice.backend} ({solver.newton.choice.reason})")

    def note(record: Record) -> None:
        state = record.state
        say(
            f"{load} {record.level:.4g}: volume {record.volume / records[0].volume:.4f}, {state.iterations} iterations,"
            f" {state.negative_pivots} negative pivots, {time.perf_counter() - begin:.0f} s"
        )

    records = [record_state(body, 0.0, solver.solve(stable=True))]
    reason = "the level asked for"
    for step in range(1, steps + 1):
        reached, lost = _advance(solver, body, load, (level * (step - 1) / steps, level * step / steps))
        records += [record_state(body, *reached)] if reached else []
        if reached:
            note(records[-1])
        if lost:
            reason = lost
            say(f"stopped: {lost}")
            break
    stiffness = lowest_stiffness(solver.tangent()) if records[-1].level < level else None
    seconds = time.perf_counter() - begin
    _write_blocks(out / "blocks.csv", body, records)
    summary = write_summary(
        out,
        command="spheroid",
        parameters={
            "radius": radius,
            "f_max": f_max,
            "profile": profile,
            "decay": decay,
            "load": load,
            "level": level,
            "steps": steps,
            "linear_solver": linear_solver,
            "cell": asdict(cell),
        },
        figures={
            **_counts(body),
            "dofs": (solver.newton.pattern.size, ""),
            "level": (level, _unit(load)),
            "reached": (records[-1].level, _unit(load)),
            "reason": (reason, ""),
            "lowest_stiffness": (stiffness, "N/m"),
            **_path(body, records, load),
            **_radial(body, records),
            "factorisations": (solver.newton.factorisations, ""),
            "linear_solver": (solver.newton.choice.backend, ""),
            "linear_solver_reason": (solver.newton.choice.reason, ""),
            "seconds": (seconds, "s"),
            "peak_memory": (peak_memory(), "B"),
        },
    )
    if plots:
        from workflows.runs.spheroid_figures import draw_spheroid

        draw_spheroid(out, body, records, load)
    return summary


def _unit(load: str) -> str:
    return "Pa" if load == "pressure" else "1"


def _solver(body: Spheroid, load: str, linear_solver: str) -> EquilibriumSolver:
    """A solver of the free body under pressure, or of the one whose surface is prescribed."""
    options = NewtonOptions(max_iterations=25, smallest_part=1.0 / 16.0, linear_solver=linear_solver)
    fixed = np.zeros(body.structure.nodes.shape, dtype=bool)
    if load == "pressure":
        border = rigid_border(body.structure)
        return EquilibriumSolver(body.structure, fixed=fixed, border=border, surface=body.surface, options=options)
    fixed[body.surface.nodes] = True
    return EquilibriumSolver(body.structure, fixed=fixed, options=options)


def _advance(
    solver: EquilibriumSolver, body: Spheroid, load: str, levels: tuple[float, float]
) -> tuple[tuple[float, Equilibrium] | None, str]:
    """Go from one level to the next: the level reached with its equilibrium, if any is new, and why it was lost."""
    start, goal = levels
    done = [0.0]
    try:
        if load == "pressure":
            return (goal, solver.solve(pressure=goal, stable=True, progress=done.append)), ""
        centred = body.structure.nodes - body.structure.nodes.mean(axis=0)
        moved = np.zeros_like(centred)
        moved[body.surface.nodes] = -goal * centred[body.surface.nodes]
        return (goal, solver.solve(displacement=moved, stable=True, progress=done.append)), ""
    except ConvergenceError as error:
        lost = str(error)
    if done[-1] == 0.0:
        return None, lost
    try:  # the last equilibrium on the way, if it is stable
        return (start + done[-1] * (goal - start), solver.solve(stable=True)), lost
    except ConvergenceError:
        return None, lost


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


def _path(body: Spheroid, records: list[Record], load: str) -> dict[str, tuple[Any, str]]:
    """How the equilibrium went from level to level."""
    tendons = ~body.structure.bars
    states = [record.state for record in records]
    last = states[-1]
    return {
        "level_history": ([record.level for record in records], _unit(load)),
        "residual_history": ([state.residual for state in states], "mean member force"),
        "iterations_history": ([state.iterations for state in states], ""),
        "load_steps_history": ([state.load_steps for state in states], ""),
        "negative_pivots_history": ([state.negative_pivots for state in states], ""),
        "most_negative_pivots": (max((i.negative_pivots for s in states for i in s.history), default=0), ""),
        "slack_tendons": (last.slack, ""),
        "compressed_tendons": (int((last.members.force[tendons] < 0.0).sum()), ""),
        "lowest_tendon_force": (float(last.members.force[tendons].min()), "N"),
        "support_force": (float(np.abs(last.reaction).max() / np.abs(last.members.force).mean()), "mean member force"),
        "volume_history": ([record.volume for record in records], "m^3"),
        "volume_change": (records[-1].volume / records[0].volume - 1.0, "1"),
        "equivalent_pressure_history": ([_mean_pressure(record) for record in records], "Pa"),
    }


def _mean_pressure(record: Record) -> float:
    """-tr / 3 of the mean Cauchy stress over the enclosed volume; under a pressure that pressure itself."""
    members = record.state.members
    return float(-(members.force * members.length).sum() / (3.0 * record.volume))


def _radial(body: Spheroid, records: list[Record]) -> dict[str, tuple[Any, str]]:
    """Radial stress: profiles, and whether its compression rises towards the core."""
    before, last = records[0].stress, records[-1].stress
    figures: dict[str, tuple[Any, str]] = {}
    for name, values in (
        ("sigma_rr", last.cauchy),
        ("sigma_rr_before", before.cauchy),
        ("sigma_rr_difference", last.cauchy - before.cauchy),
        ("tau_rr", last.kirchhoff),
        ("sigma_rr_halves", last.halves),
        ("sigma_rr_halves_before", before.halves),
    ):
        profile = radial_profile(body.r, values, shells=body.shells)
        figures[name] = ({"mean": profile.mean, "std": profile.std}, "Pa")
        figures["r_over_R"], figures["blocks_in_shell"] = (profile.r, "1"), (profile.count, "")
    shells = [radial_profile(body.r, record.stress.cauchy, shells=body.shells).mean for record in records[1:]]
    rises = [bool((np.diff(mean) > 0.0).all()) for mean in shells]
    return figures | {
        "sigma_rr_largest": (float(np.abs(last.cauchy).max()), "Pa"),
        "rises_to_core": (rises[-1] if rises else None, ""),
        "rises_to_core_history": (rises, ""),
        "core_over_rim": (core_over_rim(body.r, last.cauchy) if len(records) > 1 else None, "1"),
        "core_over_rim_history": ([core_over_rim(body.r, record.stress.cauchy) for record in records[1:]], "1"),
        "core_over_rim_halves_history": ([core_over_rim(body.r, record.stress.halves) for record in records[1:]], "1"),
    }


def _write_blocks(path: Path, body: Spheroid, records: list[Record]) -> None:
    """One line a block: where it is, its bar force, and its radial stress before and after."""
    before, last = records[0].stress, records[-1].stress
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
