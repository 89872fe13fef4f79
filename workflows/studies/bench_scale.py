"""tsgdd bench scale: time, memory and iterations of a run against its size, each in its own process.

The scene is the stretched sheet, twice as wide as high, one element a block; beside the solves, the full tensegrity of
the same blocks, and the sampling of as many states as there are elements. What grows with the size as n^k is fitted
over the larger half of the sizes of each method and number of ranks; the time is split into set-up, searches, linear
solves, RVEs and the rest.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path, output_folder
from workflows.store.record import read_summary, write_summary, write_table
from workflows.studies.run_tsgdd import run_tsgdd

__all__ = ["METHODS", "PHASES", "SIZES", "Timed", "scale"]


@dataclass(frozen=True)
class Timed:
    """A ``command`` of tsgdd with its ``options``, and which of its figures counts ``iterations``, if one does.

    It has ``size``, elements across the height, at most, and runs in a process alone unless it is ``parallel``.
    """

    command: str
    options: tuple[str, ...]
    iterations: str | None = "iterations"
    largest: int = 10_000
    parallel: bool = True

    def sized(self, size: int, data: Path) -> tuple[object, ...]:
        """Its arguments for a sheet of ``size`` elements across; solves of given data have those of ``data``."""
        if self.command == "sample":
            return ("--paths", max(1, 2 * size * size // _STATES))
        if self.command == "dns":
            return ("--blocks", 2 * size, size)
        given = () if "--adapt" in self.options else ("--data", data)
        return (*given, "--elements", 2 * size, size, 1, "--no-edges", "--no-graded")


_STATES = 10
"""States on a path that is sampled."""
METHODS = {
    "points": Timed("solve", ("--order", "1")),
    "tangent spaces": Timed("solve", ("--order", "2")),
    "adaptive": Timed("solve", ("--adapt", "--bar-force", "1e-8")),
    "full tensegrity": Timed("dns", (), "newton_iterations", largest=30, parallel=False),
    "sampling": Timed("sample", ("--load", "inplane", "--processes", "1", "--steps", f"{_STATES}"), None),
}
SIZES = (15, 30, 60, 120)
"""Elements across the height."""
PHASES = ("seconds_setup", "seconds_search", "seconds_linear_solves", "seconds_rve", "seconds_rest")
_FITTED = ("seconds", "peak_memory", "iterations")


def scale(
    out: Path,
    *,
    sizes: Sequence[int] = SIZES,
    ranks: Sequence[int] = (1, 2),
    methods: Sequence[str] = tuple(METHODS),
    paths: int = 300,
    seconds: float = 600.0,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Run ``methods``, names of METHODS, on sheets of ``sizes`` elements across, on these numbers of ``ranks``.

    scale.csv has the rows, scale.md the same as a table, and scale.png draws them.
    ``paths`` loading paths give the data. A size that takes longer than ``seconds`` ends a row of sizes.

    Raises:
        InputError: an argument is not valid, or there is no mpiexec for more than one rank.
        ConvergenceError: a run failed.
    """
    if not sizes or min(sizes) < 2 or min(ranks, default=0) < 1:
        raise InputError(f"sizes, ranks: expected sizes from 2 and ranks from 1, got {list(sizes)} and {list(ranks)}")
    unknown = [name for name in methods if name not in METHODS]
    if unknown or not methods:
        raise InputError(f"method: expected some of {', '.join(METHODS)}, got {', '.join(unknown) or 'none'}")
    if max(ranks) > 1 and shutil.which("mpiexec") is None:
        raise InputError("ranks: expected 1 where there is no mpiexec, got more")
    data = output_folder(out) / "data.h5"
    run_tsgdd(["sample", "--load", "inplane", "--paths", paths, "--no-plots", "--out", data])
    rows: list[dict[str, Any]] = []
    for name in methods:
        method = METHODS[name]
        for count in ranks if method.parallel else (1,):
            for size in (n for n in sorted(sizes) if n <= method.largest):
                target = out / f"{name}-{size}-{count}{'.h5' * (method.command == 'sample')}".replace(" ", "-")
                arguments = (*method.options, *method.sized(size, data), "--no-plots", "--out", target)
                cpu = run_tsgdd([method.command, *arguments], ranks=count, seconds=seconds)
                if cpu is None:
                    say(f"{name}, {count} ranks, {size}: more than {seconds:g} s")
                    break
                rows.append(_row(name, size, count, cpu, read_summary(target, method.command)))
                say(f"{name:15} {count} ranks {2 * size * size:8} elements {rows[-1]['seconds']:8.2f} s")
    if not rows:
        raise InputError(f"seconds: expected enough for one run, got {seconds}")
    write_table(out / "scale.csv", rows)
    exponents = _exponents(rows)
    parameters = {"sizes": list(sizes), "ranks": list(ranks), "methods": list(methods), "paths": paths}
    with atomic_path(out / "scale.md") as temporary:
        temporary.write_text(_tables(rows, exponents))
    figures = {"rows": (rows, "s, B"), "exponents": (exponents, "of the number of elements")}
    summary = write_summary(out, command="bench scale", parameters=parameters, figures=figures)
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.scale_figure import plot_scale

        save_figure(plot_scale(rows, PHASES), out / "scale.png")
    return summary


def _row(method: str, size: int, ranks: int, cpu: float, found: dict[str, Any]) -> dict[str, Any]:
    """Numbers of one run; memory is the largest of its processes, CPU time has their start, and waits of ranks."""
    phases = {name: float(found.get(name, 0.0)) for name in PHASES[:-1]}
    rest = float(found["seconds"]) - sum(phases.values())
    counted = METHODS[method].iterations
    numbers = {
        "seconds": found["seconds"],
        "cpu": cpu,
        "peak_memory": found.get("peak_memory"),
        "iterations": None if counted is None else found[counted],
    }
    if METHODS[method].command == "sample":
        phases["seconds_rve"], rest = rest, 0.0
    return {"method": method, "ranks": ranks, "elements": 2 * size * size, **numbers, **phases, "seconds_rest": rest}


def _tables(rows: Sequence[dict[str, Any]], exponents: Sequence[dict[str, Any]]) -> str:
    """The rows and the exponents as tables in Markdown."""
    parts = " | ".join(name.removeprefix("seconds_").replace("_", " ") for name in PHASES)
    lines = [f"| method | ranks | elements | s | CPU s | GB | iterations | {parts} |", "|---" * (7 + len(PHASES)) + "|"]
    for row in rows:
        memory = None if row["peak_memory"] is None else row["peak_memory"] / 1e9
        numbers = (row["seconds"], row["cpu"], memory, row["iterations"], *(row[name] for name in PHASES))
        cells = ("" if n is None else f"{n:.3g}" for n in numbers)
        lines.append(f"| {row['method']} | {row['ranks']} | {row['elements']} | {' | '.join(cells)} |")
    lines += ["", "| n^k | ranks | time | memory | iterations |", "|---" * 5 + "|"]
    for row in exponents:
        cells = ("" if row[n] is None else f"{row[n]:.2f}" for n in _FITTED)
        lines.append(f"| {row['method']} | {row['ranks']} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _exponents(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """k of n^k over the larger half of the sizes, two at least; None where there is one size."""
    found = []
    for method, ranks in dict.fromkeys((row["method"], row["ranks"]) for row in rows):
        own = [row for row in rows if (row["method"], row["ranks"]) == (method, ranks)]
        own = own[min(len(own) // 2, max(len(own) - 2, 0)) :]
        size = np.log([row["elements"] for row in own])
        there = [name for name in _FITTED if own[0][name] is not None]
        fits = {n: _slope(size, np.log([float(row[n]) for row in own])) if n in there else None for n in _FITTED}
        found.append({"method": method, "ranks": ranks, **fits})
    return found


def _slope(x: NDArray[np.float64], y: NDArray[np.float64]) -> float | None:
    return float(np.polyfit(x, y, 1)[0]) if len(x) > 1 else None
