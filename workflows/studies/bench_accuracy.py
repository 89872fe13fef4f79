"""tsgdd bench accuracy: how far default answers are from the full tensegrity, on a family of scenes, and why.

Each scene is solved by adaptive data with default options, and by every bar and tendon, a sheet held flat. What is
left between them is taken apart: the data (the same model with an RVE at every point, FE2), the elements (against a
mesh of half their size), and the rest, which is the scale: a continuum of blocks, and its edges. All of it for the
inner blocks, those at clamps, those at free sides, and all blocks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dd_macro as dd
from dd_macro.results.compare_bodies import inner_blocks
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from tsg_micro.data.mandel import pressure, von_mises
from workflows.runs.progress import tracked
from workflows.runs.tensegrity import read_blocks
from workflows.store.record import read_summary, write_summary, write_table
from workflows.store.stages import Stages
from workflows.studies.accuracy_cases import CASES, ZONES, Case

__all__ = ["CASES", "ZONES", "Case", "accuracy"]

Array = NDArray[np.float64]
MEASURE = "first_piola"
_INVARIANTS = {"p": pressure, "q": von_mises}


def accuracy(
    out: Path,
    *,
    cases: Sequence[Case] = CASES,
    options: Mapping[str, Any] | None = None,
    parts: bool = True,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Errors of p (stretch) or q (shear) of every case; accuracy.csv has a row for each case and zone.

    ``options`` are those of the macroscopic scene that differ from the defaults. Without ``parts`` the error is not
    taken apart, which saves FE2 and the fine mesh. Full tensegrities are stages, which a later run finds there.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: a full tensegrity did not converge.
    """
    if not cases:
        raise InputError("cases: expected at least one, got none")
    models = [case.check(options or {}) for case in cases]  # bad options come first
    stages = Stages(output_folder(out), say)
    rows: list[dict[str, Any]] = []
    for case in tracked(cases, "cases"):
        dns = case.dns(stages, say)
        for row in _rows(case, options or {}, dns, parts=parts):
            rows.append(row)
            if row["zone"] in ("inner", "all"):
                shown = row["note"] if row["error"] is None else f"{row['error']:.2%}"
                say(f"{case.name:24} {row['zone']:6} {row['symbol']}: {shown}, {row['seconds']:.2f} s")
        write_table(out / "accuracy.csv", rows)
    model = models[0]
    worst = {zone: max(row["error"] or 0.0 for row in rows if row["zone"] == zone) for zone in ZONES}
    summary = write_summary(
        out,
        command="bench accuracy",
        parameters={"cases": [case.values() for case in cases], **model, "parts": parts},
        figures={
            "rows": (rows, "errors relative, times s"),
            "worst": (worst, "1"),
            "failed": ([row["case"] for row in rows if row["note"] and row["zone"] == "all"], ""),
        },
    )
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.accuracy_figure import plot_accuracy

        save_figure(plot_accuracy(rows, model), out / "accuracy.png")
    return summary


def _rows(case: Case, options: Mapping[str, Any], dns: Path, *, parts: bool) -> list[dict[str, Any]]:
    """A row for every zone; errors None where the solve failed, with the reason, or the zone has no block."""
    blocks = read_blocks(dns, MEASURE)
    assert blocks.midpoint is not None
    order = np.argsort(_places(blocks.midpoint, case.block))
    midpoint, true = blocks.midpoint[order], blocks.stress[order]
    full = float(read_summary(dns, "dns")["seconds"])
    named: dict[str, Any] = {"case": case.name, "symbol": case.symbol}
    begin = time.perf_counter()
    try:
        solution = case.solve(options)
        assert isinstance(solution, dd.AdaptiveResult)
        times = {"seconds": time.perf_counter() - begin, "dns_seconds": full, "note": ""}
        states = {"true": true, "ours": _block_stress(case, solution)}
        rves = solution.rounds[-1].rves
        if parts:
            states["exact"] = _block_stress(case, case.solve(options, exact=True))
            states["fine"] = _block_stress(case, case.solve(options, refine=2))
    except ConvergenceError as error:
        none = {**dict.fromkeys(("error", "data", "element", "rest", "rves")), "seconds": time.perf_counter() - begin}
        return [{**named, "zone": zone, **none, "dns_seconds": full, "note": str(error)} for zone in ZONES]
    values = {name: _INVARIANTS[case.symbol](stress) for name, stress in states.items()}
    pairs = {
        "error": ("ours", "true"),
        "data": ("ours", "exact"),
        "element": ("ours", "fine"),
        "rest": ("fine", "true"),
    }
    rows = []
    for zone, here in _zones(case, midpoint).items():
        size = np.linalg.norm(values["true"][here])
        errors = {
            name: float(np.linalg.norm((values[a] - values[b])[here]) / size) if b in values and a in values else None
            for name, (a, b) in (pairs if here.any() else {}).items()
        }
        rows.append({**named, "zone": zone, **dict.fromkeys(pairs), **errors, "rves": rves, **times})
    return rows


def _places(midpoint: Array, block: float) -> NDArray[np.int64]:
    """A number for the block around each midpoint (n, 3), that rises along z, then y, then x."""
    index = np.floor(midpoint / block).astype(np.int64)
    index -= index.min(axis=0)
    return np.ravel_multi_index(tuple(index.T), tuple(index.max(axis=0) + 1))


def _block_stress(case: Case, solution: dd.Solution) -> Array:
    """Mean stress (blocks, 6) of the elements of every block, Pa, in the order of their places."""
    operator, shown = solution.problem.operator, dd.in_space(solution, MEASURE)
    _, block = np.unique(_places(operator.cell_corners.mean(axis=1), case.block), return_inverse=True)
    volume = operator.weights.reshape(len(block), -1).sum(axis=1)
    mean = operator.cell_mean(shown.mechanical.stress) * volume[:, None]
    total = np.zeros((block.max() + 1, 6))
    np.add.at(total, block, mean)
    return total / np.bincount(block, volume)[:, None]


def _zones(case: Case, midpoint: Array) -> dict[str, NDArray[np.bool_]]:
    """Which blocks are in which zone."""
    inner, rows = inner_blocks(midpoint, case.block), case.clamped(midpoint)
    return dict(zip(ZONES, (inner, rows, ~inner & ~rows, np.ones(len(midpoint), dtype=bool)), strict=True))
