"""tsgdd study causes: what the error of the data-driven solution is made of, found by changing one thing at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import dd_macro as dd
from tsg_micro.dataset import Dataset, convert_dataset, read_dataset
from tsg_micro.files import output_folder
from workflows.loads import SYMBOLS
from workflows.record import write_summary, write_table
from workflows.reference import read_blocks
from workflows.trial import Inputs, Study, make_bench

__all__ = ["causes"]

_SHOWN = ("error_mech", "error_mat", "error_mech_all", "error_mat_all", "distance", "distance_all")


def causes(study: Study, *, plots: bool = True) -> dict[str, Any]:
    """Solve the scene again and again, each time with one thing changed: metric, data, stress measure, RVE, reference.

    The data and the buckled reference that this takes are stages of the study. causes.csv has a row for every change.

    Raises:
        InputError: an argument or a file is not valid.
        ConvergenceError: a solve did not converge.
    """
    out, load = output_folder(study.out), study.load
    found = study.prepare()
    rows: list[dict[str, Any]] = []
    for cause, change, metric, material, folder in _changes(study, found):
        blocks = read_blocks(folder, material.stress_measure)
        bench = make_bench(found.scene, metric, material, blocks)
        row, _ = bench.solve(material)
        own, _ = bench.solve(blocks)
        rows.append({"cause": cause, "change": change, "data": len(material), **row, "own_distance": own["distance"]})
        rows[-1]["own_error_mech"], rows[-1]["own_error_mat"] = own["error_mech"], own["error_mat"]
        study.say(
            f"{cause:16} {change:40} error of {SYMBOLS[load]}: mechanical {row['error_mech']:6.1%}, material "
            f"{row['error_mat']:6.1%}; distance {row['distance']:5.1%}, tensegrity's own data {own['distance']:5.1%}"
        )
    write_table(out / "causes.csv", rows)
    base = rows[0]
    worst = {name: max(rows[1:], key=lambda row: abs(row[name] - base[name])) for name in ("error_mech", "error_mat")}
    summary = write_summary(
        out,
        command="study causes",
        parameters=study.parameters(found),
        figures={
            "symbol": (SYMBOLS[load], ""),
            "rows": (rows, ""),
            "largest_change": ({name: f"{row['cause']}: {row['change']}" for name, row in worst.items()}, ""),
        },
    )
    if plots:
        from workflows.plot_causes import plot_causes, save_figure

        save_figure(plot_causes(rows, SYMBOLS[load]), out / "causes.png")
    return summary


def _changes(study: Study, found: Inputs) -> Iterator[tuple[str, str, dd.Metric | str, Dataset, Path]]:
    """Cause, change, metric, data and reference of every solve; the first one is that of all other studies."""
    chain, load, dataset, flat = study.chain, study.load, found.dataset, found.dns
    free = chain.dns(found.stages, load, study.say, flat=False)
    yield "as it is", f"{len(dataset)} data of the box {load}", "auto", dataset, flat
    yield "reference", "the sheet may leave its plane", "auto", dataset, free
    mean = dd.metric_from_dataset(dataset)
    for factor in (0.1, 0.3, 3.0, 10.0):
        yield (
            "metric",
            f"{factor:g} times as stiff",
            dd.Metric(factor * mean.C, f"{factor:g} {mean.reason}"),
            dataset,
            flat,
        )
    for name, text in (("visited", "mean tangent where the scene is"), ("secant", "secant modulus")):
        yield "metric", text, name, dataset, flat
    for measure in ("second_piola", "kirchhoff", "cauchy"):
        yield "stress measure", measure.replace("_", " "), "auto", convert_dataset(dataset, measure), flat

    def sampled(name: str, box: str = load, factor: float = 1.0, **more: Any) -> Dataset:
        many = replace(chain, paths=max(1, round(factor * chain.paths)))
        return convert_dataset(read_dataset(many.data(found.stages, box, name, **more)), dataset.stress_measure)

    yield "data", "a tenth of them", "auto", sampled(f"data-{load}-few", factor=0.1), flat
    yield "data", "box inplane", "auto", sampled("data-inplane", "inplane"), flat
    yield "data", "box inplane, four times as many", "auto", sampled("data-inplane-many", "inplane", 4.0), flat
    for n in (1, 3):
        twice = sampled(f"data-{load}-duplicated-{n}", factor=0.1, images="duplicated", blocks=(n, n, 1))
        yield "RVE", f"images twice, {n} x {n}, a tenth of data", "auto", twice, flat
