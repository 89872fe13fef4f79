"""tsgdd monolayer: a sheet of cells, one or more layers thick, stretched in y (paper, Section 3.2).

All nodes of the bottom side (y = 0) are fixed; those of the top side are moved in y and held in x and z. The faces
across x and z are free. The nominal stress is the reaction of the top over the undeformed cross-section, width times
layers times cell height. The strain of a cell is the infinitesimal one, sym(H) with H from its own 24 nodes
(tsg_micro.continuum.homogenise.cell_gradient), so that at 25 % stretch eps_yy is about 0.25, as in the paper.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tsg_micro.bodies.sheet import CellStrain, Sheet, Stretch, cell_strain, histogram_edges, stretch
from tsg_micro.cells.parameters import CellParameters, check_bar_force
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path, output_folder
from tsg_micro.equilibrium.linear_solvers import choose_backend
from workflows.runs.cell import indent
from workflows.runs.loads import check_load
from workflows.store.record import peak_memory, write_summary

__all__ = ["BAND_BLOCKS", "INDENTATION", "monolayer"]

INDENTATION = 3e-9
"""Force, N, at which the single cell's apparent modulus is taken (paper, Table 1)."""
BAND_BLOCKS = (20, 10)
"""Largest sheet for the curves of other bar forces."""


def monolayer(
    out: Path,
    *,
    blocks: tuple[int, int] = (60, 30),
    layers: int = 1,
    strain: float = 0.25,
    bar_force: float = 1e-8,
    steps: int = 25,
    write_every: int = 5,
    convergence: Sequence[tuple[int, int]] = (),
    band: Sequence[float] = (),
    parameters: CellParameters | None = None,
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
    parameters = parameters or CellParameters()
    _check(strain, steps, write_every, [blocks, *convergence], [bar_force, *band], parameters, layers)
    choose_backend(1, linear_solver)
    out = output_folder(out)

    begin = time.perf_counter()
    sheet = Sheet(blocks, layers, bar_force, parameters, linear_solver)
    strains = strain * np.arange(1, steps + 1) / steps
    writer = None
    if plots:
        from workflows.runs.monolayer_figures import SeriesWriter

        writer = SeriesWriter(out, every=write_every, last=steps)
    result = stretch(sheet, strains, say=say, record=writer)
    seconds = time.perf_counter() - begin
    cells = cell_strain(result)
    _write_cells(out / "cells.h5", cells)
    modulus = _cell_modulus(parameters, bar_force)
    sizes = [stretch(dataclasses.replace(sheet, blocks=size), strains) for size in convergence]
    small = dataclasses.replace(sheet, blocks=(min(blocks[0], BAND_BLOCKS[0]), min(blocks[1], BAND_BLOCKS[1])))
    others = [stretch(dataclasses.replace(small, bar_force=f), strains) for f in band]
    moduli = [_cell_modulus(parameters, f) for f in band]
    figures = _figures(result, cells, modulus) | {
        "convergence": ([_row(other) | _differences(other, result) for other in sizes], "SI"),
        "band": (
            [_row(other) | _ratios(other, one) for other, one in zip(others, moduli, strict=True)],
            "SI",
        ),
        "seconds": (seconds, "s"),
        "peak_memory": (peak_memory(), "B"),
    }
    summary = write_summary(
        out,
        command="monolayer",
        parameters={
            "blocks": blocks,
            "layers": layers,
            "strain": strain,
            "bar_force": bar_force,
            "steps": steps,
            "convergence": list(convergence),
            "band": list(band),
            "linear_solver": linear_solver,
            "cell": asdict(parameters),
        },
        figures=figures,
    )
    if writer:
        from workflows.runs.monolayer_figures import draw_monolayer

        writer.close()
        draw_monolayer(out, result, cells, modulus)
        if sizes:
            from workflows.runs.monolayer_figures import draw_convergence

            draw_convergence(out, [*sizes, result])
        if others:
            from workflows.runs.monolayer_figures import draw_band

            draw_band(out, others, moduli)
    return summary


def _check(
    strain: float,
    steps: int,
    write_every: int,
    sizes: Sequence[tuple[int, int]],
    bar_forces: Sequence[float],
    parameters: CellParameters,
    layers: int,
) -> None:
    """Raise InputError where an argument is not valid."""
    check_load("stretch", strain)
    if min(steps, write_every, layers) < 1:
        raise InputError(f"steps, write_every, layers: expected at least 1, got {steps}, {write_every} and {layers}")
    for size in sizes:
        if min(size) < 1:
            raise InputError(f"blocks: expected at least 1 along x and y, got {size[0]} {size[1]}")
    for value in bar_forces:
        check_bar_force(value, cells=1, EA_bar=parameters.EA_bar)


def _cell_modulus(parameters: CellParameters, bar_force: float) -> float:
    """Apparent modulus, Pa, of one cell under INDENTATION: (F / h^2) / (d / h)."""
    pressed = indent(parameters, bar_force, INDENTATION * np.array([0.25, 0.5, 0.75, 1.0]))
    return INDENTATION / float(pressed.displacement[-1]) / parameters.height


def _row(result: Stretch) -> dict[str, Any]:
    """The curve of one more sheet."""
    return {
        "blocks": result.sheet.blocks,
        "bar_force": result.sheet.bar_force,
        "strain": result.strain,
        "nominal_stress": result.nominal_stress,
        "tangent_modulus": result.tangent_modulus,
        "compressed_tendons": result.compressed_tendons,
        "negative_pivots": result.negative_pivots,
    }


def _ratios(result: Stretch, modulus: float) -> dict[str, Any]:
    """Moduli of the sheet over that of the single cell."""
    return {
        "cell_apparent_modulus": modulus,
        "modulus_ratio": result.tangent_modulus[0] / modulus,
        "modulus_ratio_at_full_strain": result.tangent_modulus[-1] / modulus,
    }


def _differences(result: Stretch, largest: Stretch) -> dict[str, Any]:
    """How far a smaller sheet's curve is from that of the largest, relative to the stress at full strain."""
    stress, reference = np.array(result.nominal_stress), np.array(largest.nominal_stress)
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
    ratios = _ratios(result, modulus)
    return {
        "strain": (result.strain, "1"),
        "nominal_stress": (result.nominal_stress, "Pa"),
        "tangent_modulus": (result.tangent_modulus, "Pa"),
        "compressed_tendons": (result.compressed_tendons, "at each step"),
        "negative_pivots": (result.negative_pivots, "at each step"),
        "cell_strain": (histograms, "1"),
        "edge_contraction": (result.edge_contraction, "m"),
        "cell_apparent_modulus": (modulus, "Pa"),
        "modulus_ratio": (ratios["modulus_ratio"], "1"),
        "modulus_ratio_at_full_strain": (ratios["modulus_ratio_at_full_strain"], "1"),
        "cells": (len(result.structure.cells), ""),
        "dofs": (result.dofs, ""),
        "newton_iterations": (result.iterations, ""),
        "factorisations": (result.factorisations, ""),
        "residual": (result.residual, "mean member force"),
        "linear_solver": (final.solver.backend, ""),
        "linear_solver_reason": (final.solver.reason, ""),
    }


def _write_cells(path: Path, cells: CellStrain) -> None:
    """Midpoint, displacement and infinitesimal strain of every cell."""
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        for name, values, unit in (
            ("midpoint", cells.midpoint, "m"),
            ("displacement", cells.displacement, "m"),
            ("strain", cells.strain, "1"),
        ):
            file.create_dataset(name, data=values).attrs["unit"] = unit
        file["strain"].attrs["measure"] = "infinitesimal, sym(H) (c, 3, 3)"
