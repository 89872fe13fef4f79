"""The command line of bodies: meshes from surfaces and images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.options import Plots, out_option
from workflows.runs.printing import report, say
from workflows.runs.ranks import check_alone

__all__ = ["mesh"]

mesh = typer.Typer(help="Meshes of hexahedra, for solve and fe2 --mesh.", no_args_is_help=True)


@mesh.callback()
def _group() -> None:
    """Meshes of hexahedra, for solve and fe2 --mesh."""


@mesh.command()
def voxels(
    *,
    out: Annotated[Path, out_option("Mesh to write, FILE.msh; picture and summary go beside it.")],
    size: Annotated[str, typer.Option(help="Edge of a voxel, as 20um; a plain number is in m.")],
    surface: Annotated[Path | None, typer.Option(help="Closed surface, STL, PLY or OBJ.")] = None,
    unit: Annotated[str | None, typer.Option(help="Of the surface's coordinates: m, mm, um or nm.")] = None,
    labels: Annotated[Path | None, typer.Option(help="TIFF stack of labels, 0 outside the body.")] = None,
    spacing: Annotated[
        tuple[str, str, str] | None, typer.Option(help="Of the labels' pixels along x, y, z, as 0.5um 0.5um 2um.")
    ] = None,
    plots: Plots = True,
) -> None:
    """Fill a closed surface, or a labelled image, with cubes: a mesh with sides, labels becoming regions."""
    check_alone("mesh voxels")
    from workflows.runs.voxels import voxels as run

    summary = run(out, size=size, surface=surface, unit=unit, labels=labels, spacing=spacing, plots=plots)
    if summary["dropped_voxels"]:
        say(f"{'warning':24} {summary['parts']} parts are not joined by faces; kept the largest")
    report(summary, "voxels dropped_voxels volume volume_ratio", out)
