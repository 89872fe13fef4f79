"""tsgdd study causes: what the error of the data-driven solution is made of, found by changing one thing at a time."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import dd_macro as dd
from tsg_micro.dataset import Dataset, convert_dataset, read_dataset
from tsg_micro.files import atomic_path, output_folder
from workflows.chain import Chain
from workflows.loads import SYMBOLS, check_load
from workflows.record import write_summary
from workflows.reference import check_same_scene, read_blocks
from workflows.scene import Scene, read_material
from workflows.stages import Stages
from workflows.trial import make_bench

__all__ = ["causes"]

_SHOWN = ("error_mech", "error_mat", "error_mech_all", "error_mat_all", "distance", "distance_all")


def causes(
    out: Path,
    *,
    load: str,
    chain: Chain,
    dns: Path | None = None,
    data: Path | None = None,
    stages: Stages | None = None,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Solve the scene again and again, each time with one thing changed: metric, data, stress measure, RVE, reference.

    ``dns`` and ``data`` as in ``tsgdd study data-size``; all else that is needed are stages of
    ``stages``, by default in ``out``.
    causes.csv has a row for every change.

    Raises:
        InputError: an argument or a file is not valid.
        ConvergenceError: a solve did not converge.
    """
    check_load(load, chain.strain)
    out = output_folder(out)
    stages = stages or Stages(out, say)
    dns = dns or chain.dns(stages, load, say)
    data = data or chain.data(stages, load)
    scene = Scene(load, chain.strain, elements=chain.elements)
    dataset = read_material(data, scene)
    same = {"load": load, "strain": chain.strain}
    check_same_scene({**same, "bar_force": chain.bar_force}, dns, "the study")
    check_same_scene({**same, "bar_force": dataset.parameters.get("bar_force")}, dns, str(data))

    rows: list[dict[str, Any]] = []
    free = chain.dns(stages, load, say, flat=False)
    for cause, change, metric, material, folder in _changes(chain, stages, load, dataset, (dns, free)):
        blocks = read_blocks(folder, material.stress_measure)
        bench = make_bench(scene, metric, material, blocks)
        row, _ = bench.solve(material)
        own, _ = bench.solve(blocks)
        rows.append({"cause": cause, "change": change, "data": len(material), **row, "own_distance": own["distance"]})
        rows[-1]["own_error_mech"], rows[-1]["own_error_mat"] = own["error_mech"], own["error_mat"]
        say(
            f"{cause:16} {change:40} error of {SYMBOLS[load]}: mechanical {row['error_mech']:6.1%}, material "
            f"{row['error_mat']:6.1%}; distance {row['distance']:5.1%}, tensegrity's own data {own['distance']:5.1%}"
        )
    with atomic_path(out / "causes.csv") as temporary, temporary.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    base = rows[0]
    worst = {name: max(rows[1:], key=lambda row: abs(row[name] - base[name])) for name in ("error_mech", "error_mat")}
    summary = write_summary(
        out,
        command="study causes",
        parameters={"load": load, **chain.parameters(), "dns": dns, "data": data},
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


def _changes(
    chain: Chain, stages: Stages, load: str, dataset: Dataset, references: tuple[Path, Path]
) -> Iterator[tuple[str, str, dd.Metric | str, Dataset, Path]]:
    """Cause, change, metric, data and reference of every solve; the first one is that of all other studies."""
    flat, free = references
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
        return convert_dataset(read_dataset(many.data(stages, box, name, **more)), dataset.stress_measure)

    yield "data", "a tenth of them", "auto", sampled(f"data-{load}-few", factor=0.1), flat
    yield "data", "box inplane", "auto", sampled("data-inplane", "inplane"), flat
    yield "data", "box inplane, four times as many", "auto", sampled("data-inplane-many", "inplane", 4.0), flat
    for n in (1, 3):
        twice = sampled(f"data-{load}-duplicated-{n}", factor=0.1, images="duplicated", blocks=(n, n, 1))
        yield "RVE", f"images twice, {n} x {n}, a tenth of data", "auto", twice, flat
