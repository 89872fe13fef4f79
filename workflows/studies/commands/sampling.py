"""tsgdd study sampling."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.option_groups import TissueOptions
from workflows.runs.options import Load, Out, Plots
from workflows.runs.printing import say
from workflows.runs.ranks import check_alone
from workflows.studies.options import Data, Paths, Seed, Steps

__all__ = ["command"]


def command(
    *,
    out: Out = Path("results/sampling"),
    load: Annotated[Load | None, typer.Option(help="That of the files given, else both, if not given.")] = None,
    data: Data = None,
    dd: Annotated[Path | None, typer.Option(help="Folder of 'tsgdd solve'; solved here if not given.")] = None,
    paths: Paths = 1000,
    steps: Steps = 10,
    cell: TissueOptions,
    seed: Seed = 0,
    elements: Annotated[tuple[int, int], typer.Option(help="Elements along x and y of the solve.")] = (30, 15),
    plots: Plots = True,
) -> None:
    """What the material data cover, and which states the macroscopic solution visits."""
    from workflows.studies.sampling import study_sampling as run

    check_alone("study sampling")
    run(
        out,
        load=None if load is None else load.value,
        data=data,
        dd=dd,
        paths=paths,
        steps=steps,
        tissue=cell.make(),
        seed=seed,
        elements=elements,
        plots=plots,
        say=say,
    )
    say(f"{'results':24} {out}")
