"""tsgdd bench tsgfem."""

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
    cases: Annotated[Path, typer.Option(help="Folder of TsgFEM's results, as in tests/data/tsgfem.")],
    out: Out,
) -> None:
    """Replay results of the public MATLAB code TsgFEM, step by step."""
    from workflows.studies.bench_tsgfem import bench_tsgfem as run

    check_alone("bench tsgfem")
    run(out, cases=cases, say=say)
    say(f"{'results':24} {out}")
