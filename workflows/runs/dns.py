"""tsgdd dns: a sheet of blocks with every bar and tendon, stretched or sheared; the reference for all else."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import box_cells, lattice, side_nodes
from tsg_micro.cells.parameters import CellParameters, check_bar_force
from tsg_micro.cells.prestress import prestressed
from tsg_micro.cells.structure import Structure
from tsg_micro.continuum.homogenise import BlockFields, block_fields
from tsg_micro.data.dataset import Dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from tsg_micro.data.mandel import pressure, to_mandel, von_mises
from tsg_micro.equilibrium.linear_solvers import choose_backend
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver
from tsg_micro.equilibrium.members import MACRO, MemberState
from tsg_micro.equilibrium.newton import NewtonOptions
from workflows.runs.loads import LOADS, check_load, top_displacement
from workflows.store.checkpoint import (
    Checkpoint,
    LoadStep,
    fingerprint,
    read_checkpoint,
    remove_checkpoint,
    write_checkpoint,
)
from workflows.store.record import peak_memory, versions, write_summary

__all__ = ["dns", "memory_needed"]

Array = NDArray[np.float64]
_FILL = {"pardiso": 1.0, "mumps": 1.1, "superlu": 6.0}


def dns(
    out: Path,
    *,
    blocks: tuple[int, int],
    load: str,
    strain: float,
    bar_force: float,
    flat: bool = False,
    steps: int = 4,
    linear_solver: str = "auto",
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Load a sheet of ``blocks`` (x, y) 2x2x2-cell blocks to ``strain``, in ``steps`` recorded steps.

    The result is stable: an unstable equilibrium is left downhill, so a sheet that buckles does. With ``flat`` the
    nodes of the mid-plane cannot leave it; by symmetry they need no force for that, so the result is an equilibrium of
    the free sheet too, the one that a model without buckling can be compared with.

    Writes blocks.h5 and blocks_kirchhoff.h5 (the block means as data sets), structure.vtu, figures and, last of all,
    summary.json into ``out``.

    Every step leaves checkpoint.h5 there, from which the same run goes on if it was cut short; summary.json says
    after which step, and its times are those of all parts but for the step that was lost. A run that has finished
    removes it, so the next one in that folder begins anew; a summary.json that is there belongs to the files beside it.

    Raises:
        InputError: an argument is not valid, or the sheet needs more memory than there is.
        ConvergenceError: the equilibrium was lost.
    """
    check_load(load, strain)
    cell = CellParameters()
    check_bar_force(bar_force, cells=1, EA_bar=cell.EA_bar)
    if min(blocks) < 1 or steps < 1:
        raise InputError(f"blocks, steps: expected at least 1, got {blocks[0]} {blocks[1]} and {steps}")
    _check_memory(blocks, linear_solver)
    out = output_folder(out)
    (out / "summary.json").unlink(missing_ok=True)  # an older run's
    scene = {"blocks": blocks, "load": load, "strain": strain, "bar_force": bar_force, "flat": flat}
    parameters = {**scene, "steps": steps, "linear_solver": linear_solver, "cell": asdict(cell)}
    file, run = out / "checkpoint.h5", fingerprint(parameters)

    begin = last = time.perf_counter()
    sheet = prestressed(lattice(box_cells(2 * blocks[0], 2 * blocks[1], 2), cell), cell, bar_force)
    bottom, top = side_nodes(sheet, 1, end="low"), side_nodes(sheet, 1, end="high")
    fixed = np.zeros(sheet.nodes.shape, dtype=bool)
    fixed[bottom] = fixed[top] = True
    middle = np.isclose(sheet.nodes[:, 2], 0.5 * (sheet.nodes[:, 2].min() + sheet.nodes[:, 2].max()), atol=1e-12)
    loose = middle & ~fixed[:, 2]
    fixed[loose, 2] = flat
    solver = EquilibriumSolver(sheet, fixed=fixed, options=NewtonOptions(linear_solver=linear_solver))
    choice = solver.newton.choice
    say(f"{solver.newton.pattern.size} unknowns, {choice.backend} ({choice.reason})")
    area = sheet.size[0] * sheet.size[2]
    state = _start(file, run, sheet.nodes.shape, say)
    resumed, seconds_before = len(state.done), sum(step.seconds for step in state.done)
    if resumed:
        say(f"going on after step {resumed} of {steps}")
        solver.move_to(np.append(state.displacement, np.zeros(MACRO)), solver.force)
    moved = np.zeros(sheet.nodes.shape)
    for number in range(resumed + 1, steps + 1):
        moved[top] = top_displacement(load, strain * number / steps, sheet.size[1])
        result = solver.solve(displacement=moved, stable=True)
        now = time.perf_counter()
        step = _record(result, float(result.reaction[top, LOADS[load]].sum() / area), now - last)
        last = now
        state = Checkpoint(result.displacement, (*state.done, step))
        write_checkpoint(file, state, run)
        say(
            f"step {number} of {steps}: nominal stress {step.nominal_stress:.4g} Pa, {step.iterations} iterations, "
            f"{step.negative_pivots} negative pivots, {seconds_before + now - begin:.0f} s"
        )
    done, members = state.done, solver.system.state(solver.y)
    fields = block_fields(sheet, state.displacement, members)
    data, kirchhoff = _block_data(fields, scene)
    write_dataset(out / "blocks.h5", data)
    write_dataset(out / "blocks_kirchhoff.h5", kirchhoff)
    strains = [strain * number / steps for number in range(steps + 1)]
    stresses = [0.0, *(step.nominal_stress for step in done)]
    figures = {
        "dofs": (solver.newton.pattern.size, ""),
        "cells": (len(sheet.cells), ""),
        "nominal_stress": (stresses[-1], "Pa"),
        "strain_history": (strains, "1"),
        "nominal_stress_history": (stresses, "Pa"),
        "deflection": (float(np.abs(state.displacement[middle, 2]).max()), "m"),
        "row_balance": (_row_balance(sheet, fields, LOADS[load], stresses[-1]), "1"),
        "newton_iterations": (sum(step.iterations for step in done), ""),
        "factorisations": (sum(step.factorisations for step in done), ""),
        "load_steps": (sum(step.load_steps for step in done), ""),
        "negative_pivots": (done[-1].negative_pivots, ""),
        "most_negative_pivots": (max(step.most_negative_pivots for step in done), ""),
        "residual": (done[-1].residual, "mean member force"),
        **_step_lists(done),
        "compressed_tendons": (int((members.force[~sheet.bars] < 0.0).sum()), ""),
        "linear_solver": (choice.backend, ""),
        "linear_solver_reason": (choice.reason, ""),
        "resumed_after_step": (resumed, ""),
        "peak_memory": (max(peak_memory(), *(step.peak_memory for step in done)), "B"),
        "seconds": (seconds_before + time.perf_counter() - begin, "s"),
    }
    if flat:
        held = np.abs(solver.system.gradient(members)[: sheet.nodes.size].reshape(-1, 3)[loose, 2]).max(initial=0.0)
        figures["midplane_force"] = (float(held / np.abs(members.force).mean()), "mean member force")
    if plots:
        _draw(out, sheet, (state.displacement, members), data, (strains, stresses))
    summary = write_summary(out, command="dns", parameters=parameters, figures=figures)
    remove_checkpoint(file)
    return summary


def memory_needed(blocks: tuple[int, int], backend: str) -> int:
    """Estimate of the memory, bytes, that a sheet of ``blocks`` (x, y) takes with the linear solver ``backend``.

    With n unknowns 130 MB + n (200 log2 n + 960) B: Python and its libraries, the factor of a sheet in nested
    dissection (measured with PARDISO 2.7, 3.1, 3.3 and 3.8 kB per unknown for 17, 67, 150 and 603 thousand), and the
    60 Lanczos vectors and their modes, 8 B a number, of a sheet that buckles. The fill of MUMPS and of SuperLU beside
    that of PARDISO is measured for 67 thousand.
    """
    n = _unknowns(blocks)
    return int(130e6 + n * (200.0 * _FILL[backend] * math.log2(n) + 960.0))


def _unknowns(blocks: tuple[int, int]) -> int:
    """Number of free displacements of a sheet of ``blocks``: four nodes to a face of its cells, bottom and top held."""
    nx, ny, nz = 2 * blocks[0], 2 * blocks[1], 2
    return 12 * ((nx + 1) * ny * nz + nx * (ny - 1) * nz + nx * ny * (nz + 1))


def _check_memory(blocks: tuple[int, int], linear_solver: str) -> None:
    """Raise InputError where the linear solver is not known, or the sheet needs more memory than is available."""
    backend = choose_backend(_unknowns(blocks), linear_solver).backend
    needed, available = memory_needed(blocks, backend), _available_memory()
    if available is not None and needed > available:
        raise InputError(
            f"blocks: {blocks[0]} x {blocks[1]} need about {needed / 1e9:.1f} GB of memory with {backend}, "
            f"{available / 1e9:.1f} GB are available"
        )


def _available_memory() -> int | None:
    """Memory, bytes, that the kernel says is available, or a container's limit if that is less; None if unknown."""
    found = []
    with contextlib.suppress(OSError):
        rows = (row.split() for row in Path("/proc/meminfo").read_text().splitlines())
        found += [1024 * int(row[1]) for row in rows if row[0] == "MemAvailable:"]
    for limit in ("memory.max", "memory/memory.limit_in_bytes"):
        with contextlib.suppress(OSError, ValueError):  # a group without limit says "max"
            found.append(int(Path("/sys/fs/cgroup", limit).read_text()))
    return min(found, default=None)


def _start(file: Path, run: str, shape: tuple[int, ...], say: Callable[[str], None]) -> Checkpoint:
    """Where to begin: the checkpoint of the same run, or the sheet at rest."""
    if file.exists():
        try:
            return read_checkpoint(file, run, shape)
        except InputError as error:
            say(f"{error}: starting from the beginning")
    return Checkpoint(np.zeros(shape))


def _record(result: Equilibrium, nominal_stress: float, seconds: float) -> LoadStep:
    """What is kept of a load step."""
    assert result.negative_pivots is not None  # a stable solution has been factorised
    return LoadStep(
        nominal_stress=nominal_stress,
        residual=result.residual,
        iterations=result.iterations,
        factorisations=result.factorisations,
        load_steps=result.load_steps,
        negative_pivots=result.negative_pivots,
        most_negative_pivots=max((i.negative_pivots for i in result.history), default=0),
        seconds=seconds,
        peak_memory=peak_memory(),
    )


def _step_lists(done: tuple[LoadStep, ...]) -> dict[str, tuple[Any, str]]:
    """How every recorded step converged, as figures of the summary."""
    units = {"residual": "mean member force", "seconds": "s"}
    names = ("residual", "iterations", "factorisations", "negative_pivots", "most_negative_pivots", "seconds")
    return {f"step_{name}": ([getattr(step, name) for step in done], units.get(name, "")) for name in names}


def _row_balance(sheet: Structure, fields: BlockFields, axis: int, nominal_stress: float) -> float:
    """Largest difference, relative, of the mean traction P_iy of a row of blocks from the reaction over the area.

    It is 0 in equilibrium: what is cut at any height carries the whole force.
    """
    row = sheet.blocks[:, 1] - sheet.blocks[:, 1].min()
    traction = np.bincount(row, weights=fields.first_piola[:, axis, 1]) / np.bincount(row)
    scale = max(abs(nominal_stress), float(np.abs(traction).max()))
    return float(np.abs(traction - nominal_stress).max() / scale) if scale else 0.0


def _block_data(blocks: BlockFields, parameters: dict[str, Any]) -> tuple[Dataset, Dataset]:
    """The block means as data sets of first Piola and of Kirchhoff stress.

    Each is a mean of its own over the members; for a block under varying F neither follows exactly from the other.
    """
    first_piola = Dataset(
        strain=to_mandel(blocks.F - np.eye(3)),
        stress=to_mandel(blocks.first_piola),
        stress_measure="first_piola",
        path=np.arange(len(blocks.F)),
        step=np.zeros(len(blocks.F), dtype=np.int64),
        deformation_gradient=blocks.F,
        midpoint=blocks.midpoint,
        parameters=parameters,
        versions=versions(),
    )
    kirchhoff = dataclasses.replace(first_piola, stress=to_mandel(blocks.kirchhoff), stress_measure="kirchhoff")
    return first_piola, kirchhoff


def _draw(
    out: Path,
    sheet: Structure,
    state: tuple[Array, MemberState],
    data: Dataset,
    curve: tuple[list[float], list[float]],
) -> None:
    """The figures and the file for ParaView."""
    from tsg_micro.data.figure_style import save_figure
    from tsg_micro.figures.data import plot_blocks, plot_curve
    from tsg_micro.figures.sheet import plot_sheet
    from tsg_micro.figures.vtu import write_vtu

    displacement, members = state
    write_vtu(out / "structure.vtu", sheet, displacement, members)
    save_figure(plot_sheet(sheet, displacement, members.force), out / "sheet.png")
    save_figure(plot_curve(*curve), out / "stress_strain.png")
    fields = {"pressure $p$": (pressure(data.stress), "Pa"), "effective stress $q$": (von_mises(data.stress), "Pa")}
    assert data.midpoint is not None
    save_figure(plot_blocks(data.midpoint, fields), out / "blocks.png")
