"""tsgdd bench frontier: run time against error, of all that solves the same scene; the tensegrity is the reference."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.dataset import Dataset, take
from tsg_micro.errors import ConvergenceError, InputError
from tsg_micro.files import output_folder
from workflows.loads import SYMBOLS
from workflows.record import read_summary, write_summary, write_table
from workflows.reference import describe, read_blocks, solution_errors
from workflows.scene import Scene, with_tangents
from workflows.trial import Study, make_bench

__all__ = ["frontier"]

_METRICS = ("tangent", "visited", "secant")
_REPEATS = 3
"""Every point is timed as often, and the shortest time counts."""


@dataclass(frozen=True)
class _Point:
    """A way to solve the scene: what it took, and how far its p or q is from the tensegrity's (l2)."""

    method: str
    data: int
    seconds_sampling: float
    seconds_solve: float
    """All that the scene needs once the data are there: mesh, metric or fit, matrix, iterations."""
    error_mech: float | None
    error_mat: float | None
    """None: a law has no material solution."""
    error_mech_all: float | None
    error_mat_all: float | None
    note: str


def frontier(study: Study, *, plots: bool = True) -> dict[str, Any]:
    """Time and error of data-driven solves (numbers of data, metrics) and of laws fitted to the same data.

    Where the tensegrity and the data are stages, all is run on this machine and the ratios are of one run.
    frontier.csv has a row for every point. None of the points is tuned to the reference.

    Raises:
        InputError: an argument or a file is not valid.
        ConvergenceError: a solve did not converge.
    """
    out, load = output_folder(study.out), study.load
    found = study.prepare()
    dataset, scene = found.dataset, found.scene
    blocks = read_blocks(found.dns, dataset.stress_measure)
    full = read_summary(found.dns, "dns")
    sampled = read_summary(found.data, "sample")
    if sampled.get("seconds_in_file") is None:
        raise InputError(f"data: expected the time of sampling in the summary beside {found.data}, got none")
    per_datum = sampled["seconds_in_file"] / sampled["points_in_file"]
    small = take(dataset, np.arange(min(10, len(dataset))))
    for _ in _solve_all(scene, small, blocks, 0.0):  # kernels are compiled and libraries loaded before the clock runs
        pass

    points: list[_Point] = []
    order = np.random.default_rng([0, len(dataset)]).permutation(len(dataset))
    for size in sorted({max(1, len(dataset) // 100), max(1, len(dataset) // 10), len(dataset)}):
        for point in _solve_all(scene, take(dataset, np.sort(order[:size])), blocks, per_datum):
            points.append(point)
            shown = point.note if point.error_mech is None else f"error of {SYMBOLS[load]} {point.error_mech:.1%}"
            study.say(
                f"{point.method:34} {point.data:6} data: {shown}, {point.seconds_solve:.2f} s and "
                f"{point.seconds_sampling:.1f} s of sampling"
            )
    rows = [vars(point) for point in points]
    write_table(out / "frontier.csv", rows)
    best = min((p for p in points if p.error_mech is not None), key=lambda p: p.error_mech or 0.0)
    summary = write_summary(
        out,
        command="bench frontier",
        parameters=study.parameters(found),
        figures={
            "symbol": (SYMBOLS[load], ""),
            "dns_seconds": (full["seconds"], "s"),
            "dns_resumed_after_step": (full["resumed_after_step"], ""),
            "reference": (describe(full), ""),
            "dns_machine": (full["machine"], ""),
            "points": (rows, ""),
            "most_accurate": (f"{best.method}, {best.data} data", ""),
            "dns_over_solve": ({_name(p): full["seconds"] / p.seconds_solve for p in points}, "1"),
            "dns_over_all": (
                {_name(p): full["seconds"] / (p.seconds_solve + p.seconds_sampling) for p in points},
                "1",
            ),
        },
    )
    if plots:
        from workflows.plot_frontier import plot_frontier, save_figure

        save_figure(plot_frontier(rows, full["seconds"], summary), out / "frontier.png")
    return summary


def _name(point: _Point) -> str:
    return f"{point.method}, {point.data} data"


def _solve_all(scene: Scene, dataset: Dataset, blocks: Dataset, per_datum: float) -> Iterator[_Point]:
    """Every method with these data; each builds all that it needs itself."""
    sampling = per_datum * len(dataset)
    for name in _METRICS:
        yield _data_driven(scene, name, dataset, blocks, sampling)
    yield _data_driven(scene, "tangent", dataset, blocks, sampling, second_order=True)
    yield _law(scene, "linear elastic law", dd.fit_linear, dataset, blocks, sampling)
    yield _law(scene, "polynomial energy law", dd.fit_polynomial, dataset, blocks, sampling)


def _data_driven(
    scene: Scene, metric: str, dataset: Dataset, blocks: Dataset, sampling: float, *, second_order: bool = False
) -> _Point:
    """With data as points, or with their tangent spaces."""
    seconds = np.inf
    for _ in range(_REPEATS):
        begin = time.perf_counter()
        bench = make_bench(scene, metric, dataset, blocks, order=2 if second_order else 1)
        chosen = bench.projection.metric
        result: dd.DataDrivenResult
        if second_order:
            result = dd.solve_second_order(bench.projection, dd.TangentSearch(with_tangents(dataset), chosen))
        else:
            result = dd.solve(bench.projection, dd.MaterialSearch(dataset, chosen))
        seconds = min(seconds, time.perf_counter() - begin)
    row = solution_errors(bench.operator, chosen, result, blocks).row(bench.symbol)
    errors = {name: row[name] for name in ("error_mech", "error_mat", "error_mech_all", "error_mat_all")}
    note = f"{result.iterations} iterations, distance {row['distance']:.1%}"
    method = "second-order data" if second_order else f"data-driven, metric {metric}"
    return _Point(method, len(dataset), sampling, seconds, **errors, note=note)


def _law(
    scene: Scene, name: str, fit: Callable[[Dataset], dd.Law], dataset: Dataset, blocks: Dataset, sampling: float
) -> _Point:
    """A law fitted to the data and solved by Newton's method; a fit or solve that fails is a point without errors."""
    seconds = np.inf
    begin = time.perf_counter()
    try:
        for _ in range(_REPEATS):
            begin = time.perf_counter()
            law = fit(dataset)
            domain = scene.build(MPI.COMM_SELF)
            operator = scene.operator(domain)
            result = dd.solve_law(operator, law, scene.conditions(domain))
            seconds = min(seconds, time.perf_counter() - begin)
    except (ConvergenceError, InputError) as error:
        nothing = dict.fromkeys(("error_mech", "error_mat", "error_mech_all", "error_mat_all"))
        seconds = time.perf_counter() - begin
        return _Point(name, len(dataset), sampling, seconds, **nothing, note=f"failed: {error}")
    assert blocks.midpoint is not None
    solution = dd.BlockStress(
        operator.cell_corners.mean(axis=1), operator.cell_mean(result.mechanical.stress), blocks.stress_measure
    )
    reference = dd.BlockStress(blocks.midpoint, blocks.stress, blocks.stress_measure)
    found = getattr(dd.compare_blocks(solution, solution, reference), f"error_{SYMBOLS[scene.load]}_mech")
    note = f"{result.iterations} Newton iterations"
    return _Point(name, len(dataset), sampling, seconds, found.l2, None, found.l2_all, None, note)
