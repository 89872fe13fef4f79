"""tsgdd study rve-size."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.options import Out, Plots
from workflows.runs.printing import say
from workflows.runs.ranks import check_alone

__all__ = ["command"]


def command(
    *,
    out: Out = Path("results/rve-size"),
    largest: Annotated[int, typer.Option(help="Blocks along x and y of the largest RVE.")] = 6,
    bar_force: Annotated[list[float] | None, typer.Option(help="Bar force in N; repeat for several.")] = None,
    plots: Plots = True,
) -> None:
    """Energy and stress against RVE size, images merged and duplicated: which RVE is needed."""
    from workflows.studies.rve_size import study_rve_size as run

    check_alone("study rve-size")
    run(out, largest=largest, bar_force=bar_force or (1e-9, 1e-8, 5e-8), plots=plots, say=say)
    say(f"{'results':24} {out}")
