"""The command line of the studies of what goes beyond the paper: metric, convergence, data error."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.cli.options import BarForce, Kinematics, KinematicsName, Load, Out, OutOrDefault, Plots, Strain, say
from workflows.cli.studies import Blocks, Data, Dns, Paths, Seed, Steps, study
from workflows.runs.ranks import check_alone

__all__ = ["study"]


@study.command()
def metric(
    load: Annotated[Load, typer.Option(help="How the top side moves.")],
    out: OutOrDefault = None,
    blocks: Blocks = (60, 30),
    strain: Strain = 0.05,
    bar_force: BarForce = 1e-8,
    paths: Paths = 1000,
    steps: Steps = 10,
    seed: Seed = 0,
    dns: Dns = None,
    data: Data = None,
    plots: Plots = True,
) -> None:
    """How much the error depends on the metric: 0.1 to 10 times the default one, classical and second-order data."""
    check_alone("study metric")
    from workflows.studies.metric import metric as run
    from workflows.studies.one_load import Study
    from workflows.studies.prerequisites import Chain

    out = out or Path("results") / f"metric-{load.value}"
    chain = Chain(blocks, strain, bar_force, paths, steps, seed)
    summary = run(Study(out, load.value, chain, dns, data, say=say), plots=plots)
    for name, spreads in summary["spread"].items():
        for row in spreads:
            errors = (row["error_mech"], row["error_mat"])
            shown = ", ".join("none" if e is None else f"{100 * e:.2f}" for e in errors)
            say(f"spread {name:10} {row['method']:13} {row['data']:6} data: {shown} points (mechanical, material)")
    say(f"{'results':24} {out}")


@study.command()
def convergence(
    load: Annotated[Load | None, typer.Option(help="How the top side moves; both if not given.")] = None,
    out: Out = Path("results/convergence"),
    blocks: Blocks = (30, 15),
    strain: Strain = 0.05,
    bar_force: BarForce = 1e-8,
    paths: Paths = 1000,
    steps: Steps = 10,
    seed: Seed = 0,
    size: Annotated[
        list[int] | None, typer.Option(help="Number of data; repeat for several. Else 10 to 10,000.")
    ] = None,
    data: Data = None,
    plots: Plots = True,
) -> None:
    """Which solves converge, of a grid of loads, metrics, numbers of data and methods; each claim is checked."""
    check_alone("study convergence")
    from workflows.studies.convergence import convergence as run
    from workflows.studies.prerequisites import Chain

    loads = [one.value for one in Load] if load is None else [load.value]
    chain = Chain(blocks, strain, bar_force, paths, steps, seed)
    summary = run(out, chain=chain, loads=loads, data=data, sizes=size, plots=plots, say=say)
    for state, count in summary["counts"].items():
        say(f"{state:24} {count} of {summary['cells']}")
    say(f"{'results':24} {out}")


@study.command(name="data-error")
def data_error(
    load: Annotated[Load, typer.Option(help="How the top side moves.")],
    out: OutOrDefault = None,
    blocks: Blocks = (60, 30),
    strain: Strain = 0.05,
    bar_force: BarForce = 1e-8,
    paths: Paths = 1000,
    steps: Steps = 10,
    seed: Seed = 0,
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
    from workflows.studies.prerequisites import Chain

    out = out or Path("results") / f"data-error-{load.value}"
    summary = run(
        out,
        load=load.value,
        chain=Chain(blocks, strain, bar_force, paths, steps, seed),
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
