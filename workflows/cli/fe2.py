"""The command line of FE2."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.options import (
    BarForce,
    Clamp,
    ClampName,
    Degree,
    Element,
    Flat,
    Kinematics,
    KinematicsName,
    Load,
    MergeNodes,
    MeshUnit,
    Out,
    Plots,
    Strain,
    report,
    say,
)

__all__ = ["fe2"]


def fe2(
    out: Out,
    elements: Annotated[tuple[int, int, int] | None, typer.Option(help="Elements along x, y, z; a block each.")] = None,
    mesh: Annotated[Path | None, typer.Option(help="Hexahedral gmsh mesh, sides named bottom and top.")] = None,
    mesh_unit: MeshUnit = "m",
    merge_nodes: MergeNodes = False,
    load: Annotated[Load, typer.Option(help="How the top side moves.")] = Load.stretch,
    strain: Strain = 0.05,
    bar_force: BarForce = 1e-8,
    kinematics: Kinematics = KinematicsName.small,
    clamp: Clamp = ClampName.full,
    degree: Degree = 1,
    element: Element = None,
    flat: Flat = False,
    steps: Annotated[int, typer.Option(help="Load steps; they are halved where Newton's method fails.")] = 1,
    tolerance: Annotated[float, typer.Option(help="Out-of-balance force over that of the supports.")] = 1e-9,
    plots: Plots = True,
) -> None:
    """FE2, an RVE at every quadrature point instead of data; on any number of ranks (mpirun -n N tsgdd fe2 ...)."""
    import dd_macro
    from tsg_micro.cells.tissue import Tissue
    from workflows.runs.fe2 import fe2 as run
    from workflows.runs.scene import Scene

    summary = run(
        out,
        scene=Scene(
            *(load.value, strain, elements, mesh, kinematics.value, clamp.value, degree, flat, element),
            mesh_unit=mesh_unit,
            merge_nodes=merge_nodes,
        ),
        tissue=Tissue(bar_force=bar_force),
        steps=steps,
        options=dd_macro.ReferenceOptions(tolerance=tolerance),
        plots=plots,
        say=say,
    )
    names = "iterations residual top_force quadrature_points rve_solves unstable_rves ranks seconds_rve seconds"
    report(summary, names, out)
