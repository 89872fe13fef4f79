"""The command line of the studies of the paper's Section 4, and of the benchmarks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.cli.options import BarForce, Load, Out, OutOrDefault, Plots, Strain, report, say
from workflows.runs.ranks import check_alone

__all__ = ["Blocks", "Data", "Dns", "Paths", "Seed", "Steps", "bench", "paper", "study"]

Blocks = Annotated[tuple[int, int], typer.Option(help="2x2x2-cell blocks along x and y.")]
Paths = Annotated[int, typer.Option(help="Loading paths to sample.")]
Steps = Annotated[int, typer.Option(help="Points along each path.")]
Dns = Annotated[Path | None, typer.Option(help="Folder of 'tsgdd dns'; computed here if not given.")]
Data = Annotated[Path | None, typer.Option(help="Material data, HDF5; sampled here if not given.")]
Seed = Annotated[int, typer.Option(help="Seed of the data.")]

study = typer.Typer(help="Studies of the paper's Section 4, and of what goes beyond it.", no_args_is_help=True)
bench = typer.Typer(help="Benchmarks: agreement and run time.", no_args_is_help=True)


@bench.command()
def tsgfem(
    cases: Annotated[Path, typer.Option(help="Folder of TsgFEM's results, as in tests/data/tsgfem.")],
    out: Out,
) -> None:
    """Replay results of the public MATLAB code TsgFEM, step by step."""
    from workflows.studies.bench_tsgfem import bench_tsgfem as run

    check_alone("bench tsgfem")
    run(out, cases=cases, say=say)
    say(f"{'results':24} {out}")


@bench.command()
def frontier(
    load: Annotated[Load | None, typer.Option(help="How the top side moves; both if not given.")] = None,
    out: OutOrDefault = None,
    blocks: Blocks = (60, 30),
    strain: Strain = 0.05,
    bar_force: BarForce = 1e-8,
    paths: Paths = 1000,
    steps: Steps = 10,
    seed: Seed = 0,
    dns: Dns = None,
    data: Data = None,
    fe2: Annotated[list[Path] | None, typer.Option(help="Folder of 'tsgdd fe2'; repeat for other kinematics.")] = None,
    plots: Plots = True,
) -> None:
    """Run time against error: data-driven and adaptive solves, FE2, fitted laws, and the full tensegrity."""
    check_alone("bench frontier")
    from tsg_micro.data.errors import InputError
    from workflows.studies.bench_frontier import frontier as run
    from workflows.studies.one_load import Study
    from workflows.studies.prerequisites import Chain

    chain = Chain(blocks, strain, bar_force, paths, steps, seed)
    if load is None and (dns or data or fe2):
        raise InputError("load: expected stretch or shear beside --dns, --data or --fe2, got none")
    for one in Load if load is None else [load]:
        folder = out / one.value if out and load is None else out or Path("results") / f"frontier-{one.value}"
        run(Study(folder, one.value, chain, dns, data, say=say), fe2=fe2 or (), plots=plots)
        say(f"{'results':24} {folder}")


@study.command(name="rve-size")
def rve_size(
    out: Out = Path("results/rve-size"),
    largest: Annotated[int, typer.Option(help="Blocks along x and y of the largest RVE.")] = 6,
    bar_force: Annotated[list[float] | None, typer.Option(help="Bar force in N; repeat for several.")] = None,
    plots: Plots = True,
) -> None:
    """Energy and stress against RVE size, images merged and duplicated: which RVE is needed."""
    from workflows.studies.rve_size import study_rve_size as run

    check_alone("study rve-size")
    run(out, largest=largest, bar_force=bar_force or (1e-9, 1e-8, 5e-8), plots=plots, say=say)
    say(f"{'results':24} {out}")


@study.command()
def sampling(
    out: Out = Path("results/sampling"),
    load: Annotated[Load | None, typer.Option(help="That of the files given, else both, if not given.")] = None,
    data: Annotated[Path | None, typer.Option(help="Material data, HDF5; sampled here if not given.")] = None,
    dd: Annotated[Path | None, typer.Option(help="Folder of 'tsgdd solve'; solved here if not given.")] = None,
    paths: Paths = 1000,
    steps: Steps = 10,
    bar_force: BarForce = 1e-8,
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
        bar_force=bar_force,
        seed=seed,
        elements=elements,
        plots=plots,
        say=say,
    )
    say(f"{'results':24} {out}")


@study.command(name="data-size")
def data_size(
    load: Annotated[Load, typer.Option(help="How the top side moves.")],
    out: OutOrDefault = None,
    blocks: Blocks = (60, 30),
    strain: Strain = 0.05,
    bar_force: BarForce = 1e-8,
    paths: Paths = 1000,
    steps: Steps = 10,
    seed: Seed = 0,
    sizes: Annotated[int, typer.Option(help="Numbers of data, over three decades.")] = 16,
    draws: Annotated[int, typer.Option(help="Random draws of each size.")] = 10,
    dns: Dns = None,
    data: Data = None,
    plots: Plots = True,
) -> None:
    """Error and distance of the data-driven solution against the number of data, and the self-consistent benchmark."""
    check_alone("study data-size")
    from workflows.studies.data_size import data_size as run
    from workflows.studies.one_load import Study
    from workflows.studies.prerequisites import Chain

    out = out or Path("results") / f"data-size-{load.value}"
    chain = Chain(blocks, strain, bar_force, paths, steps, seed)
    summary = run(Study(out, load.value, chain, dns, data, say=say), count=sizes, draws=draws, plots=plots)
    for name, value in summary["largest"].items():
        say(f"{name:24} {value:.2%}   data of the tensegrity itself {summary['self_consistent'][name]:.2%}")
    report(summary, "solves seconds_solves", out)


@study.command()
def causes(
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
    """What the error is made of: the same solve with another metric, stress, RVE, data or reference."""
    check_alone("study causes")
    from workflows.studies.causes import causes as run
    from workflows.studies.one_load import Study
    from workflows.studies.prerequisites import Chain

    out = out or Path("results") / f"causes-{load.value}"
    chain = Chain(blocks, strain, bar_force, paths, steps, seed)
    run(Study(out, load.value, chain, dns, data, say=say), plots=plots)
    say(f"{'results':24} {out}")


def paper(
    out: Annotated[Path, typer.Option("--out", help="Folder of all stages and of report.md.")] = Path("results/paper"),
    blocks: Blocks = (60, 30),
    strain: Strain = 0.05,
    bar_force: BarForce = 1e-8,
    paths: Paths = 1000,
    steps: Steps = 10,
    seed: Seed = 0,
    largest: Annotated[int, typer.Option(help="Largest RVE of the size study, in blocks.")] = 6,
    sizes: Annotated[int, typer.Option(help="Numbers of data of the data-size study.")] = 16,
    draws: Annotated[int, typer.Option(help="Random draws of each of them.")] = 10,
) -> None:
    """The paper's multiscale study, all of it; what is there already is not repeated."""
    check_alone("paper")
    from workflows.studies.paper import paper as run
    from workflows.studies.prerequisites import Chain

    chain = Chain(blocks, strain, bar_force, paths, steps, seed)
    run(out, chain=chain, largest=largest, sizes=sizes, draws=draws, say=say)
