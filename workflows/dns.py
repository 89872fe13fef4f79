"""tsgdd dns: a sheet of blocks with every bar and tendon, stretched or sheared; the reference for all else."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tsg_micro.dataset import Dataset, write_dataset
from tsg_micro.equilibrium import Equilibrium, EquilibriumSolver
from tsg_micro.errors import InputError
from tsg_micro.files import output_folder
from tsg_micro.homogenise import block_fields
from tsg_micro.lattice import box_cells, lattice, side_nodes
from tsg_micro.linear_solvers import choose_backend
from tsg_micro.mandel import pressure, to_mandel, von_mises
from tsg_micro.newton import NewtonOptions
from tsg_micro.parameters import CellParameters, check_bar_force
from tsg_micro.prestress import prestressed
from tsg_micro.structure import Structure
from workflows.loads import LOADS, check_load, top_displacement
from workflows.record import peak_memory, versions, write_summary

__all__ = ["dns"]


def dns(
    out: Path,
    *,
    blocks: tuple[int, int],
    load: str,
    strain: float,
    bar_force: float,
    steps: int = 4,
    linear_solver: str = "auto",
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Load a sheet of ``blocks`` (x, y) 2x2x2-cell blocks to ``strain``, in ``steps`` recorded steps.

    The result is stable: an unstable equilibrium is left downhill. Writes blocks.h5 and blocks_kirchhoff.h5 (the
    block means as data sets), structure.vtu, figures and summary.json into ``out``.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: the equilibrium was lost.
    """
    check_load(load, strain)
    parameters = CellParameters()
    check_bar_force(bar_force, cells=1, EA_bar=parameters.EA_bar)
    if min(blocks) < 1 or steps < 1:
        raise InputError(f"blocks, steps: expected at least 1, got {blocks[0]} {blocks[1]} and {steps}")
    choose_backend(1, linear_solver)
    out = output_folder(out)

    begin = time.perf_counter()
    sheet = prestressed(lattice(box_cells(2 * blocks[0], 2 * blocks[1], 2), parameters), parameters, bar_force)
    bottom, top = side_nodes(sheet, 1, end="low"), side_nodes(sheet, 1, end="high")
    fixed = np.zeros(sheet.nodes.shape, dtype=bool)
    fixed[bottom] = fixed[top] = True
    solver = EquilibriumSolver(sheet, fixed=fixed, options=NewtonOptions(linear_solver=linear_solver))
    say(f"{solver.newton.pattern.size} unknowns, {solver.newton.choice.backend} ({solver.newton.choice.reason})")
    area = sheet.size[0] * sheet.size[2]
    moved = np.zeros(sheet.nodes.shape)
    results: list[Equilibrium] = []
    stresses = [0.0]
    for step in range(1, steps + 1):
        moved[top] = top_displacement(load, strain * step / steps, sheet.size[1])
        results.append(solver.solve(displacement=moved, stable=True))
        stresses.append(float(results[-1].reaction[top, LOADS[load]].sum() / area))
        say(
            f"step {step} of {steps}: nominal stress {stresses[-1]:.4g} Pa, {results[-1].iterations} iterations, "
            f"{results[-1].negative_pivots} negative pivots, {time.perf_counter() - begin:.0f} s"
        )
    seconds = time.perf_counter() - begin
    final = results[-1]
    data, kirchhoff = _block_data(
        sheet, final, {"blocks": blocks, "load": load, "strain": strain, "bar_force": bar_force}
    )
    write_dataset(out / "blocks.h5", data)
    write_dataset(out / "blocks_kirchhoff.h5", kirchhoff)
    strains = [strain * step / steps for step in range(steps + 1)]
    summary = write_summary(
        out,
        command="dns",
        parameters={
            "blocks": blocks,
            "load": load,
            "strain": strain,
            "bar_force": bar_force,
            "steps": steps,
            "linear_solver": linear_solver,
            "cell": asdict(parameters),
        },
        figures={
            "dofs": (solver.newton.pattern.size, ""),
            "cells": (len(sheet.cells), ""),
            "nominal_stress": (stresses[-1], "Pa"),
            "strain_history": (strains, "1"),
            "nominal_stress_history": (stresses, "Pa"),
            "newton_iterations": (sum(result.iterations for result in results), ""),
            "factorisations": (sum(result.factorisations for result in results), ""),
            "load_steps": (sum(result.load_steps for result in results), ""),
            "negative_pivots": (final.negative_pivots, ""),
            "most_negative_pivots": (max(i.negative_pivots for r in results for i in r.history), ""),
            "residual": (final.residual, "mean member force"),
            "compressed_tendons": (int((final.members.force[~sheet.bars] < 0.0).sum()), ""),
            "linear_solver": (final.solver.backend, ""),
            "linear_solver_reason": (final.solver.reason, ""),
            "peak_memory": (peak_memory(), "B"),
            "seconds": (seconds, "s"),
        },
    )
    if plots:
        _draw(out, sheet, final, data, (strains, stresses))
    return summary


def _block_data(sheet: Structure, result: Equilibrium, parameters: dict[str, Any]) -> tuple[Dataset, Dataset]:
    """The block means as data sets of first Piola and of Kirchhoff stress.

    Each is a mean of its own over the members; for a block under varying F neither follows exactly from the other.
    """
    blocks = block_fields(sheet, result.displacement, result.members)
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
    out: Path, sheet: Structure, result: Equilibrium, data: Dataset, curve: tuple[list[float], list[float]]
) -> None:
    """The figures and the file for ParaView."""
    from tsg_micro.plot import plot_sheet, save_figure
    from tsg_micro.plot_data import plot_blocks, plot_curve
    from tsg_micro.vtu import write_vtu

    write_vtu(out / "structure.vtu", sheet, result.displacement, result.members)
    save_figure(plot_sheet(sheet, result.displacement, result.members.force), out / "sheet.png")
    save_figure(plot_curve(*curve), out / "stress_strain.png")
    fields = {"pressure $p$": (pressure(data.stress), "Pa"), "effective stress $q$": (von_mises(data.stress), "Pa")}
    assert data.midpoint is not None
    save_figure(plot_blocks(data.midpoint, fields), out / "blocks.png")
