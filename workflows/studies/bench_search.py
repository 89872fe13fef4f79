"""tsgdd bench search: time and memory of a solve with data as points, against the number of data.

The data are interpolated between RVEs: a state of one of them and a small strain in the plane along its tangent, the
thickness free. So there are as many as one wants, all of one smooth law. The scene is the stretched sheet; every solve
is exact and runs in a process of its own, whose processor time, reading and imports included, is told too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import read_dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from workflows.store.limits import check_memory
from workflows.store.record import read_summary, write_summary, write_table
from workflows.studies.run_tsgdd import run_tsgdd

__all__ = ["COUNTS", "bench_search", "between"]

COUNTS = (10_000, 100_000, 1_000_000)
_NEAR = 0.005
"""Largest strain between a datum and the RVE that it is from."""
_IN_PLANE, _THICKNESS, _AT_ONCE = [0, 1, 5], 2, 100_000
_PER_DATUM = 500
"""Bytes, roughly, that a datum takes while data are made or searched."""
_TIMES = ("seconds", "seconds_setup", "seconds_search", "seconds_linear_solves")


def between(dataset: Dataset, count: int, rng: np.random.Generator) -> Dataset:
    """``count`` data along the tangents of those of ``dataset``, of a sheet whose faces are free."""
    assert dataset.tangent is not None
    of = rng.integers(0, len(dataset), count)
    strain, stress = np.zeros((count, 6)), np.zeros((count, 6))
    for begin in range(0, count, _AT_ONCE):
        part = of[begin : begin + _AT_ONCE]
        change, D = np.zeros((len(part), 6)), dataset.tangent[part]
        change[:, _IN_PLANE] = rng.uniform(-_NEAR, _NEAR, (len(part), 3))
        change[:, _THICKNESS] = -np.einsum("nj,nj->n", D[:, _THICKNESS], change) / D[:, _THICKNESS, _THICKNESS]
        strain[begin : begin + _AT_ONCE] = dataset.strain[part] + change
        stress[begin : begin + _AT_ONCE] = dataset.stress[part] + np.einsum("nij,nj->ni", D, change)
    stress[:, [name not in _IN_PLANE for name in range(6)]] = 0.0
    one = np.zeros(count, dtype=np.int64)
    given: dict[str, Any] = {"strain": strain, "stress": stress, "path": one, "step": one}
    return replace(dataset, **given, tangent=None, deformation_gradient=None, energy=None)


def bench_search(
    out: Path,
    *,
    counts: Sequence[int] = COUNTS,
    elements: tuple[int, int] = (60, 30),
    paths: int = 300,
    seed: int = 0,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Solve the stretched sheet of ``elements`` (x, y) with each of ``counts`` data; search.csv has the rows.

    ``paths`` loading paths through an RVE are interpolated between. The files of data are removed.

    Raises:
        InputError: an argument is not valid, or there is not enough memory.
        ConvergenceError: a run failed.
    """
    if not counts:
        raise InputError("count: expected at least one number of data, got none")
    asked = (("count", min(counts), 1), ("elements", min(elements), 2), ("paths", paths, 1), ("seed", seed, 0))
    for name, value, least in asked:
        if value < least:
            raise InputError(f"{name}: expected at least {least}, got {value}")
    check_memory(f"count: {max(counts)}", _PER_DATUM * max(counts))
    sampled, data = output_folder(out) / "rve.h5", out / "data.h5"
    run_tsgdd(["sample", "--load", "inplane", "--paths", paths, "--no-plots", "--out", sampled])
    rves, rows = read_dataset(sampled), list[dict[str, Any]]()
    for count in sorted(counts):
        write_dataset(data, between(rves, count, np.random.default_rng(seed)))
        scene = ("--data", data, "--elements", *elements, 1, "--no-edges", "--no-plots", "--out", out / "solve")
        spent = run_tsgdd(["solve", *scene])
        assert spent is not None  # it may take any time
        data.unlink()
        rows.append(_row(count, spent, read_summary(out / "solve", "solve")))
        say("{data:10} data {seconds:8.2f} s, {seconds_search:.2f} s of it searches".format(**rows[-1]))
    write_table(out / "search.csv", rows)
    parameters = {"counts": list(counts), "elements": list(elements), "paths": paths, "seed": seed}
    summary = write_summary(out, command="bench search", parameters=parameters, figures={"rows": (rows, "s, B")})
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.search_figure import plot_search

        save_figure(plot_search(rows), out / "search.png")
    return summary


def _row(count: int, spent: float, found: dict[str, Any]) -> dict[str, Any]:
    """Numbers of one run."""
    names = (*_TIMES, "peak_memory", "iterations", "normalised_distance", "estimated_error")
    return {"data": count, "processor_seconds": spent, **{name: found[name] for name in names}}
