"""tsgdd solve: the data-driven finite element solution of a sheet, on any number of MPI ranks."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dd_macro as dd
from dd_macro.methods.metric_choice import check_metric
from dd_macro.parallel import together, total
from tsg_micro.data.dataset import Dataset, convert_dataset, read_dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from workflows.runs.adapt import Adaptation, Adapted, adapt, known_bar_force
from workflows.runs.loads import LOADS
from workflows.runs.scene import Scene, make_metric, read_material, with_tangents
from workflows.store.record import peak_memory, write_summary

__all__ = ["solve"]


def solve(
    out: Path,
    *,
    data: Path | None,
    scene: Scene,
    metric: str = "auto",
    order: int | None = None,
    stress_measure: str | None = None,
    options: dd.SolverOptions | None = None,
    adaptation: Adaptation | None = None,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Solve ``scene`` with the material data of the file ``data``; all ranks of the world take part.

    With ``order`` 1 a datum is a point, with 2 its tangent space; data without tangents get estimated ones then. With
    ``adaptation`` the scene decides which RVEs are computed as more data, and ``data`` may be None; the order is 2.

    In small strain ``stress_measure`` is the stress to solve in, that of the data if None; in finite strain it is the
    one to write, first Piola if None. Writes quadrature.h5, fields.vtkhdf, figures and summary.json into ``out``, with
    ``adaptation`` data.h5 too.

    Raises:
        InputError: an argument or a file is not valid, or the scene's strain is outside the data.
        ConvergenceError: the fixed-point iteration or a linear solve did not converge.
    """
    comm = MPI.COMM_WORLD
    check_metric(metric)
    order = order or (1 if adaptation is None else 2)
    if order not in (1, 2) or (adaptation is not None and order == 1):
        raise InputError(f"order: expected {'1 or 2' if adaptation is None else '2 with --adapt'}, got {order}")
    dataset = together(comm, lambda: _material(data, scene, metric, stress_measure, adaptation))
    together(comm, lambda: output_folder(out) if comm.rank == 0 else None)

    begin = time.perf_counter()
    domain = scene.build(comm)
    operator = scene.operator(domain)
    conditions = scene.conditions(domain)
    start = time.perf_counter()
    ranks = f"{comm.size} rank{'s' * (comm.size > 1)}"
    most = dd.SecondOrderOptions() if options is None else dd.SecondOrderOptions(options.max_iterations)
    result: dd.DataDrivenResult
    search: dd.MaterialSearch
    adapted: Adapted | None = None
    if adaptation is not None:
        chosen = ready = start

        def keep(found: Dataset) -> None:
            together(comm, lambda: write_dataset(out / "data.h5", found) if comm.rank == 0 else None)

        say(f"{operator.global_dofs} unknowns on {ranks}")
        measure = "first_piola" if scene.kinematics == "finite" else stress_measure
        material: dict[str, Any] = {"dataset": dataset, "metric": metric, "measure": measure}
        adapted = adapt(operator, conditions, adaptation, scene=scene, **material, options=most, keep=keep, say=say)
        result, dataset, projection, search = adapted.result, adapted.dataset, adapted.projection, adapted.search
        C = projection.metric
    else:
        assert dataset is not None
        C = make_metric(metric, operator, dataset, conditions, order=order)
        chosen = time.perf_counter()
        projection = dd.make_projection(operator, C, conditions)
        search = dd.MaterialSearch(dataset, C) if order == 1 else dd.TangentSearch(with_tangents(dataset), C)
        ready = time.perf_counter()
        say(f"{operator.global_dofs} unknowns on {ranks}, {projection.solver}; metric: {C.reason}")
        if isinstance(search, dd.TangentSearch):
            result = dd.solve_second_order(projection, search, options=most)
        else:
            result = dd.solve(projection, search, options=options)
    done = time.perf_counter()
    say(f"{result.iterations} iterations ({result.reason}), normalised distance {result.normalised_distance:.2%}")

    reaction = projection.reaction(result.mechanical, "top")[LOADS[scene.load]]
    measure = (stress_measure if scene.kinematics == "finite" else None) or dataset.stress_measure
    shown = dd.in_space(result, measure)
    dd.write_quadrature(out / "quadrature.h5", operator, shown, stress_measure=measure)
    dd.write_vtkhdf(out / "fields.vtkhdf", projection, shown)
    points = int(total(comm, len(operator.weights)))
    queries, skips = (int(n) for n in total(comm, [search.queries, search.skips]))
    figures = {
        "iterations": (result.iterations, ""),
        "converged": (result.converged, ""),
        "reason": (result.reason, ""),
        "normalised_distance": (result.normalised_distance, "1"),
        "distance": (result.distance, "sqrt(J)"),
        "outside_data": (result.outside_data, "fraction of quadrature points"),
        "top_force": (float(reaction), "N"),
        "quadrature_points": (points, ""),
        "data_points": (len(dataset), ""),
        "dofs": (operator.global_dofs, ""),
        "ranks": (comm.size, ""),
        "stress_measure": (measure, ""),
        "metric": (C.C, "Pa"),
        "metric_reason": (C.reason, ""),
        "linear_solver": (projection.solver, ""),
        "queries": (queries, ""),
        "queries_skipped": (skips, ""),
        "distance_history": ([i.distance for i in result.history], "sqrt(J)"),
        "changed_history": ([i.changed for i in result.history], ""),
        "seconds": (done - begin, "s"),
        "seconds_metric": (chosen - start, "s"),
        "seconds_setup": (ready - begin, "s"),
        "seconds_search": (sum(i.seconds_search for i in result.history), "s"),
        "seconds_linear_solves": (sum(i.seconds_solve for i in result.history), "s"),
        "peak_memory": (peak_memory(), "B"),
    }
    if isinstance(result, dd.SecondOrderResult):
        figures["extrapolated"] = (result.extrapolated, "fraction of quadrature points")
        figures["held"] = (result.held, "quadrature points")
    if adapted is not None:
        figures |= adapted.figures()
    parameters = {
        "data": data,
        **scene.parameters(),
        "metric": metric,
        "order": order,
        "stress_measure": stress_measure,
        "adaptation": None if adaptation is None else asdict(adaptation),
        "bar_force": dataset.parameters.get("bar_force"),
    }
    summary = None
    if comm.rank == 0:
        summary = write_summary(out, command="solve", parameters=parameters, figures=figures)
        if plots:
            _draw(out, result)
            if adapted is not None:
                _draw_rounds(out, adapted)
    return comm.bcast(summary)


def _material(
    data: Path | None, scene: Scene, metric: str, stress_measure: str | None, adaptation: Adaptation | None
) -> Dataset | None:
    """The data to start from, and whether they will do."""
    if adaptation is None:
        if data is None:
            raise InputError("data: expected a file, or --adapt with --bar-force, got neither")
        return read_material(data, scene, stress_measure)
    dataset = None if data is None else read_dataset(data)
    if dataset is not None and scene.kinematics == "finite":
        dataset = dd.biot_dataset(dataset)
    known_bar_force(adaptation, dataset)
    if dataset is None and metric == "secant":
        raise InputError("metric: expected auto, tangent or visited where there are no data, got 'secant'")
    if dataset is not None and scene.kinematics == "small":
        convert_dataset(dataset, stress_measure or dataset.stress_measure)
    return dataset


def _draw(out: Path, result: dd.DataDrivenResult) -> None:
    """Figures from the written file; rank 0 only, nothing is gathered."""
    from dd_macro.results.figures import plot_convergence
    from tsg_micro.data.figure_style import plot_maps, save_figure

    fields = dd.read_quadrature(out / "quadrature.h5")
    outline = fields.corners[:, :4, :2]
    maps = {
        "pressure $p$, mechanical": (fields.cell_mean(fields.mechanical_p), "Pa"),
        "pressure $p$, material": (fields.cell_mean(fields.material_p), "Pa"),
        "effective stress $q$, mechanical": (fields.cell_mean(fields.mechanical_q), "Pa"),
        "local distance": (fields.cell_mean(fields.local_distance), r"$\sqrt{\mathrm{J/m^3}}$"),
    }
    save_figure(plot_maps(outline, maps), out / "fields.png")
    history = result.history
    figure = plot_convergence([i.distance for i in history], [i.changed for i in history], [i.omega for i in history])
    save_figure(figure, out / "convergence.png")


def _draw_rounds(out: Path, adapted: Adapted) -> None:
    from dd_macro.results.figures import ROUNDS, plot_rounds
    from tsg_micro.data.figure_style import save_figure

    rounds = {name: [getattr(one, name) for one in adapted.rounds] for name in ROUNDS}
    save_figure(plot_rounds([one.data for one in adapted.rounds], rounds), out / "adaptation.png")
