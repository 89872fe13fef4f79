"""tsgdd solve: the data-driven finite element solution of a sheet, on any number of MPI ranks."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

import dd_macro as dd
from dd_macro.parallel import check_everywhere, total
from tsg_micro.dataset import Dataset, convert_dataset, read_dataset
from tsg_micro.errors import InputError
from tsg_micro.files import output_folder
from tsg_micro.mandel import COMPONENTS, to_mandel
from workflows.loads import LOADS, check_load, nominal_strain, top_displacement
from workflows.record import peak_memory, write_summary

__all__ = ["METRICS", "Scene", "solve"]

BLOCK = 20e-6
"""Edge of a 2x2x2-cell block, m (paper: cell height 10 um)."""
METRICS = {
    "auto": dd.metric_from_dataset,
    "tangent": dd.mean_tangent,
    "secant": dd.secant_modulus,
}


@dataclass(frozen=True)
class Scene:
    """What is loaded, and how: a box of one element a block, or the hexahedra of a gmsh file."""

    load: str
    strain: float
    elements: tuple[int, int, int] | None = None
    mesh: Path | None = None

    def __post_init__(self) -> None:
        check_load(self.load, self.strain)
        if (self.elements is None) == (self.mesh is None):
            raise InputError("elements, mesh: expected one of them, --elements NX NY NZ or --mesh FILE.msh")

    def build(self, comm: MPI.Comm) -> dd.TaggedMesh:
        """The mesh, distributed over ``comm``."""
        if self.mesh is not None:
            return dd.read_msh(self.mesh, comm)
        assert self.elements is not None
        return dd.box(comm, elements=self.elements, size=tuple(BLOCK * n for n in self.elements))  # type: ignore[arg-type]


def solve(
    out: Path,
    *,
    data: Path,
    scene: Scene,
    metric: str = "auto",
    stress_measure: str | None = None,
    options: dd.SolverOptions | None = None,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Solve ``scene`` with the material data of the file ``data``; all ranks of the world take part.

    Writes quadrature.h5, fields.vtkhdf, figures and summary.json into ``out``.

    Raises:
        InputError: an argument or a file is not valid, or the scene's strain is outside the data.
        ConvergenceError: the fixed-point iteration or a linear solve did not converge.
    """
    comm = MPI.COMM_WORLD
    if metric not in METRICS:
        raise InputError(f"metric: expected one of {', '.join(METRICS)}, got {metric!r}")
    dataset = _together(comm, lambda: _material(data, scene, stress_measure))
    _together(comm, lambda: output_folder(out) if comm.rank == 0 else None)

    begin = time.perf_counter()
    domain = scene.build(comm)
    operator = dd.StrainOperator(domain)
    y = domain.mesh.geometry.x[:, 1]  # none on a rank without cells
    low = comm.allreduce(float(np.min(y, initial=np.inf)), MPI.MIN)
    high = comm.allreduce(float(np.max(y, initial=-np.inf)), MPI.MAX)
    conditions = [
        dd.Displacement("bottom"),
        dd.Displacement("top", value=top_displacement(scene.load, scene.strain, high - low)),
    ]
    C = METRICS[metric](dataset)
    projection = dd.Projection(operator, C, conditions)
    search = dd.MaterialSearch(dataset, C)
    ready = time.perf_counter()
    ranks = f"{comm.size} rank{'s' * (comm.size > 1)}"
    say(f"{operator.global_dofs} unknowns on {ranks}, {projection.solver}; metric: {C.reason}")
    result = dd.solve(projection, search, options=options)
    done = time.perf_counter()
    say(f"{result.iterations} iterations ({result.reason}), normalised distance {result.normalised_distance:.2%}")

    reaction = projection.reaction(result.mechanical.stress, "top")[LOADS[scene.load]]
    dd.write_quadrature(out / "quadrature.h5", operator, result, stress_measure=dataset.stress_measure)
    dd.write_vtkhdf(out / "fields.vtkhdf", projection, result)
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
        "stress_measure": (dataset.stress_measure, ""),
        "metric": (C.C, "Pa"),
        "metric_reason": (C.reason, ""),
        "linear_solver": (projection.solver, ""),
        "queries": (queries, ""),
        "queries_skipped": (skips, ""),
        "distance_history": ([i.distance for i in result.history], "sqrt(J)"),
        "changed_history": ([i.changed for i in result.history], ""),
        "seconds": (done - begin, "s"),
        "seconds_setup": (ready - begin, "s"),
        "seconds_search": (sum(i.seconds_search for i in result.history), "s"),
        "seconds_linear_solves": (sum(i.seconds_solve for i in result.history), "s"),
        "peak_memory": (peak_memory(), "B"),
    }
    parameters = {
        "data": data,
        "load": scene.load,
        "strain": scene.strain,
        "elements": scene.elements,
        "mesh": scene.mesh,
        "metric": metric,
        "stress_measure": stress_measure,
        "bar_force": dataset.parameters.get("bar_force"),
    }
    summary = None
    if comm.rank == 0:
        summary = write_summary(out, command="solve", parameters=parameters, figures=figures)
        if plots:
            _draw(out, result)
    return comm.bcast(summary)


def _material(data: Path, scene: Scene, stress_measure: str | None) -> Dataset:
    """The data in the measure asked for; InputError where they do not reach the nominal strain of the scene."""
    dataset = read_dataset(data)
    dataset = convert_dataset(dataset, stress_measure or dataset.stress_measure)
    wanted = to_mandel(nominal_strain(scene.load, scene.strain))
    k = int(np.abs(wanted).argmax())
    low, high = dataset.strain[:, k].min(), dataset.strain[:, k].max()
    if not low <= wanted[k] <= high:
        scale = 1.0 if k < 3 else np.sqrt(2.0)
        raise InputError(
            f"strain: expected a nominal eps_{COMPONENTS[k]} within the data's range "
            f"[{low / scale:.4g}, {high / scale:.4g}], got {wanted[k] / scale:.4g}"
        )
    return dataset


def _together[T](comm: MPI.Comm, action: Callable[[], T]) -> T:
    """What ``action`` returns on each rank; bad input that only some ranks see is raised on all of them."""
    message = None
    try:
        result = action()
    except InputError as error:
        message = str(error)
    check_everywhere(comm, message)
    return result


def _draw(out: Path, result: dd.DataDrivenResult) -> None:
    """Figures from the written file; rank 0 only, nothing is gathered."""
    from dd_macro.plot import plot_convergence, plot_maps, save_figure

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
