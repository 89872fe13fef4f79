"""The command line of bodies that are loaded whole (paper, Section 3): cell, monolayer, spheroid, and a fit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.option_groups import CellOptions, TableOptions, TissueOptions, grouped
from workflows.runs.options import Out, Plots
from workflows.runs.printing import report, say
from workflows.runs.ranks import check_alone

__all__ = ["bodies"]

bodies = typer.Typer()

Top = Annotated[str, typer.Option(help="Top nodes: free, or guided up and down only.")]
LinearSolver = Annotated[str, typer.Option(help="auto, superlu, pardiso or mumps.")]


def _numbers(name: str, text: str) -> list[float]:
    """Numbers parted by commas."""
    from tsg_micro.data.errors import InputError

    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise InputError(f"{name}: expected numbers parted by commas, as 1e-9,2e-9, got {text!r}") from None


def _sizes(name: str, text: str) -> list[tuple[int, int]]:
    """Sizes NXxNY parted by commas."""
    from tsg_micro.data.errors import InputError

    sizes = []
    for part in text.split(","):
        counts = part.strip().split("x")
        if counts == [""]:
            continue
        if len(counts) != 2 or not all(count.strip().isdigit() for count in counts):
            raise InputError(f"{name}: expected sizes parted by commas, as 10x5,20x10, got {text!r}")
        sizes.append((int(counts[0]), int(counts[1])))
    return sizes


@bodies.command()
@grouped
def cell(
    *,
    out: Out,
    bar_force: Annotated[
        list[float] | None, typer.Option(help="Compression of the bars at rest, N; may be repeated. Else 1 .. 50 nN.")
    ] = None,
    force: Annotated[float, typer.Option(help="Force on the top, downwards, N.")] = 3e-9,
    steps: Annotated[int, typer.Option(help="Equal load steps.")] = 30,
    top: Top = "free",
    cells: CellOptions,
    plots: Plots = True,
) -> None:
    """Press one cell down on a fixed base: force against displacement."""
    check_alone("cell")
    from workflows.runs.cell import cell as run

    made = cells.make()
    summary = run(
        out,
        band=bar_force or ((made.bar_force,) if cells.tissue else ()),
        force=force,
        steps=steps,
        top=top,
        tissue=made,
        plots=plots,
        say=say,
    )
    one = "secant_stiffness initial_stiffness tangent_stiffness apparent_modulus negative_pivots "
    report(summary, f"{one if 'secant_stiffness' in summary else ''}seconds", out)


@bodies.command()
@grouped
def monolayer(
    *,
    out: Out,
    blocks: Annotated[tuple[int, int], typer.Option(help="Blocks of 2x2 cells along x and y.")] = (60, 30),
    layers: Annotated[int, typer.Option(help="Layers of cells along z.")] = 1,
    strain: Annotated[float, typer.Option(help="Displacement of the top side over the height of the sheet.")] = 0.25,
    cells: TissueOptions,
    steps: Annotated[int, typer.Option(help="Equal load steps.")] = 25,
    write_every: Annotated[int, typer.Option(help="A file for ParaView every so many steps, and at the last.")] = 5,
    convergence: Annotated[str, typer.Option(help="Also sheets of these sizes in blocks, as 10x5,20x10,40x20.")] = "",
    band: Annotated[str, typer.Option(help="Also these bar forces, N, as 1e-9,5e-8, on at most 20x10 blocks.")] = "",
    linear_solver: LinearSolver = "auto",
    plots: Plots = True,
) -> None:
    """Stretch a sheet of cells with every bar and tendon: stress, and the strain of every cell."""
    check_alone("monolayer")
    from workflows.runs.monolayer import monolayer as run

    summary = run(
        out,
        blocks=blocks,
        layers=layers,
        strain=strain,
        steps=steps,
        write_every=write_every,
        convergence=_sizes("convergence", convergence),
        band=_numbers("band", band),
        tissue=cells.make(),
        linear_solver=linear_solver,
        plots=plots,
        say=say,
    )
    names = "dofs cell_apparent_modulus modulus_ratio modulus_ratio_at_full_strain edge_contraction seconds peak_memory"
    report(summary, names, out)


@bodies.command()
@grouped
def calibrate(
    *,
    data: Annotated[Path, typer.Option(help="CSV of force and displacement (cell) or strain and stress (monolayer).")],
    out: Out,
    fit: Annotated[
        list[str], typer.Option(help="Parameters to fit: bar-force, E-tendon, E-bar, half-diagonal, contact-point.")
    ],
    more: Annotated[
        list[str] | None, typer.Argument(metavar="[PARAMETER]...", help="More of them, as in --fit bar-force E-tendon.")
    ] = None,
    scene: Annotated[str, typer.Option(help="cell or monolayer.")] = "cell",
    column: Annotated[
        list[str] | None, typer.Option(help="QUANTITY=HEADER:UNIT, as force=F:nN; else headers with units, force_nN.")
    ] = None,
    cells: TissueOptions,
    blocks: Annotated[tuple[int, int], typer.Option(help="Sheet of the monolayer scene, blocks along x and y.")] = (
        4,
        2,
    ),
    top: Top = "free",
    save_tissue: Annotated[Path | None, typer.Option(help="Write the fitted tissue there, TOML, for --tissue.")] = None,
    table: TableOptions,
    plots: Plots = True,
) -> None:
    """Fit parameters to a measured curve, and say how well each is determined."""
    check_alone("calibrate")
    from tsg_micro.bodies.curve_fit import Model
    from workflows.runs.calibrate import calibrate as run

    model = Model(scene, cells.make(), blocks=blocks, top=top)
    summary = run(
        out,
        data=data,
        fit=[*fit, *(more or [])],
        model=model,
        column=column or [],
        layout=table.make(),
        save_tissue=save_tissue,
        plots=plots,
    )
    for name, row in summary["fitted"].items():
        known = row["interval"]
        shown = "no interval" if known is None else f"95 %: {known[0]:.4g} .. {known[1]:.4g}"
        say(f"{name:24} {row['value']:.4g} {row['unit']} ({shown})".replace(" 1 (", " ("))
    for warning in summary["warnings"]:
        say(f"{'warning':24} {warning}")
    report(summary, "points rms evaluations seconds", out)


@bodies.command()
@grouped
def spheroid(
    *,
    out: Out,
    radius: Annotated[float, typer.Option(help="Radius in blocks of 2x2x2 cells.")] = 5.0,
    f_max: Annotated[float, typer.Option(help="Bar force at the centre, N.")] = 5e-8,
    profile: Annotated[
        str, typer.Option(help="exponential, linear, constant, or a CSV file with columns r_over_R,f_over_fmax.")
    ] = "exponential",
    decay: Annotated[float, typer.Option(help="k: the bar force at the rim is f_max exp(-k).")] = 2.0,
    load: Annotated[
        str, typer.Option(help="pressure, which follows the surface, or displacement of the surface.")
    ] = "pressure",
    level: Annotated[
        float | None, typer.Option(help="Pressure in Pa (100 if not given), or linear strain (0.02).")
    ] = None,
    steps: Annotated[int, typer.Option(help="Recorded levels of the load.")] = 5,
    cells: CellOptions,
    linear_solver: LinearSolver = "auto",
    plots: Plots = True,
) -> None:
    """Compress a spheroid whose bar force rises towards its core: radial stress of every block."""
    check_alone("spheroid")
    from workflows.runs.spheroid import spheroid as run

    summary = run(
        out,
        radius=radius,
        f_max=f_max,
        profile=profile,
        decay=decay,
        load=load,
        level=level,
        steps=steps,
        tissue=cells.make(),
        linear_solver=linear_solver,
        plots=plots,
        say=say,
    )
    report(summary, "blocks reached volume_change core_over_rim rises_to_core factorisations seconds peak_memory", out)
