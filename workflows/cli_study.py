"""The command line of the studies of the paper's Section 4, and of the benchmarks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.options import Out, say
from workflows.ranks import check_alone

__all__ = ["bench", "study"]

study = typer.Typer(help="Studies of the paper's Section 4.", no_args_is_help=True)
bench = typer.Typer(help="Benchmarks: agreement and run time.", no_args_is_help=True)


@bench.command()
def tsgfem(
    cases: Annotated[Path, typer.Option(help="Folder of TsgFEM's results, as in tests/data/tsgfem.")],
    out: Out,
) -> None:
    """Replay results of the public MATLAB code TsgFEM, step by step."""
    from workflows.bench_tsgfem import bench_tsgfem as run

    check_alone("bench tsgfem")
    run(out, cases=cases, say=say)
    say(f"{'results':24} {out}")
