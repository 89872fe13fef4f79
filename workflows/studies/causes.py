"""tsgdd study causes: what the error of the data-driven solution is made of, found by changing one thing at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import dd_macro as dd
from tsg_micro.data.dataset import Dataset, convert_dataset
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.errors import ConvergenceError
from tsg_micro.data.files import output_folder
from tsg_micro.data.stress import measure_words
from workflows.runs.loads import LOADS
from workflows.runs.progress import tracked
from workflows.runs.tensegrity import read_blocks
from workflows.store.record import write_summary, write_table
from workflows.studies.one_load import COLUMNS, Bench, Inputs, Study, make_bench

__all__ = ["causes"]

_OWN = ("distance", "error_mech", "error_mat")
_AS_IT_IS, _FEW = "nothing changed", "a tenth of them"


@dataclass(frozen=True)
class _Change:
    """One solve: what is changed, and the solve that it is to be held against."""

    cause: str
    change: str
    material: Dataset
    dns: Path
    metric: dd.Metric | str = "auto"
    against: str = _AS_IT_IS


def causes(study: Study, *, plots: bool = True) -> dict[str, Any]:
    """Solve the scene again and again, each time with one thing changed: metric, data, stress measure, RVE, reference.

    The data and the buckled reference that this takes are stages of the study. causes.csv has a row for every change.

    Raises:
        InputError: an argument or a file is not valid.
        ConvergenceError: a stage, or the solve with nothing changed, did not converge.
    """
    out, load = output_folder(study.out), study.load
    found = study.prepare()
    rows: list[dict[str, Any]] = []
    for change in tracked(list(_changes(study, found)), "changes"):
        blocks = read_blocks(change.dns, change.material.stress_measure)
        bench = make_bench(found.scene, change.metric, change.material, blocks)
        row, own = _solve(bench, change.material), _solve(bench, blocks)
        named = {"cause": change.cause, "change": change.change, "against": change.against}
        rows.append(named | {"data": len(change.material)} | row | {f"own_{name}": own[name] for name in _OWN})
        if row["error_mech"] is None or own["distance"] is None:
            study.say(f"{change.cause:14} {change.change:42} did not converge")
            continue
        study.say(
            f"{change.cause:14} {change.change:42} error of {LOADS[load].symbol}: mechanical {row['error_mech']:6.1%}, "
            f"material {row['error_mat']:6.1%}; distance {row['distance']:5.1%}, own data {own['distance']:5.1%}"
        )
    write_table(out / "causes.csv", rows)
    if rows[0]["error_mech"] is None:
        raise ConvergenceError("study causes: the solve with nothing changed did not converge")
    base = {row["change"]: row for row in rows}
    drops = {
        name: max(
            (
                (base[row["against"]][name] - row[name], row)
                for row in rows[1:]
                if None not in (row[name], base[row["against"]][name])
            ),
            key=lambda found: found[0],
        )
        for name in ("error_mech", "error_mat")
    }
    summary = write_summary(
        out,
        command="study causes",
        parameters=study.parameters(found),
        figures={
            "symbol": (LOADS[load].symbol, ""),
            "rows": (rows, ""),
            "largest_drop": (
                {name: {"by": by, "change": f"{row['cause']}: {row['change']}"} for name, (by, row) in drops.items()},
                "1",
            ),
        },
    )
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.causes_figure import plot_causes

        save_figure(plot_causes(rows, LOADS[load].symbol), out / "causes.png")
    return summary


def _solve(bench: Bench, dataset: Dataset) -> dict[str, float | None]:
    """The figures of a solve; None where it did not converge, which is an answer too."""
    try:
        return dict(bench.solve(dataset)[0])
    except ConvergenceError:
        return dict.fromkeys(COLUMNS)


def _changes(study: Study, found: Inputs) -> Iterator[_Change]:
    """The solves; the first one is that of all other studies."""
    chain, load, dataset, dns = study.chain, study.load, found.dataset, found.dns
    free = chain.dns(found.stages, load, study.say, flat=False)
    box = dataset.parameters.get("load", "unknown")
    yield _Change(f"box {box}", _AS_IT_IS, dataset, dns)
    yield _Change("reference", "the sheet may leave its plane", dataset, free)
    mean = dd.metric_from_dataset(dataset)
    for factor in (0.1, 0.3, 3.0, 10.0):
        stiffer = dd.Metric(factor * mean.C, f"{factor:g} times the {mean.reason}")
        yield _Change("metric", f"{factor:g} times as stiff", dataset, dns, stiffer)
    yield _Change("metric", "mean tangent where the scene is", dataset, dns, "visited")
    yield _Change("metric", "secant modulus", dataset, dns, "secant")
    for measure in ("second_piola", "kirchhoff", "cauchy"):
        yield _Change("stress", measure_words(measure), convert_dataset(dataset, measure), dns)

    def sampled(name: str, box: str = load, factor: float = 1.0, **more: Any) -> Dataset:
        many = replace(chain, paths=max(1, round(factor * chain.paths)))
        return convert_dataset(read_dataset(many.data(found.stages, box, name, **more)), dataset.stress_measure)

    yield _Change("data", _FEW, sampled(f"data-{load}-few", factor=0.1), dns)
    yield _Change("data", "box inplane", sampled("data-inplane", "inplane"), dns)
    yield _Change("data", "box inplane, four times as many", sampled("data-inplane-many", "inplane", 4.0), dns)
    for n in (1, 3):
        twice = sampled(f"data-{load}-duplicated-{n}", factor=0.1, images="duplicated", blocks=(n, n, 1))
        yield _Change("RVE", f"images twice, {n} x {n} blocks, {_FEW}", twice, dns, against=_FEW)
