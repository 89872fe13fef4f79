"""tsgdd study trust."""

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
    out: Out = Path("results/trust"),
    scenes: Annotated[int, typer.Option(help="Random scenes.")] = 12,
    first: Annotated[int, typer.Option(help="Number of the first one; a scene is drawn by its number.")] = 0,
    largest: Annotated[int, typer.Option(help="Blocks across a sheet at most; a cube has half of them.")] = 8,
    most: Annotated[int, typer.Option(help="Data at most.")] = 3000,
    plots: Plots = True,
) -> None:
    """Estimated errors of random scenes, bodies, loads, data and methods, against FE2 of the same model."""
    check_alone("study trust")
    from workflows.studies.trust import trust as run

    summary = run(out, scenes=scenes, first=first, largest=largest, most=most, plots=plots, say=say)
    names = "solved not_solved within_factor_two large_errors large_errors_missed missed within_by_method"
    report(summary, names, out)
