"""tsgdd bench scale."""

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
    out: Out = Path("results/scale"),
    size: Annotated[
        list[int] | None, typer.Option(help="Elements across the height; repeat for several. Else 15 to 120.")
    ] = None,
    ranks: Annotated[list[int] | None, typer.Option(help="Numbers of ranks; repeat for several. Else 1 and 2.")] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(help="points, tangent spaces, adaptive, full tensegrity, sampling; repeat for several. Else all."),
    ] = None,
    paths: Annotated[int, typer.Option(help="Loading paths of the data.")] = 300,
    seconds: Annotated[float, typer.Option(help="A run that takes longer is the last of its row of sizes.")] = 600.0,
    plots: Plots = True,
) -> None:
    """Time, memory and iterations of solves against the size of the mesh, each in its own process."""
    check_alone("bench scale")
    from workflows.studies.bench_scale import METHODS, SIZES, scale

    summary = scale(
        out,
        sizes=size or SIZES,
        ranks=ranks or (1, 2),
        methods=method or tuple(METHODS),
        paths=paths,
        seconds=seconds,
        plots=plots,
        say=say,
    )
    for row in summary["exponents"]:
        fits = ", ".join(f"{name} {row[name]:.2f}" for name in ("seconds", "peak_memory", "iterations") if row[name])
        say(f"{row['method']:15} {row['ranks']} ranks: {fits}")
    say(f"{'results':24} {out}")
