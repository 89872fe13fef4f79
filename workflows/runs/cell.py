"""tsgdd cell: one cell pressed down on a fixed base (paper, Section 3.1), for one bar force or a band of them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tsg_micro.bodies.cell import Indentation, check_top, indent_cell
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from workflows.store.limits import check_count
from workflows.store.record import peak_memory, write_summary

__all__ = ["DEFAULT_BAND", "cell"]

DEFAULT_BAND = (1e-9, 2e-9, 5e-9, 1e-8, 2e-8, 5e-8)
"""Bar forces f_b, N: the paper prints none, and over this band the sinking changes from a tenth of h to a fiftieth."""
UNITS = {
    "bar_force": "N",
    "force": "N",
    "displacement": "m",
    "energy": "J",
    "secant_stiffness": "N/m",
    "initial_stiffness": "N/m",
    "tangent_stiffness": "N/m",
    "stiffening": "1",
    "apparent_modulus": "Pa",
    "twist_angle": "degree",
    "residual": "mean member force",
}


def _check(force: float, steps: int, top: str) -> None:
    """Raise InputError where the force is not positive, there is no step, or the top is not known."""
    if not (math.isfinite(force) and force > 0.0):
        raise InputError(f"force: expected a positive number in N (it points down), got {force}")
    check_count("steps", steps)
    check_top(top)


def cell(
    out: Path,
    *,
    band: Sequence[float] = (),
    force: float = 3e-9,
    steps: int = 30,
    top: str = "free",
    tissue: Tissue = Tissue(),
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Indent one cell up to ``force`` (N) for every bar force (N) of ``band``, DEFAULT_BAND where it is empty.

    All else of the cell is that of ``tissue``, and ``top`` that of tsg_micro.bodies.cell.

    The summary holds a list ``band`` with the figures of each bar force, and those of a single one at its top too.
    Writes figures, one VTU file per load step with a .pvd that lists them, and summary.json into ``out``.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: the equilibrium was lost.
    """
    _check(force, steps, top)
    band = tuple(band) or DEFAULT_BAND
    tissues = [replace(tissue, bar_force=value) for value in band]
    if len(set(band)) != len(band):
        raise InputError(f"bar_force: expected each value once, got {', '.join(f'{f:g}' for f in band)}")
    parameters = {**tissue.as_dict(), "bar_force": band, "force": force, "steps": steps, "top": top}
    out = output_folder(out)

    begin = time.perf_counter()
    results = []
    for one in tissues:
        last = indent_cell(one, force * np.arange(1, steps + 1) / steps, top=top)
        results.append(last)
        say(
            f"bar force {1e9 * one.bar_force:g} nN: sinks {1e6 * last.displacement[-1]:.3f} µm under "
            f"{1e9 * force:g} nN, tangent stiffness {1e3 * last.tangent_stiffness:.3g} mN/m, "
            f"{last.states[-1].negative_pivots} negative pivots"
        )
    seconds = time.perf_counter() - begin
    figures: dict[str, tuple[Any, str]] = {}
    rows = [_row(result) for result in results]
    if len(rows) == 1:
        figures |= {name: (value, UNITS.get(name, "")) for name, value in rows[0].items()}
    else:
        figures["band_units"] = (UNITS, "")
    figures |= {
        "band": (rows, ""),
        "full_displacement": ([row["displacement"][-1] for row in rows], "m"),
        "twist_angle_at_rest": (math.degrees(results[0].theta), "degree"),
        "seconds": (seconds, "s"),
        "peak_memory": (peak_memory(), "B"),
    }
    summary = write_summary(out, command="cell", parameters=parameters, figures=figures)
    if plots:
        from tsg_micro.figures.cell import draw_cell

        draw_cell(out, results)
    return summary


def _row(result: Indentation) -> dict[str, Any]:
    """What the summary says of one bar force."""
    last = result.states[-1]
    return {
        "bar_force": result.tissue.bar_force,
        "force": result.force.tolist(),
        "displacement": result.displacement.tolist(),
        "energy": [state.energy for state in result.states],
        "secant_stiffness": result.secant_stiffness,
        "initial_stiffness": result.initial_stiffness,
        "tangent_stiffness": result.tangent_stiffness,
        "stiffening": result.tangent_stiffness / result.initial_stiffness,
        "apparent_modulus": result.apparent_modulus,
        "negative_pivots": last.negative_pivots,
        "most_negative_pivots": max(state.negative_pivots or 0 for state in result.states),
        "twist_angle": result.twist_angle.tolist(),
        "compressed_tendons": result.compressed_tendons,
        "residual": max(state.residual for state in result.states),
    }
