"""tsgdd study data-size: error and distance of the data-driven solution against the number of data (Section 4.2)."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.dataset import Dataset, take
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import check_regular, output_folder
from workflows.runs.loads import LOADS
from workflows.runs.progress import tracked
from workflows.runs.tensegrity import describe, read_blocks
from workflows.store.checkpoint import fingerprint
from workflows.store.record import read_summary, write_summary, write_table
from workflows.studies.one_load import COLUMNS, Bench, Row, Study, make_bench

__all__ = ["FIGURES", "data_size", "sizes_of"]

Array = NDArray[np.float64]

FIGURES = COLUMNS[:6]
"""What is measured of every solve, relative (l2); without ``_all`` the outer blocks are left out."""


def sizes_of(points: int, count: int) -> list[int]:
    """``count`` numbers of data (fewer where they would be equal), even on a log scale, over three decades."""
    return sorted({max(1, round(points * 10 ** (-3 + 3 * k / (count - 1)))) for k in range(count)})


def data_size(study: Study, *, count: int = 16, draws: int = 10, plots: bool = True) -> dict[str, Any]:
    """Solve with ``draws`` random draws of ``count`` numbers of data each, and with the tensegrity's own block states.

    The largest number is that of all data, of which there is one draw.

    All solves have one mesh, one metric (from all data) and one factorised matrix, and start from the elastic
    solution. solves.csv has every solve, and a run that was cut short goes on from there.

    Raises:
        InputError: an argument or a file is not valid.
        ConvergenceError: a solve did not converge.
    """
    if count < 2 or draws < 1:
        raise InputError(f"sizes, draws: expected at least 2 and 1, got {count} and {draws}")
    out, load, say = output_folder(study.out), study.load, study.say
    found = study.prepare()
    dataset = found.dataset
    begin = time.perf_counter()
    blocks = read_blocks(found.dns, dataset.stress_measure)
    bench = make_bench(found.scene, "auto", dataset, blocks)
    metric = bench.projection.metric
    setup = time.perf_counter() - begin
    say(f"metric: {metric.reason}")

    sizes = sizes_of(len(dataset), count)
    run = fingerprint(
        {
            "scene": {"load": load, **study.chain.parameters()},
            "metric": metric.C,
            "sizes": sizes,
            "data": [dataset.strain, dataset.stress],
            "blocks": blocks.stress,
        }
    )
    rows = _draws(bench, dataset, sizes, draws, (out / "solves.csv", run), say)
    consistent, _ = bench.solve(blocks)
    restart = _restart(bench, dataset, sizes, rows)
    table = {name: [np.array([row[name] for row in rows if row["size"] == size]) for size in sizes] for name in FIGURES}
    means = {name: np.array([v.mean() for v in values]) for name, values in table.items()}
    seconds = {name: sum(row[name] for row in rows) for name in ("seconds", "seconds_search", "seconds_linear_solves")}
    summary = write_summary(
        out,
        command="study data-size",
        parameters={**study.parameters(found), "count": count, "draws": draws},
        figures={
            "symbol": (LOADS[load].symbol, ""),
            "reference": (describe(read_summary(found.dns, "dns")), ""),
            "sizes": (sizes, ""),
            **{name: ({"mean": means[name]} | _spread(values), "1") for name, values in table.items()},
            "largest": ({name: float(mean[-1]) for name, mean in means.items()}, "1"),
            "self_consistent": ({name: consistent[name] for name in FIGURES}, "1"),
            "rises": ({name: int((np.diff(mean) > 0).sum()) for name, mean in means.items()}, ""),
            "largest_rise": ({name: max(0.0, float(np.diff(mean).max())) for name, mean in means.items()}, "1"),
            "restart": (restart, ""),
            "solves": (len(rows), ""),
            "metric": (metric.C, "Pa"),
            "metric_reason": (metric.reason, ""),
            "stress_measure": (dataset.stress_measure, ""),
            "seconds_setup": (setup, "s"),
            **{name if name != "seconds" else "seconds_solves": (value, "s") for name, value in seconds.items()},
        },
    )
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.data_size_figure import plot_data_size

        save_figure(plot_data_size(summary), out / "data_size.png")
    return summary


def _draws(
    bench: Bench, dataset: Dataset, sizes: list[int], draws: int, record: tuple[Path, str], say: Callable[[str], None]
) -> list[Row]:
    """A row for every solve. A draw is a random order of the data, of which each size takes the first ones."""
    file, run = record
    rows = _read(file, run, sizes)
    there = {int(row["draw"]) for row in rows}
    if there:
        say(f"{len(there)} of {draws} draws are in {file.name} already")
    for draw in tracked(sorted(set(range(draws)) - there), "draws"):
        order = np.random.default_rng([draw, len(dataset)]).permutation(len(dataset))
        for size in sizes if draw == 0 else sizes[:-1]:
            row, _ = bench.solve(take(dataset, order[:size]))
            rows.append({"draw": draw, "size": size, **row})
        last = rows[-1]
        write_table(file, rows, f"run {run}")
        say(
            f"draw {draw + 1} of {draws}: error of {bench.symbol} with {last['size']} data {last['error_mech']:.1%} "
            f"mechanical, {last['error_mat']:.1%} material"
        )
    return [row for row in rows if row["draw"] < draws]


def _restart(bench: Bench, dataset: Dataset, sizes: list[int], rows: list[Row]) -> Row:
    """What it would give to start every solve of the first draw from the solution with the size before."""
    cold = [row for row in rows if row["draw"] == 0]
    order = np.random.default_rng([0, len(dataset)]).permutation(len(dataset))
    state, warm = None, []
    for size in sizes:
        row, state = bench.solve(take(dataset, order[:size]), state)
        warm.append(row)
    change = [abs(w[name] - c[name]) for w, c in zip(warm, cold, strict=True) for name in ("error_mech", "error_mat")]
    return {
        "iterations": sum(row["iterations"] for row in warm) / sum(row["iterations"] for row in cold),
        "largest_change_of_error": max(change),
        "change_of_error_at_largest": max(change[-2:]),
        "error_mech_at_largest": warm[-1]["error_mech"],
        "error_mat_at_largest": warm[-1]["error_mat"],
    }


def _spread(values: list[Array]) -> dict[str, list[float | None]]:
    """Standard deviation of the draws (None of a single one), smallest and largest, for every size."""
    return {
        "std": [float(v.std(ddof=1)) if len(v) > 1 else None for v in values],
        "smallest": [float(v.min()) for v in values],
        "largest": [float(v.max()) for v in values],
    }


def _read(file: Path, run: str, sizes: list[int]) -> list[Row]:
    """The rows of an earlier part of the same run, of whole draws only; none where there are none."""
    try:
        check_regular(file)
        with file.open(newline="") as stream:
            if stream.readline() != f"# run {run}\n":
                return []
            rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)]
    except (OSError, ValueError, TypeError):
        return []
    whole = []
    for draw in sorted({row.get("draw", -1.0) for row in rows}):
        own = [row for row in rows if row.get("draw") == draw and np.isfinite(list(row.values())).all()]
        if [row.get("size") for row in own] == (sizes if draw == 0 else sizes[:-1]):
            whole += own
    return whole
