"""tsgdd monolayer: a sheet of cells, one or more layers thick, stretched in y (paper, Section 3.2).

All nodes of the bottom side (y = 0) are fixed; those of the top side are moved in y and held in x and z. The faces
across x and z are free. The nominal stress is the reaction of the top over the undeformed cross-section, width times
layers times cell height. The strain of a cell is the infinitesimal one, sym(H) with H from its own 24 nodes
(tsg_micro.continuum.homogenise.cell_gradient), so that at 25 % stretch eps_yy is about 0.25, as in the paper.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tsg_micro.bodies.cell import indent_cell
from tsg_micro.bodies.sheet import Sheet, Stretch, memory_needed, stretch_sheet
from tsg_micro.bodies.sheet_means import CellStrain, cell_strain, histogram_edges
from tsg_micro.cells.structure import Structure
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from tsg_micro.data.hdf5 import write_hdf5
from tsg_micro.equilibrium.linear_solvers import choose_backend
from tsg_micro.equilibrium.load_path import Equilibrium
from tsg_micro.figures.vtu import VtuSeries
from workflows.runs.loads import check_load
from workflows.runs.progress import progress
from workflows.store.limits import check_count, check_memory
from workflows.store.record import peak_memory, write_summary

__all__ = ["BAND_BLOCKS", "INDENTATION", "monolayer"]

INDENTATION = 3e-9
"""Force, N, at which the single cell's apparent modulus is taken (paper, Table 1)."""
BAND_BLOCKS = (20, 10)
"""Largest sheet for the curves of other bar forces."""

_CURVE = {
    "strain": "1",
    "nominal_stress": "Pa",
    "tangent_modulus": "Pa",
    "compressed_tendons": "at each step",
    "negative_pivots": "at each step",
}


def monolayer(
    out: Path,
    *,
    blocks: tuple[int, int] = (60, 30),
    layers: int = 1,
    strain: float = 0.25,
    tissue: Tissue = Tissue(),
    steps: int = 25,
    write_every: int = 5,
    convergence: Sequence[tuple[int, int]] = (),
    band: Sequence[float] = (),
    linear_solver: str = "auto",
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Stretch a sheet of ``blocks`` (x, y) of 2x2 cells, ``layers`` cells thick, to ``strain`` in ``steps``.

    With ``convergence`` smaller sheets are stretched alike, and with ``band`` sheets of at most BAND_BLOCKS with other
    bar forces (N). Writes cells.h5 (strain of every cell), summary.json and, with ``plots``, figures and a time series
    for ParaView of every ``write_every``-th step into ``out``.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: the equilibrium was lost.
    """
    check_load("stretch", strain)
    if min(steps, write_every, layers) < 1:
        raise InputError(f"steps, write_every, layers: expected at least 1, got {steps}, {write_every} and {layers}")
    check_count("steps", steps)
    sheet = Sheet(blocks, layers, tissue, linear_solver=linear_solver)
    backend = choose_backend(sheet.unknowns, linear_solver).backend
    check_memory(f"blocks: {blocks[0]} x {blocks[1]}", memory_needed(sheet.unknowns, backend))
    smaller = [replace(sheet, blocks=size) for size in convergence]
    few = (min(blocks[0], BAND_BLOCKS[0]), min(blocks[1], BAND_BLOCKS[1]))
    other = [replace(sheet, blocks=few, tissue=replace(tissue, bar_force=f)) for f in band]
    parameters = {"blocks": blocks, "layers": layers, "strain": strain, "steps": steps, **tissue.as_dict()}
    parameters |= {"convergence": list(convergence), "band": list(band), "linear_solver": linear_solver}
    out = output_folder(out)

    begin = time.perf_counter()
    strains = strain * np.arange(1, steps + 1) / steps
    series: VtuSeries | None = None

    def record(step: int, structure: Structure, state: Equilibrium) -> None:
        nonlocal series
        if plots and (step % write_every == 0 or step == steps):
            series = series or VtuSeries(out / "monolayer.pvd", structure)
            series.add(step, state)
        told(step)

    with progress("load steps", steps) as told:
        result = stretch_sheet(sheet, strains, say=say, record=record)
    seconds = time.perf_counter() - begin
    cells = cell_strain(result)
    _write_cells(out / "cells.h5", cells)
    modulus = _cell_modulus(tissue)
    sizes = [stretch_sheet(one, strains) for one in smaller]
    others = [(stretch_sheet(one, strains), _cell_modulus(one.tissue)) for one in other]
    figures = _figures(result, cells, modulus) | {
        "convergence": ([_row(other) | _differences(other, result) for other in sizes], "SI"),
        "band": ([_row(other) | {"cell_apparent_modulus": one} | _ratios(other, one) for other, one in others], "SI"),
        "seconds": (seconds, "s"),
        "peak_memory": (peak_memory(), "B"),
    }
    summary = write_summary(out, command="monolayer", parameters=parameters, figures=figures)
    if plots:
        _draw(out, result, cells, modulus, sizes, others)
    return summary


def _draw(
    out: Path,
    result: Stretch,
    cells: CellStrain,
    modulus: float,
    sizes: list[Stretch],
    others: list[tuple[Stretch, float]],
) -> None:
    """All figures; those of other sizes and bar forces where there are any."""
    from tsg_micro.figures.stretch import draw_band, draw_convergence, draw_stretch
    from workflows.experiments import published

    measured = published("harris_2012")["modulus_ratio"]
    draw_stretch(out, result, cells, modulus, (measured.label, measured.low))
    if sizes:
        draw_convergence(out, [*sizes, result])
    if others:
        draw_band(out, others, (measured.label, measured.low))


def _cell_modulus(tissue: Tissue) -> float:
    """Apparent modulus, Pa, of one cell under INDENTATION."""
    return indent_cell(tissue, INDENTATION * np.array([0.25, 0.5, 0.75, 1.0])).apparent_modulus


def _row(result: Stretch) -> dict[str, Any]:
    """The curve of one more sheet."""
    curve = {name: result.column(name) for name in _CURVE}
    return {"blocks": result.sheet.blocks, "bar_force": result.sheet.tissue.bar_force, **curve}


def _ratios(result: Stretch, modulus: float) -> dict[str, float]:
    """Moduli of the sheet over that of the single cell."""
    return {
        "modulus_ratio": result.steps[0].tangent_modulus / modulus,
        "modulus_ratio_at_full_strain": result.steps[-1].tangent_modulus / modulus,
    }


def _differences(result: Stretch, largest: Stretch) -> dict[str, float]:
    """How far a smaller sheet's curve is from that of the largest, relative to the stress at full strain."""
    stress, reference = (np.array(one.column("nominal_stress")) for one in (result, largest))
    return {
        "difference_at_full_strain": stress[-1] / reference[-1] - 1.0,
        "largest_difference": np.abs(stress - reference).max() / abs(reference[-1]),
    }


def _figures(result: Stretch, cells: CellStrain, modulus: float) -> dict[str, tuple[Any, str]]:
    """What the summary says of the sheet."""
    final = result.final
    histograms = {}
    for name, values in cells.components().items():
        counts, edges = np.histogram(values, bins=histogram_edges(values))
        histograms[name] = {
            "mean": values.mean(),
            "median": np.median(values),
            "deviation": values.std(),
            "smallest": values.min(),
            "largest": values.max(),
            "edges": edges,
            "counts": counts,
        }
    return {
        **{name: (result.column(name), unit) for name, unit in _CURVE.items()},
        "cell_strain": (histograms, "1"),
        "edge_contraction": (result.edge_contraction, "m"),
        "cell_apparent_modulus": (modulus, "Pa"),
        **{name: (ratio, "1") for name, ratio in _ratios(result, modulus).items()},
        "cells": (len(result.structure.cells), ""),
        "dofs": (result.dofs, ""),
        "newton_iterations": (sum(result.column("iterations")), ""),
        "factorisations": (sum(result.column("factorisations")), ""),
        "residual": (max(result.column("residual")), "mean member force"),
        "linear_solver": (final.solver.backend, ""),
        "linear_solver_reason": (final.solver.reason, ""),
    }


def _write_cells(path: Path, cells: CellStrain) -> None:
    """Midpoint, displacement and infinitesimal strain of every cell."""

    def fill(file: h5py.File) -> None:
        for name, values, unit in (
            ("midpoint", cells.midpoint, "m"),
            ("displacement", cells.displacement, "m"),
            ("strain", cells.strain, "1"),
        ):
            file.create_dataset(name, data=values).attrs["unit"] = unit
        file["strain"].attrs["measure"] = "infinitesimal, sym(H) (c, 3, 3)"

    write_hdf5(path, fill)
