"""tsgdd study trust: the estimated error of random scenes against the true one, with FE2 of the same model as truth.

The true error is |z - z*| / |z*| of the states at all quadrature points, in the metric of the secants of FE2's z*.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dd_macro as dd
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from workflows.runs.fe2 import fe2
from workflows.runs.progress import tracked
from workflows.runs.sample import sample
from workflows.runs.solve import solve
from workflows.store.record import read_summary, write_summary, write_table
from workflows.store.stages import Stages
from workflows.studies.trust_scenes import CUBE, TrustScene, draw_scene

__all__ = ["score", "trust"]

Array = NDArray[np.float64]
Row = dict[str, Any]
_TOLERANCE = 1e-7
LARGE = 0.05
"""A true error that must not be missed; missed is what is estimated at less than half of it."""


def trust(
    out: Path,
    *,
    scenes: int,
    first: int = 0,
    largest: int = 8,
    most: int = 3000,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> Row:
    """The cube of random data and ``scenes`` random scenes, from number ``first`` on, of blocks and data at most.

    Writes trust.csv, trust.png and summary.json into ``out``; a scene that is there already is not run again.

    Raises:
        InputError: an argument is not valid.
    """
    for name, value, least in (("scenes", scenes, 1), ("first", first, 0), ("largest", largest, 2), ("most", most, 10)):
        if value < least:
            raise InputError(f"{name}: expected at least {least}, got {value}")
    stages = Stages(output_folder(out))
    drawn = [CUBE, *(draw_scene(first + k, largest=largest, most=most) for k in range(scenes))]
    rows: list[Row] = []
    for scene in tracked(drawn, "scenes"):
        asked = scene.parameters()
        folder = stages.run(f"scene-{scene.name}", asked, partial(_run, scene=scene))
        rows.append(asked | read_summary(folder, "study trust, a scene")["row"])
        say(_told(rows[-1]))
        write_table(out / "trust.csv", rows)
    parameters = {"scenes": scenes, "first": first, "largest": largest, "most": most}
    figures = {name: (value, "") for name, value in score(rows).items()} | {"rows": (rows, "")}
    summary = write_summary(out, command="study trust", parameters=parameters, figures=figures)
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.trust_figure import plot_trust

        save_figure(plot_trust(rows), out / "trust.png")
    return summary


def score(rows: Sequence[Row]) -> Row:
    """How the estimates did: of the scenes that were solved, the fraction within a factor of 2, and those missed."""
    solved = [row for row in rows if row["true"] is not None]
    true, estimate = (np.array([row[name] for row in solved], dtype=float) for name in ("true", "estimate"))
    within = (estimate <= 2.0 * true) & (estimate >= 0.5 * true)
    large = true > LARGE
    missed = large & ~(estimate >= 0.5 * true)
    by_method = {
        name: [int(np.sum(within[here])), int(here.sum())]
        for name in sorted({row["method"] for row in solved})
        if (here := np.array([row["method"] == name for row in solved])).any()
    }
    return {
        "solved": len(solved),
        "not_solved": len(rows) - len(solved),
        "within_factor_two": float(within.mean()) if len(solved) else None,
        "large_errors": int(large.sum()),
        "large_errors_missed": int(missed.sum()),
        "missed": [row["name"] for row, no in zip(solved, missed, strict=True) if no],
        "within_by_method": by_method,
    }


def _run(folder: Path, scene: TrustScene) -> None:
    """One scene into ``folder``: its row; the runs are not kept."""
    runs = output_folder(folder / "runs")
    row: Row = {"true": None, "estimate": None, "error_kind": "", "failed_checks": None, "distance": None}
    row |= {"outside": None, "seconds": None, "seconds_check": None, "reason": ""}
    try:
        row |= _errors(runs, scene)
    except (ConvergenceError, InputError) as error:
        row["reason"] = str(error)[:200]
    shutil.rmtree(runs)
    figures = {"row": (row, "")}
    write_summary(folder, command="study trust, a scene", parameters=scene.parameters(), figures=figures)


def _errors(runs: Path, scene: TrustScene) -> Row:
    data: Path | None = None
    more: dict[str, Any] = {}
    if scene.method == "adaptive":
        more = {"tissue": scene.tissue, "adaptation": dd.Adaptation(budget=scene.data)}
    else:
        data, (paths, steps) = runs / "data.h5", scene.paths
        of_data: dict[str, Any] = {"load": scene.box, "kind": scene.kind, "tissue": scene.tissue, "seed": scene.seed}
        sample(data, paths=paths, steps=steps, processes=1, plots=False, **of_data)
        more = {"order": 1 if scene.method == "order 1" else 2}
    found = solve(runs / "dd", data=data, scene=scene.scene, plots=False, **more)
    # data of the inside alone leave no edges that would be tissues of their own
    exact = scene.scene if scene.method == "adaptive" else replace(scene.scene, edges=False)
    options = dd.ReferenceOptions(tolerance=_TOLERANCE)
    fe2(runs / "fe2", scene=exact, tissue=scene.tissue, options=options, plots=False)
    return {
        "true": _true_error(runs / "dd", runs / "fe2"),
        "estimate": found["estimated_error"],
        "error_kind": found["error_kind"],
        "failed_checks": found["failed_checks"],
        "distance": found["normalised_distance"],
        "outside": found["outside_data"],
        "seconds": found["seconds"],
        "seconds_check": found["seconds_check"],
    }


def _true_error(found: Path, exact: Path) -> float:
    """|z - z*| / |z*| over all points, in the metric of the secants of z*, that of the run ``exact``."""
    a, b = (dd.read_quadrature(folder / "quadrature.h5") for folder in (found, exact))
    weight = b.weight.reshape(-1)
    strain, stress = b.mechanical_strain.reshape(-1, 6), b.mechanical_stress.reshape(-1, 6)
    points = np.arange(len(strain))
    metric = dd.secant_modulus(Dataset(strain, stress, b.stress_measure, path=points, step=0 * points))

    def length(strain: Array, stress: Array) -> float:
        return float(np.sqrt(weight @ (metric.whiten(strain, stress) ** 2).sum(axis=1)))

    off = length(a.mechanical_strain.reshape(-1, 6) - strain, a.mechanical_stress.reshape(-1, 6) - stress)
    return off / length(strain, stress)


def _told(row: Row) -> str:
    what = f"{row['name']}: {row['kind']} {row['elements']}, {row['load']} {row['strain']:.3g}, {row['method']}"
    if row["true"] is None:
        return f"{what}: {row['reason']}"
    shown = "unknown" if row["estimate"] is None else f"{row['estimate']:.2%}"
    return f"{what}, {row['data']} data: true error {row['true']:.2%}, estimated {shown}"
