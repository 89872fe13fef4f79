"""tsgdd bench rves: RVE states a second, alone and in batches, tangents included, and how they differ.

The same loading paths are followed one state after the other and all at once, in turn, by every one of some processes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES, strain_path
from tsg_micro.continuum.warm_rve import WarmRVE
from tsg_micro.continuum.warm_states import WarmStates
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from workflows.store.limits import check_memory
from workflows.store.record import write_summary, write_table

__all__ = ["RVES", "rves"]

Array = NDArray[np.float64]
_SHEET = RVESpec.of_kind("sheet", Tissue())
RVES = {
    "sheet": (_SHEET, "inplane"),
    "sheet, all six strains": (replace(_SHEET, free=()), "full"),
    "bulk": (RVESpec.of_kind("bulk", Tissue()), "full"),
}
"""RVEs of one block, and the box that they are sampled in."""
_PER_PROCESS, _PER_PATH, _PER_STEP = 1e8, 2e4, 48
"""Bytes, roughly: of a process, of the states of a path, of a strain on it."""


def rves(
    out: Path, *, paths: int, steps: int, processes: int, say: Callable[[str], None] = lambda text: None
) -> dict[str, Any]:
    """``paths`` paths of ``steps`` states of every RVE in each of the ``processes``.

    Raises:
        InputError: a number is less than 1, or there is not enough memory.
    """
    for name, value in (("paths", paths), ("steps", steps), ("processes", processes)):
        if value < 1:
            raise InputError(f"{name}: expected at least 1, got {value}")
    needed = processes * (_PER_PROCESS + paths * (_PER_PATH + _PER_STEP * steps))
    check_memory(f"paths, steps, processes: {paths}, {steps} and {processes}", needed)
    out = output_folder(out)
    rows = []
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        for name in RVES:
            futures = [pool.submit(_follow, name, part * paths, paths, steps) for part in range(processes)]
            row = _joined([future.result() for future in futures])
            rows.append({"rve": name, **row})
            say(
                f"{name}: {row['alone_per_second']:.0f} states a second alone, {row['batch_per_second']:.0f} batched, "
                f"{1e3 * row['alone_cpu']:.2f} and {1e3 * row['batch_cpu']:.2f} ms of CPU time each; "
                f"they differ by {max(row['stress_difference'], row['tangent_difference']):.1e}"
            )
    write_table(out / "rves.csv", rows)
    parameters = {"paths": paths, "steps": steps, "processes": processes}
    return write_summary(out, command="bench rves", parameters=parameters, figures={"rows": (rows, "s, 1/s, 1")})


def _joined(parts: list[dict[str, float]]) -> dict[str, float]:
    """All processes: states a second of the wall's time, CPU time of a state, and the largest differences."""
    states = sum(part["states"] for part in parts)
    row: dict[str, float] = {"states": states}
    for way in _WAYS:
        row[f"{way}_per_second"] = sum(part["states"] / part[f"{way}_wall"] for part in parts)
        row[f"{way}_cpu"] = sum(part[f"{way}_cpu"] for part in parts) / states
    return row | {name: max(part[name] for part in parts) for name in ("stress_difference", "tangent_difference")}


def _follow(name: str, first: int, paths: int, steps: int) -> dict[str, float]:
    """One process: seconds of its states, alone and in batches, and how these differ relative to the largest."""
    spec, box = RVES[name]
    strain = np.array([strain_path(BOXES[box], steps=steps, seed=0, path=first + k) for k in range(paths)])
    with threadpool_limits(1):
        warm = WarmRVE(spec.build())
        found = {way: warm.reference.take([0] * paths) for way in _WAYS}
        warm.solve_many(strain[:, 0], found["batch"])  # what is made at the first call
        row = {f"{way}_{clock}": 0.0 for way in _WAYS for clock in ("wall", "cpu")}
        row |= {"states": float(paths * steps), "stress_difference": 0.0, "tangent_difference": 0.0}
        for goal in strain.swapaxes(0, 1):
            for way, solve in _WAYS.items():
                wall, cpu = time.perf_counter(), time.process_time()
                found[way] = solve(warm, goal, found[way])
                row[f"{way}_wall"] += time.perf_counter() - wall
                row[f"{way}_cpu"] += time.process_time() - cpu
            for key in ("stress", "tangent"):
                one, other = (getattr(states, key) for states in found.values())
                apart = float(np.abs(one - other).max() / np.abs(one).max())
                row[f"{key}_difference"] = max(row[f"{key}_difference"], apart)
    return row


def _alone(warm: WarmRVE, strain: Array, states: WarmStates) -> WarmStates:
    return WarmStates.join([warm.solve(goal, states, k) for k, goal in enumerate(strain)])


def _batch(warm: WarmRVE, strain: Array, states: WarmStates) -> WarmStates:
    return warm.solve_many(strain, states)[0]


_WAYS = {"alone": _alone, "batch": _batch}
