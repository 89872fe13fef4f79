"""tsgdd study convergence."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.options import Load, Out, Plots
from workflows.runs.printing import say
from workflows.runs.ranks import check_alone
from workflows.studies.options import ChainOptions, Data, LoadOrBoth

__all__ = ["command"]

SMALL = ChainOptions(blocks=(30, 15))


def command(
    *,
    load: LoadOrBoth = None,
    out: Out = Path("results/convergence"),
    chain: ChainOptions = SMALL,
    size: Annotated[
        list[int] | None, typer.Option(help="Number of data; repeat for several. Else 10 to 10,000.")
    ] = None,
    data: Data = None,
    plots: Plots = True,
) -> None:
    """Which solves converge, of a grid of loads, metrics, numbers of data and methods; each claim is checked."""
    check_alone("study convergence")
    from workflows.studies.convergence import convergence as run

    loads = [one.value for one in Load] if load is None else [load.value]
    summary = run(out, chain=chain.make(), loads=loads, data=data, sizes=size, plots=plots, say=say)
    for state, count in summary["counts"].items():
        say(f"{state:24} {count} of {summary['cells']}")
    say(f"{'results':24} {out}")
