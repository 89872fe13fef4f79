"""tsgdd bench stability."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.options import Out, Plots
from workflows.runs.printing import report, say
from workflows.runs.ranks import check_alone

__all__ = ["command"]


def command(
    *,
    out: Out = Path("results/stability"),
    micro: Annotated[int, typer.Option(help="Cases of one cell and of each of three RVEs.")] = 300,
    sheets: Annotated[int, typer.Option(help="Cases of each of two clamped sheets.")] = 60,
    macro: Annotated[int, typer.Option(help="Macroscopic cases with points and with tangents, each.")] = 200,
    seed: Annotated[int, typer.Option(help="Of the random design.")] = 0,
    limit: Annotated[float, typer.Option(help="Seconds that a case may take.")] = 30.0,
    processes: Annotated[int, typer.Option(help="Processes that share the work.")] = 2,
    plots: Plots = True,
) -> None:
    """What converges far from the paper's values, and why the rest does not; every answer is rebalanced."""
    check_alone("bench stability")
    from workflows.studies.bench_stability import stability as run

    sizes = {"micro": micro, "sheets": sheets, "macro": macro}
    summary = run(out, **sizes, seed=seed, limit=limit, processes=processes, plots=plots, say=say)
    report(summary, "converged not_converged refused time_limit silent unnamed seconds", out)
