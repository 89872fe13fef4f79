"""tsgdd bench scale: time, memory and iterations of a solve against the size of the mesh, each in its own process.

The scene is the stretched sheet, twice as wide as high. What grows with the size as n^k is fitted over the larger half
of the sizes of each method and number of ranks; the time is split into set-up, searches, linear solves and the rest.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from workflows.store.record import read_summary, write_summary, write_table

__all__ = ["METHODS", "PHASES", "SIZES", "scale"]

METHODS: dict[str, tuple[str, ...]] = {
    "points": ("--order", "1"),
    "tangent spaces": ("--order", "2"),
    "adaptive": ("--adapt", "--bar-force", "1e-8"),
}
"""Options of tsgdd solve."""
SIZES = (15, 30, 60, 120)
"""Elements across the height."""
PHASES = ("seconds_setup", "seconds_search", "seconds_linear_solves", "seconds_rve", "seconds_rest")
_FITTED = ("seconds", "peak_memory", "iterations")
_START = "from workflows.cli import main; main()"


def scale(
    out: Path,
    *,
    sizes: Sequence[int] = SIZES,
    ranks: Sequence[int] = (1, 2),
    paths: int = 300,
    seconds: float = 600.0,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Run all methods on sheets of ``sizes`` elements across, on these numbers of ``ranks``; scale.csv has the rows.

    ``paths`` loading paths give the data. A size that takes longer than ``seconds`` ends a row of sizes.

    Raises:
        InputError: an argument is not valid, or there is no mpiexec for more than one rank.
        ConvergenceError: a run failed.
    """
    if not sizes or min(sizes) < 2 or min(ranks, default=0) < 1:
        raise InputError(f"sizes, ranks: expected sizes from 2 and ranks from 1, got {list(sizes)} and {list(ranks)}")
    if max(ranks) > 1 and shutil.which("mpiexec") is None:
        raise InputError("ranks: expected 1 where there is no mpiexec, got more")
    data = output_folder(out) / "data.h5"
    _run(["sample", "--load", "inplane", "--paths", paths, "--no-plots", "--out", data], 1, None)
    rows: list[dict[str, Any]] = []
    for name, options in METHODS.items():
        given = () if name == "adaptive" else ("--data", data)
        for count in ranks:
            for size in sorted(sizes):
                folder = out / f"{name}-{size}-{count}".replace(" ", "-")
                scene = ("--elements", 2 * size, size, 1, "--no-edges", "--no-graded", "--no-plots", "--out", folder)
                if not _run(["solve", *options, *given, *scene], count, seconds):
                    say(f"{name}, {count} ranks, {size}: more than {seconds:g} s")
                    break
                rows.append(_row(name, size, count, read_summary(folder, "solve")))
                say(f"{name:15} {count} ranks {2 * size * size:8} elements {rows[-1]['seconds']:8.2f} s")
    if not rows:
        raise InputError(f"seconds: expected enough for one run, got {seconds}")
    write_table(out / "scale.csv", rows)
    exponents = _exponents(rows)
    parameters = {"sizes": list(sizes), "ranks": list(ranks), "paths": paths}
    figures = {"rows": (rows, "s, B"), "exponents": (exponents, "of the number of elements")}
    summary = write_summary(out, command="bench scale", parameters=parameters, figures=figures)
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.scale_figure import plot_scale

        save_figure(plot_scale(rows), out / "scale.png")
    return summary


def _run(arguments: Sequence[object], ranks: int, seconds: float | None) -> bool:
    """Whether ``tsgdd`` with these arguments ended in time, on a number of ranks.

    Raises:
        ConvergenceError: it failed.
    """
    start = [] if ranks == 1 else ["mpiexec", "-n", str(ranks)]
    try:
        done = subprocess.run(
            [*start, sys.executable, "-c", _START, *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        return False
    if done.returncode != 0:
        raise ConvergenceError(f"tsgdd {arguments[0]}: {(done.stderr.strip() or 'failed').splitlines()[-1]}")
    return True


def _row(method: str, size: int, ranks: int, found: dict[str, Any]) -> dict[str, Any]:
    """Numbers of one run; memory is the largest of its processes."""
    phases = {name: float(found.get(name, 0.0)) for name in PHASES[:-1]}
    rest = float(found["seconds"]) - sum(phases.values())
    numbers = {name: found[name] for name in _FITTED}
    return {"method": method, "ranks": ranks, "elements": 2 * size * size, **numbers, **phases, "seconds_rest": rest}


def _exponents(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """k of n^k over the larger half of the sizes, two at least; None where there is one size."""
    found = []
    for method, ranks in dict.fromkeys((row["method"], row["ranks"]) for row in rows):
        own = [row for row in rows if (row["method"], row["ranks"]) == (method, ranks)]
        own = own[min(len(own) // 2, max(len(own) - 2, 0)) :]
        size = np.log([row["elements"] for row in own])
        fits = {name: _slope(size, np.log([float(row[name]) for row in own])) for name in _FITTED}
        found.append({"method": method, "ranks": ranks, **fits})
    return found


def _slope(x: NDArray[np.float64], y: NDArray[np.float64]) -> float | None:
    return float(np.polyfit(x, y, 1)[0]) if len(x) > 1 else None
