"""tsgdd study edges."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.option_groups import TissueOptions
from workflows.runs.options import HowLoaded, Load, Out, Plots, Strain
from workflows.runs.printing import say
from workflows.runs.ranks import check_alone

__all__ = ["command"]


def command(
    *,
    out: Out = Path("results/edges"),
    blocks: Annotated[tuple[int, int], typer.Option(help="2x2x2-cell blocks along x and y.")] = (16, 8),
    load: HowLoaded = Load.stretch,
    strain: Strain = 0.05,
    cell: TissueOptions,
    plots: Plots = True,
) -> None:
    """Stress of a clamped sheet row by row: every bar and tendon, adaptive data with edges and without."""
    check_alone("study edges")
    from workflows.studies.edges import edges as run
    from workflows.studies.edges import errors_of

    summary = run(out, blocks=blocks, load=load.value, strain=strain, tissue=cell.make(), plots=plots, say=say)
    for symbol in "pq":
        for name, error in errors_of(summary, symbol).items():
            say(f"{f'error of {symbol} {name}':24} inner {error['l2']:.2%}  all {error['l2_all']:.2%}")
    say(f"{'results':24} {out}")
