"""tsgdd study metric: how much the solution depends on the metric, with data as points and as tangent spaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import dd_macro as dd
from tsg_micro.data.dataset import Dataset, take
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from workflows.runs.loads import LOADS
from workflows.runs.progress import tracked
from workflows.runs.tensegrity import describe, read_blocks, solution_errors
from workflows.store.record import read_summary, write_summary, write_table
from workflows.studies.methods import named
from workflows.studies.one_load import Bench, Study, make_bench

__all__ = ["FACTORS", "metric"]

FACTORS = (0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
_RANGES = {"0.3_to_3": (0.3, 3.0), "0.1_to_10": (0.1, 10.0)}
_LEAST = 4
_ERRORS = ("error_mech", "error_mat", "error_mech_all", "error_mat_all")


def metric(
    study: Study, *, factors: Sequence[float] = FACTORS, sizes: Sequence[int] | None = None, plots: bool = True
) -> dict[str, Any]:
    """Solve with the default metric times each of ``factors``, by the classical and the second-order method.

    Each with ``sizes`` of the data, of which one draw is taken; all and a hundredth of them if None. metric.csv has a
    row for every solve; of one that does not converge it says why, and the spread of the errors of its method is None.

    Raises:
        InputError: an argument or a file is not valid.
        ConvergenceError: a stage did not converge.
    """
    if len(set(factors)) < 2 or not (np.isfinite(factors).all() and min(factors) > 0):
        raise InputError(f"factors: expected at least two positive numbers, got {list(factors)}")
    if sizes is not None and (not sizes or min(sizes) < _LEAST):
        raise InputError(
            f"sizes: expected numbers of at least {_LEAST}, from which tangents can be estimated, got {list(sizes)}"
        )
    out, load = output_folder(study.out), study.load
    found = study.prepare()
    many = len(found.dataset)
    sizes = sorted({max(_LEAST, many // 100), many} if sizes is None else set(sizes))
    if sizes[-1] > many:
        raise InputError(f"sizes: expected at most {many}, the number of data in {found.data}, got {sizes[-1]}")
    blocks = read_blocks(found.dns, found.dataset.stress_measure)
    methods = named("classical", "second order")
    default = {}
    for name, method in methods.items():
        bench = make_bench(found.scene, "auto", method.given(found.dataset), blocks, order=method.order)
        default[name] = bench.projection.metric
        study.say(f"default metric, {name}: {default[name].reason}")
    order = np.random.default_rng([0, many]).permutation(many)
    rows: list[dict[str, Any]] = []
    for factor in tracked(sorted(set(factors)), "metrics"):
        for name, method in methods.items():
            scaled = dd.Metric(factor * default[name].C, f"{factor:g} times as stiff")
            bench = make_bench(found.scene, scaled, found.dataset, blocks)
            for size in sizes:
                row = _solve(bench, method, take(method.given(found.dataset), order[:size]))
                rows.append({"method": name, "data": size, "factor": factor} | row)
                study.say(f"{factor:4g} times as stiff, {name:12} {size:6} data: {_shown(row, bench.symbol)}")
    write_table(out / "metric.csv", rows)
    summary = write_summary(
        out,
        command="study metric",
        parameters={**study.parameters(found), "factors": sorted(set(factors)), "sizes": sizes},
        figures={
            "symbol": (LOADS[load].symbol, ""),
            "reference": (describe(read_summary(found.dns, "dns")), ""),
            "metric": ({name: one.C for name, one in default.items()}, "Pa"),
            "metric_reason": ({name: one.reason for name, one in default.items()}, ""),
            "spread": ({name: _spreads(rows, *limits) for name, limits in _RANGES.items()}, "1"),
            "not_converged": ([row for row in rows if not row["converged"]], ""),
            "rows": (rows, ""),
        },
    )
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.metric_figure import plot_metric

        save_figure(plot_metric(summary), out / "metric.png")
    return summary


def _solve(bench: Bench, method: dd.DataMethod, dataset: Dataset) -> dict[str, Any]:
    """Errors of one solve, how it ended and what it took; None for errors where it did not converge."""
    projection = bench.projection
    try:
        result = method.solve(projection, method.search(dataset, projection.metric))
    except ConvergenceError as error:
        nothing = {**dict.fromkeys(_ERRORS), "distance": None, "held": None}
        return {"converged": False, **nothing, "iterations": len(error.history), "reason": str(error)}
    shown = dd.in_space(result, bench.blocks.stress_measure)
    row = solution_errors(shown, bench.blocks).row(bench.symbol)
    return {
        "converged": True,
        **{name: row[name] for name in _ERRORS},
        "distance": row["distance"],
        "held": getattr(result, "held", 0),
        "iterations": result.iterations,
        "reason": result.reason,
    }


def _shown(row: dict[str, Any], symbol: str) -> str:
    if not row["converged"]:
        return "did not converge"
    return f"error of {symbol} {row['error_mech']:.2%} mechanical, {row['error_mat']:.2%} material"


def _spreads(rows: list[dict[str, Any]], low: float, high: float) -> list[dict[str, Any]]:
    """Largest less smallest error of every method and number of data, over the factors from ``low`` to ``high``.

    None where one of the solves did not converge.
    """
    spreads = []
    for name, size in dict.fromkeys((row["method"], row["data"]) for row in rows):
        own = [row for row in rows if (row["method"], row["data"]) == (name, size) and low <= row["factor"] <= high]
        spread: dict[str, Any] = {"method": name, "data": size}
        for error in _ERRORS:
            values = [row[error] for row in own]
            spread[error] = None if not values or None in values else max(values) - min(values)
        spreads.append(spread)
    return spreads
