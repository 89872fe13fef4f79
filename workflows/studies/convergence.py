"""tsgdd study convergence: does every solve of a grid of loads, metrics, data and methods converge, or say why not?

A claim of convergence is not taken on trust. A solve with nothing held claims a fixed point: one more plain iteration,
with a search that remembers nothing, must give the same state. The classical solve also ends where its distance has
settled: more plain iterations must not lower it. A second-order solve that held points which went back and forth says
how many: no other point may have another nearest datum, and its state must be the one of the data that it names.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

import dd_macro as dd
from dd_macro.methods.projection import relative_distance
from tsg_micro.data.dataset import Dataset, take
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from workflows.runs.progress import tracked
from workflows.runs.scene import Scene, read_material
from workflows.store.record import write_summary, write_table
from workflows.store.stages import Stages
from workflows.studies.methods import grid_methods
from workflows.studies.one_load import Study
from workflows.studies.prerequisites import Chain

__all__ = ["METRICS", "STATES", "check", "convergence"]

METRICS = {
    "default": ("auto", 1.0),
    "visited": ("visited", 1.0),
    "secant": ("secant", 1.0),
    "0.1 default": ("auto", 0.1),
    "10 default": ("auto", 10.0),
}
"""The metrics of the grid, and what they are multiplied by."""
STATES = ("fixed point", "distance settled", "points held", "cycle cut short", "not converged", "not verified")
"""How a solve can end; the last one is a defect. A cycle is cut short where the solve held points, and says so, and the
state would go on moving by more than ``_LITTLE`` if it did not."""
_SAME, _SETTLED = 1e-4, 1e-6
"""Relative changes of a state and of a distance that count as none. The first is small beside what any data leave open,
and large beside what the metric makes of a tolerance: projections that end with a step of 1e-7 may have 1e-5 to go."""
_LITTLE = 0.01
_MORE = 20
"""Plain iterations that must not lower a distance which has settled."""
_SIZES = (10, 100, 1000, 10_000)


def convergence(
    out: Path,
    *,
    chain: Chain,
    loads: Sequence[str] = ("stretch", "shear"),
    data: Path | None = None,
    sizes: Sequence[int] | None = None,
    plots: bool = True,
    stages: Stages | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Solve every cell of the grid and check what it claims; convergence.csv has a row for each.

    The data of ``sizes`` are the first ones of one random order; 10, 100, 1000 and 10,000 of them, as far as there are
    so many, if None. ``data`` is a file for a single load, else they are sampled. ``chain.blocks`` are the elements.

    Raises:
        InputError: an argument or a file is not valid.
        ConvergenceError: data could not be sampled.
    """
    if not loads or (data is not None and len(loads) > 1):
        raise InputError(f"loads: expected one beside data, else at least one, got {list(loads)}")
    if sizes is not None and min(sizes, default=0) < 4:
        raise InputError(f"sizes: expected numbers of at least 4, from which tangents can be estimated, got {sizes}")
    studies = [Study(out, load, chain, data=data) for load in loads]  # raises where a load is not valid
    given = None if data is None else read_material(data, chain.scene(loads[0]))
    stages = stages or Stages(output_folder(out), say)
    rows: list[dict[str, Any]] = []
    for study in tracked(studies, "loads"):
        scene = chain.scene(study.load)
        dataset = given or read_material(chain.data(stages, study.load), scene)
        if max(sizes or [0]) > len(dataset):
            raise InputError(f"sizes: expected at most {len(dataset)}, the number of data, got {max(sizes or [0])}")
        few = [size for size in _SIZES if size <= len(dataset)] or [len(dataset)]
        for row in _cells(scene, dataset, sorted(set(sizes or few))):
            rows.append({"load": study.load} | row)
            cell = f"{study.load}, {row['metric']}, {row['data']} data, {row['method']}"
            say(f"{cell:62} {row['state']}, {row['iterations']} iterations")
        write_table(out / "convergence.csv", rows)
    count = Counter(row["state"] for row in rows)
    summary = write_summary(
        out,
        command="study convergence",
        parameters={**chain.parameters(), "loads": loads, "data": data, "sizes": sorted({row["data"] for row in rows})},
        figures={
            "cells": (len(rows), ""),
            "counts": ({state: count[state] for state in STATES}, ""),
            "counts_by_method": (
                {
                    name: {state: sum(r["state"] == state for r in rows if r["method"] == name) for state in STATES}
                    for name in dict.fromkeys(row["method"] for row in rows)
                },
                "",
            ),
            "not_at_rest": ([row for row in rows if row["state"] in STATES[3:]], ""),
            "held_share": (_largest(rows, "held_share"), "largest part of the points that a solve held"),
            "held_moves": (_largest(rows, "moved", STATES[3]), "largest change of a state if no points were held"),
            "fixed_moves": (_largest(rows, "moved", STATES[0]), "largest change of a state at a fixed point"),
            "settled_fell": (_largest(rows, "fell", STATES[1]), "largest fall of a distance that had settled"),
            "rows": (rows, ""),
        },
    )
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.convergence_figure import plot_grid

        save_figure(plot_grid(rows), out / "convergence.png")
    return summary


def _largest(rows: list[dict[str, Any]], name: str, state: str | None = None) -> float:
    return max((row[name] for row in rows if row[name] is not None and state in (None, row["state"])), default=0.0)


def _cells(scene: Scene, dataset: Dataset, sizes: list[int]) -> Iterator[dict[str, Any]]:
    """All cells of one load."""
    problem = scene.problem(MPI.COMM_SELF)
    order = np.random.default_rng([0, len(dataset)]).permutation(len(dataset))
    for name, (known, factor) in METRICS.items():
        for size in sizes:
            few = take(dataset, order[:size])
            made: dict[bytes, dd.Projection] = {}
            for key, method in grid_methods().items():
                data = method.given(few)
                try:
                    metric = dd.choose_metric(known, problem, data, order=method.order)
                    metric = dd.Metric(factor * metric.C, metric.reason)
                    at = metric.C.tobytes()
                    made[at] = made.get(at) or dd.project(problem, metric)
                    row = _cell(made[at], method, data)
                except ConvergenceError as error:
                    row = _no(error)
                yield {"metric": name, "data": size, "method": key} | row


def _cell(projection: dd.Projection, method: dd.DataMethod, dataset: Dataset) -> dict[str, Any]:
    """Solve and check.

    Raises:
        ConvergenceError: the solve did not converge.
    """
    search = method.search(dataset, projection.metric)
    return check(projection, method, search, method.solve(projection, search))


def _no(error: ConvergenceError) -> dict[str, Any]:
    nothing = dict.fromkeys(("held", "held_share", "changed", "moved", "fell"))
    return {"state": "not converged", "reason": str(error), "iterations": len(error.history), **nothing}


def check(
    projection: dd.Projection, method: dd.DataMethod, search: dd.MaterialSearch, result: dd.DataDrivenResult
) -> dict[str, Any]:
    """What state (of ``STATES``) the result of ``method`` is in, found anew from its fields, on one rank.

    ``held`` points, their share, and the points ``changed``, whose nearest datum is another than the one they have. A
    plain iteration has ``moved`` the state by that, relative in the metric; ``_MORE`` of them lower the distance to
    the data, of which it ``fell`` by that part (classical only).
    """
    z, held = result.mechanical, int(getattr(result, "held", 0))
    search.forget()
    index, gap = search.nearest(search.metric.whiten(z.strain, z.stress))
    changed = int((index != result.index).sum())
    row: dict[str, Any] = {"state": STATES[5], "reason": result.reason, "iterations": result.iterations}
    row |= {"held": held, "held_share": held / len(index), "changed": changed, "moved": None, "fell": None}
    try:
        row["moved"] = relative_distance(projection.operator, projection.metric, method.once(projection, search, z), z)
        if projection.residual(z.nominal_stress) > _SAME:
            return row
        if method.order == 1:
            row["fell"] = _fall(projection, method, search, z, gap)
            if changed == 0 and row["moved"] <= _SAME:
                row["state"] = STATES[0]
            elif row["fell"] <= _SETTLED:
                row["state"] = STATES[1]
        elif held == 0:
            if row["moved"] <= _SAME and (changed == 0 or method.averages):
                row["state"] = STATES[0]
        elif method.averages or (changed <= held and _is_of_its_data(projection, method, search, result)):
            row["state"] = STATES[2 if row["moved"] <= _LITTLE else 3]
    except ConvergenceError as error:
        row["reason"] += f"; the check failed: {error}"
    return row


def _fall(
    projection: dd.Projection, method: dd.DataMethod, search: dd.MaterialSearch, z: dd.MechanicalState, gap: np.ndarray
) -> float:
    """Part by which more plain iterations lower the distance to the nearest data."""
    w = projection.operator.weights
    begin = float(np.sqrt(w @ gap**2))
    for _ in range(_MORE):
        z = method.once(projection, search, z)
    _, gap = search.nearest(search.metric.whiten(z.strain, z.stress))
    return 1.0 - float(np.sqrt(w @ gap**2)) / begin if begin > 0 else 0.0


def _is_of_its_data(
    projection: dd.Projection, method: dd.DataMethod, search: dd.MaterialSearch, result: dd.DataDrivenResult
) -> bool:
    """Whether the state is the one that the data which the result names lead to."""
    z = result.mechanical
    found = method.state_of(projection, search, result.index, z)
    return relative_distance(projection.operator, projection.metric, found, z) <= _SAME
