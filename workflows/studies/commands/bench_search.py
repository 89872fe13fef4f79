"""tsgdd bench search."""

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
    out: Out = Path("results/search"),
    count: Annotated[
        list[int] | None, typer.Option(help="Number of data; repeat for several. Else 1e4, 1e5 and 1e6.")
    ] = None,
    elements: Annotated[tuple[int, int], typer.Option(help="Elements of the sheet along x and y.")] = (60, 30),
    paths: Annotated[int, typer.Option(help="Loading paths that the data are interpolated between.")] = 300,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 0,
    plots: Plots = True,
) -> None:
    """Time and memory of solves with data as points, against the number of data, each in its own process."""
    check_alone("bench search")
    from workflows.studies.bench_search import COUNTS, bench_search

    bench_search(out, counts=count or COUNTS, elements=elements, paths=paths, seed=seed, plots=plots, say=say)
    say(f"{'results':24} {out}")
