"""tsgdd bench rves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.options import Out
from workflows.runs.printing import say
from workflows.runs.ranks import check_alone

__all__ = ["command"]


def command(
    *,
    out: Out = Path("results/rves"),
    paths: Annotated[int, typer.Option(help="Loading paths of each RVE in each process.")] = 64,
    steps: Annotated[int, typer.Option(help="States on each path.")] = 20,
    processes: Annotated[int, typer.Option(help="Processes that work at the same time.")] = 2,
) -> None:
    """RVE states a second with their tangents, one by one and in batches, and how they differ."""
    check_alone("bench rves")
    from workflows.studies.bench_rves import rves as run

    run(out, paths=paths, steps=steps, processes=processes, say=say)
    say(f"{'results':24} {out}")
