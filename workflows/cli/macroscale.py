"""The command line of the macroscopic scale: data-driven solutions, FE2, and both against the full tensegrity."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.option_groups import SceneOptions, TissueOptions, WantedTissueOptions, grouped
from workflows.runs.options import Measure, Out, Plots, SceneFile
from workflows.runs.printing import report, report_sides, say
from workflows.runs.ranks import check_alone

__all__ = ["macroscale"]

macroscale = typer.Typer()


@macroscale.command()
@grouped
def solve(
    *,
    scene_file: SceneFile = None,
    out: Out,
    method: Annotated[
        str | None,
        typer.Option(help="points, tangents, adaptive, FE2 or another; that of the file if not given."),
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Material data, HDF5; none are needed with --adapt.")] = None,
    scene: SceneOptions,
    metric: Annotated[
        str, typer.Option(help="auto, tangent, visited (first solve picks tangents) or secant.")
    ] = "auto",
    order: Annotated[
        int | None, typer.Option(help="1: a datum is a point; 2: it is its tangent space. 2 with --adapt, else 1.")
    ] = None,
    adapt: Annotated[
        bool, typer.Option("--adapt", help="Compute RVEs where the scene lacks data; OUT/data.h5.")
    ] = False,
    cell: WantedTissueOptions,
    rve_budget: Annotated[int | None, typer.Option(help="With --adapt: RVEs at most; 200 if not given.")] = None,
    adapt_tolerance: Annotated[
        float | None, typer.Option(help="With --adapt: estimated error that ends it; 0.005 if not given.")
    ] = None,
    stress_measure: Annotated[
        Measure | None,
        typer.Option(help="Stress to solve in, else the data's; in finite strain to write, else first_piola."),
    ] = None,
    max_iterations: Annotated[
        int | None, typer.Option(help="Iterations at most; 300 with order 1, 1000 with order 2 if not given.")
    ] = None,
    over_relaxation: Annotated[
        float | None,
        typer.Option(help="Of order 1: factor w of a query at y + w (z - y), 1 <= w < 2, at first; 1.8 if not given."),
    ] = None,
    max_error: Annotated[
        float | None, typer.Option(help="Estimated error beyond which the run fails, 0.02 for 2 %.")
    ] = None,
    plots: Plots = True,
) -> None:
    """Solution of a scene file, or of a sheet by options; on any number of ranks (mpirun -n N tsgdd solve ...)."""
    if scene_file is not None:
        given: dict[str, object] = {"data": data, "order": order, "adapt": adapt or None, "rve_budget": rve_budget}
        given |= {"adapt_tolerance": adapt_tolerance, "stress_measure": stress_measure}
        given |= {"max_iterations": max_iterations, "over_relaxation": over_relaxation}
        given |= {"metric": None if metric == "auto" else metric} | dict.fromkeys(scene.given | cell.given, True)
        _solve_file(scene_file, out, given, method=method, max_error=max_error, plots=plots)
        return
    from workflows.runs.adaptation import adaptation
    from workflows.runs.solve import solve as run

    tissue = cell.make_if_given(adapt=adapt)
    summary = run(
        out,
        data=data,
        scene=scene.make(),
        metric=metric,
        order=order,
        stress_measure=None if stress_measure is None else stress_measure.value,
        max_iterations=max_iterations,
        over_relaxation=over_relaxation,
        method=method,
        tissue=tissue,
        adaptation=adaptation(adapt, tissue=tissue, rve_budget=rve_budget, adapt_tolerance=adapt_tolerance),
        max_error=max_error,
        plots=plots,
        say=say,
    )
    for warning in summary["warnings"]:
        say(f"{'warning':24} {warning}")
    if adapt:
        report(summary, "adapt_reason rves failed_rves estimated_error seconds_rve", out / "data.h5")
    report(summary, "iterations converged normalised_distance quadrature_points data_points ranks seconds", out)


@macroscale.command()
def compare(
    dd: Annotated[Path, typer.Option(help="Folder of a data-driven run.")],
    dns: Annotated[Path, typer.Option(help="Folder of the full tensegrity run of the same scene.")],
    out: Out,
    plots: Plots = True,
) -> None:
    """Compare data-driven stresses with those of the full tensegrity, block by block."""
    check_alone("compare")
    from workflows.runs.compare import compare as run

    summary = run(out, dd=dd, dns=dns, plots=plots)
    for name in ("error_p_mech", "error_p_mat", "error_q_mech", "error_q_mat"):
        if name in summary:
            values = "  ".join(f"{kind} {value:.2%}" for kind, value in summary[name].items())
            say(f"{name:24} {values}")
    for name in ("errors_mech", "errors_mech_inner"):
        for what in ("p", "q", "stress"):
            if name in summary and summary[name].get(what):
                say(f"{f'{name} {what}':24} l2 {summary[name][what]['l2']:.2%}")
    if "error_shells_largest_mech" in summary:
        say(f"{'error of shells, largest':24} {summary['error_shells_largest_mech']:.2%}")
    if summary["dns_buckled"]:
        say("the full tensegrity has buckled, the data-driven sheet cannot: compare with that of 'tsgdd dns --flat'")
    say(f"{'results':24} {out}")


def _solve_file(
    path: Path,
    out: Path,
    given: Mapping[str, object],
    *,
    method: str | None,
    max_error: float | None = None,
    plots: bool,
    command: str = "solve",
) -> None:
    """The scene of a file by the method, its own if None; ``given`` are the options that would say the same."""
    from workflows.runs.solve_scene import solve_scene
    from workflows.scenes.read import naming, read_alone

    model = read_alone(path, given, method=method)
    with naming(path):
        summary = solve_scene(out, model, command=command, max_error=max_error, plots=plots, say=say)
    for warning in summary["warnings"]:
        say(f"{'warning':24} {warning}")
    report_sides(summary)
    report(summary, "iterations normalised_distance volume_change quadrature_points ranks seconds", out)


@macroscale.command()
@grouped
def fe2(
    *,
    scene_file: SceneFile = None,
    out: Out,
    scene: SceneOptions,
    cell: TissueOptions,
    steps: Annotated[int, typer.Option(help="Load steps; they are halved where Newton's method fails.")] = 1,
    tolerance: Annotated[float, typer.Option(help="Out-of-balance force over that of the supports.")] = 1e-9,
    plots: Plots = True,
) -> None:
    """FE2, an RVE at every quadrature point instead of data; on any number of ranks (mpirun -n N tsgdd fe2 ...)."""
    if scene_file is not None:
        given: dict[str, object] = {
            "steps": None if steps == 1 else steps,
            "tolerance": None if tolerance == 1e-9 else tolerance,
        }
        given |= dict.fromkeys(scene.given | cell.given, True)
        _solve_file(scene_file, out, given, method="FE2", plots=plots, command="fe2")
        return
    import dd_macro
    from workflows.runs.fe2 import fe2 as run

    summary = run(
        out,
        scene=scene.make(),
        tissue=cell.make(),
        steps=steps,
        options=dd_macro.ReferenceOptions(tolerance=tolerance),
        plots=plots,
        say=say,
    )
    names = "iterations residual top_force quadrature_points rve_solves unstable_rves ranks seconds_rve seconds"
    report(summary, names, out)
