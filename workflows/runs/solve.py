"""tsgdd solve: the data-driven finite element solution of a sheet, on any number of MPI ranks."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dd_macro as dd
from dd_macro.methods.metric_choice import check_metric
from dd_macro.parallel import together
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import read_dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from workflows.runs.adaptation import rve_of, source_for
from workflows.runs.checks import check_limit, judge
from workflows.runs.edges import data_of, in_parts, inside_of, sampled_places, specs_of
from workflows.runs.progress import progress
from workflows.runs.rest import with_rest
from workflows.runs.scene import Scene, read_material, tissue_of
from workflows.store.record import drop_summary, peak_memory, write_summary

__all__ = ["solve"]

_OF_ORDER = {1: "classical", 2: "second order"}
_ITERATIONS = {"classical": 300}
"""At most, where nothing is asked for and it is not what the method has."""
_LEAST = 4


@dataclass(frozen=True)
class _Asked:
    """What is asked for; see :func:`solve`."""

    data: Path | None
    scene: Scene
    metric: str
    order: int | None
    stress_measure: str | None
    max_iterations: int | None
    over_relaxation: float | None
    tissue: Tissue | None
    adaptation: dd.Adaptation | None
    name: str | None

    @property
    def tangents(self) -> int:
        """The order of the data."""
        return (1 if self.adaptation is None else 2) if self.order is None else self.order

    def method(self) -> dd.Method:
        """The method with its numbers.

        Raises:
            InputError: there is no such method or order, or it has no such number.
        """
        check_metric(self.metric)
        if self.tangents not in (1, 2) or (self.adaptation is not None and self.tangents == 1):
            wanted = "1 or 2" if self.adaptation is None else "2 with --adapt"
            raise InputError(f"order: expected {wanted}, got {self.tangents}")
        name = self.name or _OF_ORDER[self.tangents]
        if name not in dd.METHODS:
            raise InputError(f"method: expected one of {'; '.join(dd.METHODS)}, got {name!r}")
        method = dd.METHODS[name] if self.adaptation is None else dd.AdaptiveMethod(self.adaptation)
        iterations = self.max_iterations
        if iterations is None and self.adaptation is None:
            iterations = _ITERATIONS.get(name)
        return method.tuned(max_iterations=iterations, over_relaxation=self.over_relaxation)

    def read(self) -> tuple[Dataset | None, RVESpec | None]:
        """The data to start from, if there are, and the RVE of the inside, if it is known.

        Raises:
            InputError: they will not do.
        """
        if self.adaptation is None:
            if self.data is None:
                raise InputError("data: expected a file, or --adapt with --bar-force, got neither")
            dataset = with_rest(read_material(self.data, self.scene, self.stress_measure))
            inside = inside_of(dataset, self.scene.kind)
            if self.tangents == 2 and dataset.tangent is None and len(dataset) < _LEAST:
                raise InputError(
                    f"data: expected tangents, or at least {_LEAST} points to estimate them from, got {len(dataset)}"
                )
            return dataset, inside
        raw = None if self.data is None else read_dataset(self.data)
        rve = rve_of(self.tissue, raw, self.scene.kind)
        if raw is None and self.metric == "secant":
            raise InputError("metric: expected auto, tangent or visited where there are no data, got 'secant'")
        theory = dd.THEORIES[self.scene.kinematics]
        return None if raw is None else theory.dataset(raw, self.stress_measure), rve

    def prepare(self, comm: MPI.Comm, dataset: Dataset | None, rve: RVESpec | None) -> dd.Prepared:
        """Mesh, metric, matrix and search; collective."""
        measure = dd.THEORIES[self.scene.kinematics].solved(self.stress_measure)
        if rve is None:
            return self.method().prepare(self.scene.problem(comm), dd.Material(dataset, self.metric, measure=measure))
        there = sampled_places(rve, dataset) if self.adaptation is None and dataset is not None else None
        problem = self.scene.problem(comm, rve.tissue, rve, there)
        specs = specs_of(rve, problem)
        parts = []
        for spec, given in zip(specs, data_of(dataset, specs), strict=True):
            source = None if self.adaptation is None else source_for(self.scene, spec, problem)
            parts.append(dd.Material(given, self.metric, source=source, measure=measure))
        return self.method().prepare(problem, in_parts(parts))

    def parameters(self, dataset: Dataset) -> dict[str, Any]:
        """For the summary."""
        plan, known = self.adaptation, tissue_of(dataset)
        forces = {source.get("bar_force") for source in dataset.sources}
        force = None if self.tissue is None else self.tissue.bar_force
        return {
            "data": self.data,
            **self.scene.parameters(),
            "metric": self.metric,
            "order": self.tangents,
            "stress_measure": self.stress_measure,
            "adaptation": None if plan is None else {"bar_force": force, **asdict(plan)},
            **({} if known is None else known.as_dict()),
            "bar_force": forces.pop() if len(forces) == 1 else None,
        }


def solve(
    out: Path,
    *,
    data: Path | None,
    scene: Scene,
    metric: str = "auto",
    order: int | None = None,
    stress_measure: str | None = None,
    max_iterations: int | None = None,
    over_relaxation: float | None = None,
    tissue: Tissue | None = None,
    adaptation: dd.Adaptation | None = None,
    method: str | None = None,
    max_error: float | None = None,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Solve ``scene`` with the material data of the file ``data``; all ranks of the world take part.

    With ``order`` 1 a datum is a point, with 2 its tangent space; data without tangents get estimated ones then. With
    ``adaptation`` the scene decides which RVEs of ``tissue``, that of the data if None, are computed as more data, and
    ``data`` may be None; the order is 2. ``method`` is another of dd_macro.METHODS. In small strain ``stress_measure``
    is the stress to solve in, that of the data if None; in finite strain the one to write, first Piola if None. Writes
    quadrature.h5, fields.vtkhdf, figures and summary.json into ``out``, with ``adaptation`` data.h5 too.

    Raises:
        InputError: an argument or a file is not valid, or the scene's strain is outside the data.
        ConvergenceError: the fixed-point iteration or a linear solve did not converge; or the estimated error is more
            than ``max_error``, after all files were written.
    """
    asked = _Asked(
        *(data, scene, metric, order, stress_measure, max_iterations, over_relaxation, tissue, adaptation, method)
    )
    check_limit(max_error)
    solution, seconds, rve = _solution(asked, out, say)
    verdict = judge(solution, scene, rve, max_error)
    say(verdict.line)
    assert solution.dataset is not None
    measure = dd.THEORIES[scene.kinematics].shown(solution.dataset, stress_measure)
    drop_summary(out, MPI.COMM_WORLD)
    dd.write_solution(out, solution, stress_measure=measure)
    figures = solution.figures() | {"top_force": (scene.top_force(solution), "N"), "stress_measure": (measure, "")}
    figures |= {"peak_memory": (peak_memory(), "B"), **{name: (value, "s") for name, value in seconds.items()}}
    figures |= verdict.figures()
    summary, comm = None, MPI.COMM_WORLD
    if comm.rank == 0:
        parameters = asked.parameters(solution.dataset) | {"max_error": max_error}
        summary = write_summary(out, command="solve", parameters=parameters, figures=figures)
        if plots:
            from workflows.runs.scene_figures import draw_solution

            draw_solution(out, solution)
    verdict.enforce()
    return comm.bcast(summary)


def _solution(
    asked: _Asked, out: Path, say: Callable[[str], None]
) -> tuple[dd.Solution, dict[str, float], RVESpec | None]:
    """The solution, what it took, and the RVE of the inside."""
    comm = MPI.COMM_WORLD
    asked.method()
    dataset, rve = together(comm, asked.read)
    together(comm, lambda: output_folder(out) if comm.rank == 0 else None)

    def keep(found: Dataset) -> None:
        drop_summary(out, comm)
        together(comm, lambda: write_dataset(out / "data.h5", found) if comm.rank == 0 else None)

    begin = time.perf_counter()
    prepared = asked.prepare(comm, dataset, rve)
    ready = time.perf_counter()
    chosen = f", {prepared.text}" if prepared.text else ""
    dofs = prepared.problem.operator.global_dofs
    say(f"{dofs} unknowns on {comm.size} rank{'s' * (comm.size > 1)}{chosen}")
    with progress("solve") as told:
        found = prepared.solve(watch=dd.Watch(say, keep, told))
    done = time.perf_counter()
    say(f"{found.iterations} iterations ({found.reason}), normalised distance {found.normalised_distance:.2%}")
    took = {"seconds": done - begin, "seconds_metric": prepared.seconds_metric, "seconds_setup": ready - begin}
    return found, took, rve
