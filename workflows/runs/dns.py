"""tsgdd dns: a sheet of blocks with every bar and tendon, stretched or sheared; the reference for all else.

Every step leaves checkpoint.h5 in the folder of results, from which the same run goes on if it was cut short;
summary.json says after which step, and its times are those of all parts but for the step that was lost. A run that has
finished removes it, so the next one in that folder begins anew; a summary.json that is there belongs to the files
beside it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tsg_micro.bodies.sheet import ClampedSheet, Motion, Sheet, SheetStep, memory_needed
from tsg_micro.bodies.sheet_means import block_data, block_displacement, row_balance
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.homogenise import BlockFields, block_fields
from tsg_micro.continuum.response import compressed_tendons
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from tsg_micro.data.mandel import pressure, von_mises
from tsg_micro.data.memory import available_memory
from tsg_micro.equilibrium.linear_solvers import choose_backend
from tsg_micro.figures.vtu import VtuSeries, write_vtu
from workflows.runs.loads import LOADS, check_load
from workflows.runs.progress import tracked
from workflows.store.checkpoint import (
    Checkpoint,
    LoadStep,
    fingerprint,
    latest_checkpoint,
    remove_checkpoint,
    write_checkpoint,
)
from workflows.store.limits import check_count
from workflows.store.record import peak_memory, versions, write_summary

__all__ = ["dns"]

Say = Callable[[str], None]


def dns(
    out: Path,
    *,
    blocks: tuple[int, int],
    load: str,
    strain: float,
    tissue: Tissue,
    flat: bool = False,
    steps: int = 4,
    linear_solver: str = "auto",
    plots: bool = True,
    say: Say = lambda text: None,
) -> dict[str, Any]:
    """Load a sheet of ``blocks`` (x, y) 2x2x2-cell blocks to ``strain``, in ``steps`` recorded steps, each stable.

    Writes blocks.h5 and blocks_kirchhoff.h5 (the block means as data sets), structure.vtu, structure.pvd of the
    load steps as they are done, figures and, last of all, summary.json into ``out``. ``flat`` is that of
    tsg_micro.bodies.sheet.Sheet.

    Raises:
        InputError: an argument is not valid, or the sheet needs more memory than there is.
        ConvergenceError: the equilibrium was lost.
    """
    check_load(load, strain)
    if min(blocks) < 1 or steps < 1:
        raise InputError(f"blocks, steps: expected at least 1, got {blocks[0]} {blocks[1]} and {steps}")
    check_count("steps", steps)
    sheet, motion = Sheet(blocks, 2, tissue, flat, linear_solver), LOADS[load].top_displacement(1.0, 1.0)
    _check_memory(sheet)
    out = output_folder(out)
    (out / "summary.json").unlink(missing_ok=True)  # an older run's
    scene = {"blocks": blocks, "load": load, "strain": strain, "bar_force": tissue.bar_force, "flat": flat}
    parameters = {**scene, "steps": steps, "linear_solver": linear_solver, **tissue.as_dict()}
    begin = time.perf_counter()
    body = ClampedSheet(sheet, motion)
    strains = [strain * number / steps for number in range(steps + 1)]
    series = VtuSeries(out / "structure.pvd", body.structure) if plots else None
    state, resumed = _follow(body, strains, out / "checkpoint.h5", fingerprint(parameters), begin, say, series)
    fields = block_fields(body.structure, state.displacement, body.members)
    data, kirchhoff = block_data(fields, parameters=scene | {"tissue": tissue.as_dict()}, versions=versions())
    write_dataset(out / "blocks.h5", data)
    write_dataset(out / "blocks_kirchhoff.h5", kirchhoff)
    figures = _figures(body, strains, state, fields, motion)
    figures |= {"resumed_after_step": (resumed, ""), "seconds": (_seconds(state, resumed, begin), "s")}
    if plots:
        _draw(out, body, state, data, strains)
    summary = write_summary(out, command="dns", parameters=parameters, figures=figures)
    remove_checkpoint(out / "checkpoint.h5")
    return summary


def _check_memory(sheet: Sheet) -> None:
    """Raise InputError where the linear solver is not known, or the sheet needs more memory than is available."""
    backend = choose_backend(sheet.unknowns, sheet.linear_solver).backend
    needed, available = memory_needed(sheet.unknowns, backend), available_memory()
    if available is not None and needed > available:
        raise InputError(
            f"blocks: {sheet.blocks[0]} x {sheet.blocks[1]} need about {needed / 1e9:.1f} GB of memory with {backend}, "
            f"{available / 1e9:.1f} GB are available"
        )


def _seconds(state: Checkpoint, resumed: int, begin: float) -> float:
    """Time since ``begin`` and that of the steps of an earlier part of the run."""
    return sum(step.seconds for step in state.done[:resumed]) + time.perf_counter() - begin


def _follow(
    body: ClampedSheet,
    strains: list[float],
    file: Path,
    run: str,
    begin: float,
    say: Say,
    series: VtuSeries | None,
) -> tuple[Checkpoint, int]:
    """Load the sheet to all ``strains`` after the first, rest, or after those of the checkpoint in ``file``.

    Returns where it ends, and how many steps had been done before; times count from ``begin``.
    """
    last = begin
    choice, steps = body.solver.newton.choice, len(strains) - 1
    say(f"{body.dofs} unknowns, {choice.backend} ({choice.reason})")
    state = latest_checkpoint(file, run, body.structure.nodes.shape, say)
    resumed = len(state.done)
    if resumed:
        say(f"going on after step {resumed} of {steps}")
        body.resume(state.displacement)
        if series:
            series.keep(resumed)
    for number in tracked(range(resumed + 1, steps + 1), "load steps"):
        result = body.load(strains[number])
        now = time.perf_counter()
        step, last = _record(result, now - last), now
        state = Checkpoint(result.state.displacement, (*state.done, step))
        if series:
            series.add(number, result.state)
        write_checkpoint(file, state, run)
        say(
            f"step {number} of {steps}: nominal stress {step.answer:.4g} Pa, {step.iterations} iterations, "
            f"{step.negative_pivots} negative pivots, {_seconds(state, resumed, begin):.0f} s"
        )
    return state, resumed


def _record(step: SheetStep, seconds: float) -> LoadStep:
    """What is kept of a load step."""
    result = step.state
    assert result.negative_pivots is not None  # a stable solution has been factorised
    return LoadStep(
        answer=step.nominal_stress,
        residual=result.residual,
        iterations=result.iterations,
        factorisations=result.factorisations,
        load_steps=result.load_steps,
        negative_pivots=result.negative_pivots,
        most_negative_pivots=max((i.negative_pivots for i in result.history), default=0),
        seconds=seconds,
        peak_memory=peak_memory(),
    )


def _figures(
    body: ClampedSheet, strains: list[float], state: Checkpoint, fields: BlockFields, motion: Motion
) -> dict[str, tuple[Any, str]]:
    """What the summary says of the sheet, and of how every recorded step converged."""
    done, structure, choice = state.done, body.structure, body.solver.newton.choice
    stresses = _stresses(state)
    figures = {
        "dofs": (body.dofs, ""),
        "cells": (len(structure.cells), ""),
        "nominal_stress": (stresses[-1], "Pa"),
        "strain_history": (strains, "1"),
        "nominal_stress_history": (stresses, "Pa"),
        "deflection": (float(np.abs(state.displacement[body.middle, 2]).max()), "m"),
        "row_balance": (row_balance(structure, fields, motion, stresses[-1]), "1"),
        "newton_iterations": (sum(step.iterations for step in done), ""),
        "factorisations": (sum(step.factorisations for step in done), ""),
        "load_steps": (sum(step.load_steps for step in done), ""),
        "negative_pivots": (done[-1].negative_pivots, ""),
        "most_negative_pivots": (max(step.most_negative_pivots for step in done), ""),
        "residual": (done[-1].residual, "mean member force"),
        "compressed_tendons": (compressed_tendons(structure, body.members), ""),
        "linear_solver": (choice.backend, ""),
        "linear_solver_reason": (choice.reason, ""),
        "peak_memory": (max(peak_memory(), *(step.peak_memory for step in done)), "B"),
    }
    units = {"residual": "mean member force", "seconds": "s"}
    for name in ("residual", "iterations", "factorisations", "negative_pivots", "most_negative_pivots", "seconds"):
        figures[f"step_{name}"] = ([getattr(step, name) for step in done], units.get(name, ""))
    if body.sheet.flat:
        figures["midplane_force"] = (body.midplane_force(), "mean member force")
    return figures


def _stresses(state: Checkpoint) -> list[float]:
    """Nominal stress at rest and after every step, Pa."""
    return [0.0, *(step.answer for step in state.done)]


def _draw(out: Path, body: ClampedSheet, state: Checkpoint, data: Dataset, strains: list[float]) -> None:
    """The figures and the file for ParaView."""
    from tsg_micro.data.figure_style import save_figure
    from tsg_micro.figures.data import plot_blocks, plot_curve
    from tsg_micro.figures.sheet import plot_sheet

    members = body.members
    write_vtu(out / "structure.vtu", body.structure, state.displacement, members)
    save_figure(plot_sheet(body.structure, state.displacement, members.force), out / "sheet.png")
    save_figure(plot_curve(strains, _stresses(state)), out / "stress_strain.png")
    p, q = pressure(data.stress), von_mises(data.stress)
    fields = {"pressure $p$": (p, "$p$ / Pa"), "effective stress $q$": (q, "$q$ / Pa")}
    assert data.midpoint is not None
    moved = block_displacement(body.structure, state.displacement)
    save_figure(plot_blocks(data.midpoint, fields, displacement=moved), out / "blocks.png")
