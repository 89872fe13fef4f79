"""tsgdd study data-error."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.options import HowLoaded, Kinematics, KinematicsName, OutOrDefault, Plots
from workflows.runs.printing import say
from workflows.runs.ranks import check_alone
from workflows.studies.options import ChainOptions

__all__ = ["command"]


def command(
    *,
    load: HowLoaded,
    out: OutOrDefault = None,
    chain: ChainOptions,
    fe2: Annotated[Path | None, typer.Option(help="Folder of 'tsgdd fe2'; computed here if not given.")] = None,
    data: Annotated[list[Path] | None, typer.Option(help="Material data, HDF5; repeat for several files.")] = None,
    states: Annotated[int, typer.Option(help="Random RVE states of the strains that FE2 visits.")] = 2048,
    draws: Annotated[int, typer.Option(help="Random draws of each number of data.")] = 3,
    budget: Annotated[list[int] | None, typer.Option(help="RVEs of an adaptive run; repeat for several.")] = None,
    kinematics: Kinematics = KinematicsName.small,
    plots: Plots = True,
) -> None:
    """What the data alone leave of error, against FE2: rates, random and adaptive data, RVE states for 1 %."""
    check_alone("study data-error")
    from workflows.studies.data_error import BUDGETS
    from workflows.studies.data_error import data_error as run

    out = out or Path("results") / f"data-error-{load.value}"
    summary = run(
        out,
        load=load.value,
        chain=chain.make(),
        fe2=fe2,
        data=data or (),
        states=states,
        draws=draws,
        budgets=budget or BUDGETS,
        kinematics=kinematics.value,
        plots=plots,
        say=say,
    )
    for fit in summary["fits"]:
        slope, needed = fit["slope_state"], fit[f"needed_{summary['symbol']}"]["0.01"]
        shown = "no slope" if slope is None else f"slope {slope:.2f}"
        reached = "1 % never" if needed is None else f"1 % of {summary['symbol']} from {needed:.0f} states"
        say(f"{fit['source']}, {fit['method']}: {shown}, {reached}")
    say(f"{'results':24} {out}")
