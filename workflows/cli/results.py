"""The command line of runs that are done."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.options import out_option
from workflows.runs.ranks import check_alone

__all__ = ["results"]

results = typer.Typer()


@results.command()
def show(run: Annotated[Path, typer.Argument(help="Folder of a run, the file that it wrote, or its summary.")]) -> None:
    """Print what a run was asked and what it found, with units."""
    check_alone("show")
    from workflows.runs.summaries import show as print_summary

    print_summary(run)


@results.command()
def table(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs, files that they wrote, or their summaries.")],
    out: Annotated[Path | None, out_option("CSV file; printed if not given.")] = None,
) -> None:
    """Runs as CSV, a row each: the parameters that differ, and all figures that are one value."""
    check_alone("table")
    from workflows.runs.summaries import table as write

    write(runs, out)
