"""The command line: one command a workflow. Nothing is imported before the command that needs it is called."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from workflows.cli import bodies as cli_bodies
from workflows.cli import macroscale as cli_macroscale
from workflows.cli import meshes as cli_meshes
from workflows.cli import results as cli_results
from workflows.cli import studies as cli_study
from workflows.runs.option_groups import TableOptions, TissueOptions, grouped
from workflows.runs.options import (
    Box,
    HowLoaded,
    Images,
    Kind,
    KindName,
    Load,
    Measure,
    Out,
    OutFile,
    OutOrDefault,
    Plots,
    SceneFile,
    Strain,
)
from workflows.runs.printing import report, report_sides, say
from workflows.runs.ranks import check_alone

__all__ = ["app"]

app = typer.Typer(
    help="Multiscale cell mechanics: tensegrity cells, RVE data, data-driven finite elements. SI units throughout.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from tsg_micro.data.version import VERSION

        print(f"tsgdd {VERSION}")
        raise typer.Exit


@app.callback()
def _tsgdd(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


@app.command()
@grouped
def structure(
    *,
    out: Out,
    cells: Annotated[tuple[int, int, int] | None, typer.Option(help="Cells along x, y, z.")] = None,
    shape: Annotated[str, typer.Option(help="box or spheroid.")] = "box",
    radius: Annotated[float | None, typer.Option(help="Radius of a spheroid, in blocks of 2x2x2 cells.")] = None,
    cell: TissueOptions,
    plots: Plots = True,
) -> None:
    """Build a lattice of cells, check its self-stress, draw it."""
    check_alone("structure")
    from workflows.runs.structure import structure as run

    summary = run(out, cells=cells, shape=shape, radius=radius, tissue=cell.make(), plots=plots)
    report(summary, "nodes bars tendons cells self_stress_states mechanisms equilibrium_residual", out)


@app.command()
@grouped
def sample(
    *,
    scene_file: SceneFile = None,
    out: OutFile,
    load: Annotated[
        Box | None, typer.Option(help="Strain box; stretch, or full of a scene file, if not given.")
    ] = None,
    paths: Annotated[int, typer.Option(help="Number of loading paths.")] = 400,
    steps: Annotated[int, typer.Option(help="Points along each path.")] = 10,
    cell: TissueOptions,
    seed: Annotated[int, typer.Option(help="Seed; the data depend on nothing else that is random.")] = 0,
    blocks: Annotated[tuple[int, int, int], typer.Option(help="Size of the RVE in 2x2x2-cell blocks.")] = (1, 1, 1),
    images: Annotated[
        Images, typer.Option(help="Members on opposite faces: one, or two as in the paper.")
    ] = Images.merged,
    kind: Kind = KindName.sheet,
    axes: Annotated[
        str | None, typer.Option(help='Of an edge, "periodic held free": a word an axis; all inside if not given.')
    ] = None,
    stress_measure: Annotated[Measure, typer.Option(help="Stress to store.")] = Measure.first_piola,
    append: Annotated[bool, typer.Option("--append", help="Add to the file if it is there.")] = False,
    tissue_name: Annotated[str | None, typer.Option(help="Of a scene file: which of its tissues.")] = None,
    processes: Annotated[int | None, typer.Option(help="Processes without mpirun; all cores if not given.")] = None,
    plots: Plots = True,
) -> None:
    """Sample material data from random loading paths through a periodic RVE; also under mpirun."""
    if scene_file is not None:
        given: dict[str, object] = dict.fromkeys(cell.given, True)
        given |= {"kind": None if kind == KindName.sheet else kind, "axes": axes, "append": append or None}
        given |= {"blocks": None if blocks == (1, 1, 1) else blocks, "images": None if images == "merged" else images}
        given |= {"stress_measure": None if stress_measure == Measure.first_piola else stress_measure}
        how: dict[str, Any] = {"paths": paths, "steps": steps, "seed": seed, "processes": processes, "plots": plots}
        _sample_file(scene_file, out, given, tissue=tissue_name, load=(load or Box.full).value, **how)
        return
    from workflows.runs.sample import sample as run

    summary = run(
        out,
        load=(load or Box.stretch).value,
        paths=paths,
        steps=steps,
        tissue=cell.make(),
        seed=seed,
        blocks=blocks,
        images=images.value,  # type: ignore[arg-type]
        kind=kind.value,
        axes=axes,
        stress_measure=stress_measure.value,
        append=append,
        processes=processes,
        plots=plots,
    )
    total = "points_in_file " if append else ""
    report(summary, f"points {total}paths failed_paths processes seconds", out)


def _sample_file(path: Path, out: Path, given: Mapping[str, object], **how: Any) -> None:
    """Data of a tissue of the scene in a file; ``how`` is as of sample_scene."""
    from workflows.runs.sample_scene import sample_scene
    from workflows.scenes.read import naming, read_alone

    model = read_alone(path, given)
    with naming(path):
        summary = sample_scene(out, model, **how)
    report(summary, "points paths seconds", out)


@app.command()
@grouped
def dns(
    *,
    scene_file: SceneFile = None,
    out: OutOrDefault = None,
    blocks: Annotated[tuple[int, int], typer.Option(help="2x2x2-cell blocks along x and y.")] = (30, 15),
    load: HowLoaded = Load.stretch,
    strain: Strain = 0.05,
    cell: TissueOptions,
    flat: Annotated[bool, typer.Option("--flat/--free", help="Hold the mid-plane, so that it cannot buckle.")] = False,
    steps: Annotated[int, typer.Option(help="Recorded load steps.")] = 4,
    linear_solver: Annotated[str, typer.Option(help="auto, superlu, pardiso or mumps.")] = "auto",
    plots: Plots = True,
) -> None:
    """Load a sheet, or the body of a scene file, with every bar and tendon: the reference solution.

    A run that was cut short goes on after its last load step when the same command is given again.
    """
    check_alone("dns")
    if scene_file is not None:
        given: dict[str, object] = dict.fromkeys(cell.given, True)
        given |= {"flat": flat or None, "steps": None if steps == 4 else steps}
        given |= {"blocks": None if blocks == (30, 15) else blocks, "strain": None if strain == 0.05 else strain}
        given |= {"load": None if load == Load.stretch else load}
        _dns_of_file(scene_file, out or Path("results") / "dns", given, linear_solver, plots=plots)
        return
    from workflows.runs.dns import dns as run

    out = out or Path("results") / f"dns-{load.value}"
    summary = run(
        out,
        blocks=blocks,
        load=load.value,
        strain=strain,
        tissue=cell.make(),
        flat=flat,
        steps=steps,
        linear_solver=linear_solver,
        plots=plots,
        say=say,
    )
    names = "dofs nominal_stress deflection row_balance newton_iterations factorisations negative_pivots seconds"
    report(summary, names, out)


def _dns_of_file(path: Path, out: Path, given: Mapping[str, object], linear_solver: str, *, plots: bool) -> None:
    from workflows.runs.dns_scene import dns_scene
    from workflows.scenes.read import naming, read_alone

    model = read_alone(path, given)
    with naming(path):
        summary = dns_scene(out, model, linear_solver=linear_solver, plots=plots, say=say)
    report_sides(summary)
    report(summary, "dofs volume_change residual negative_pivots seconds", out)


@app.command(name="import-csv")
@grouped
def import_csv(
    *,
    csv: Annotated[Path, typer.Argument(help="Measured strain and stress, with a header line.")],
    column: Annotated[list[str], typer.Option(help="COMPONENT=HEADER:UNIT, e.g. eps_yy=strain:% ; once a column.")],
    out: OutFile,
    zero: Annotated[list[str] | None, typer.Option(help="Component known to be zero, e.g. sigma_zz.")] = None,
    silent: Annotated[
        list[str] | None, typer.Option(help="Zero as nothing drove it, e.g. yz: not in the metric.")
    ] = None,
    stress_measure: Annotated[Measure, typer.Option(help="What the measured stress is.")] = Measure.cauchy,
    table: TableOptions,
) -> None:
    """Turn measured data into a data set; columns and units are declared, nothing is guessed."""
    check_alone("import-csv")
    from workflows.runs.import_csv import import_csv as run

    run(
        csv,
        column=column,
        zero=zero or [],
        silent=silent or [],
        stress_measure=stress_measure.value,
        layout=table.make(),
        out=out,
    )


app.add_typer(cli_macroscale.macroscale)
app.add_typer(cli_bodies.bodies)
app.add_typer(cli_results.results)
app.add_typer(cli_meshes.mesh, name="mesh")
for _name, _group in zip(("study", "bench"), cli_study.find_studies(), strict=True):
    app.add_typer(_group, name=_name)


@app.command()
def demo(
    out: Out,
    blocks: Annotated[tuple[int, int], typer.Option(help="Blocks along x and y.")] = (30, 15),
    paths: Annotated[int, typer.Option(help="Loading paths to sample.")] = 400,
) -> None:
    """The whole chain: sample, full tensegrity, data-driven solve, compare, and one figure."""
    check_alone("demo")
    from workflows.runs.demo import demo as run

    run(out, blocks=blocks, paths=paths, say=say)


app.command()(cli_study.paper)
