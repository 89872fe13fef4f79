"""tsgdd solve SCENE.toml: a scene from a file, by any method, in steps of its load, on any number of MPI ranks."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dd_macro as dd
from dd_macro.methods.finite_projection import scaled_state
from dd_macro.methods.law_method import PreparedLaw
from dd_macro.parallel import together
from dd_macro.results.sides import side_displacement, volume_change
from dd_macro.results.vtkhdf import write_cells
from tsg_micro.data.dataset import Dataset, write_dataset
from tsg_micro.data.errors import ConvergenceError
from tsg_micro.data.files import atomic_path, output_folder
from workflows.runs.edges import in_parts
from workflows.runs.materials import method_of, read_tissues, the_material
from workflows.runs.scene_figures import draw_scene
from workflows.scenes.model import SceneModel
from workflows.scenes.scene import Built, build
from workflows.store.record import drop_summary, peak_memory, write_summary

__all__ = ["scene_parameters", "solve_scene"]

MEASURE = "first_piola"
"""The stress that is written."""


def solve_scene(
    out: Path,
    model: SceneModel,
    *,
    command: str = "solve",
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Solve the scene in the steps of its load; all ranks of the world take part. ``command`` is for the summary.

    Writes quadrature.h5 and fields.vtkhdf of the last step, step-N.vtkhdf of each and fields.vtkhdf.series of all where
    there are several, data.h5 of an adaptive run, figures and, last of all, summary.json into ``out``.

    Raises:
        InputError: the scene is not valid, before any work.
        ConvergenceError: a step did not converge.
    """
    comm, begin = MPI.COMM_WORLD, time.perf_counter()
    built = build(comm, model)
    method = method_of(built)
    known = together(comm, lambda: read_tissues(built, method))
    together(comm, lambda: output_folder(out) if comm.rank == 0 else None)
    computed = isinstance(method, dd.AdaptiveMethod) or (isinstance(method, dd.LawMethod) and method.fit is None)
    keep = [one.keep(computed=computed) for one in known]
    problem = built.problem([one.rve for one in known], keep)
    run = _Run(out, built, method, the_material(built, method, known, problem), problem, say)
    drop_summary(out, comm)
    for number in range(1, len(model.solve.factors) + 1):
        run.step(number)
    dd.write_solution(out, run.solution, stress_measure=MEASURE)
    figures = run.figures() | {"seconds": (time.perf_counter() - begin, "s"), "peak_memory": (peak_memory(), "B")}
    summary = None
    if comm.rank == 0:
        summary = write_summary(out, command=command, parameters=scene_parameters(built), figures=figures)
        if plots:
            draw_scene(out, run.solution, run.rows)
    return comm.bcast(summary)


class _Run:
    """The steps so far: the last solution, what every step said, and the data of an adaptive run."""

    def __init__(
        self,
        out: Path,
        built: Built,
        method: dd.Method,
        material: dd.Material,
        problem: dd.Problem,
        say: Callable[[str], None],
    ) -> None:
        self.out, self.built, self.method, self.problem, self.say = out, built, method, problem, say
        self.material = material
        self.rows: list[dict[str, Any]] = []
        self._last: dd.Solution | None = None
        self._prepared: dd.Prepared | None = None

    @property
    def solution(self) -> dd.Solution:
        """That of the last step."""
        assert self._last is not None
        return self._last

    def step(self, number: int) -> None:
        """Solve step ``number``, from 1, and write it."""
        factors, clock = self.built.model.solve.factors, time.perf_counter()
        factor = factors[number - 1]
        before = factors[number - 2] if number > 1 else 0.0
        prepared = self._prepare(factor)
        if number == 1:
            dofs, size = self.problem.operator.global_dofs, self.problem.operator.comm.size
            self.say(f"{dofs} unknowns on {size} rank{'s' * (size > 1)}{', ' * bool(prepared.text)}{prepared.text}")
        try:
            self._last = self._solved(prepared, before, factor)
        except ConvergenceError as error:
            where = f"step {number} of {len(factors)}, load {factor:g}"
            raise ConvergenceError(f"{where}: {error}", error.history) from None
        self.rows.append(self._row(factor) | {"seconds": time.perf_counter() - clock})
        self.say(f"step {number} of {len(factors)}, load {factor:g}: {self._last.note} ({self._last.reason})")
        if len(factors) > 1:
            self._write_step(number)

    def _prepare(self, factor: float) -> dd.Prepared:
        """The method for this part of the load; what does not change with it is not made anew."""
        material, last = self.material, self._prepared
        if isinstance(self._last, dd.AdaptiveResult):
            data = self._last.part_data
            parts = [replace(part, dataset=own) for part, own in zip(material.each, data, strict=True)]
            material = in_parts(parts)
        projection = last.projection.at(factor) if isinstance(last, dd.PreparedData) else None
        self._prepared = self.method.prepare(self.problem.at(factor), material, projection=projection)
        return self._prepared

    def _solved(self, prepared: dd.Prepared, before: float, factor: float) -> dd.Solution:
        """From the last step on, if there was one that was loaded."""
        watch, last = dd.Watch(self.say, self._keep), self._last
        if last is None or before == 0.0:
            return prepared.solve(watch=watch)
        if isinstance(prepared, PreparedLaw):
            return prepared.solve(last.mechanical, watch, start_factor=before)
        if isinstance(self.method, dd.PointMethod):
            return prepared.solve(watch=watch)  # its answer is the better for the elastic start
        return prepared.solve(scaled_state(self.problem, last.mechanical, factor / before), watch)

    def _keep(self, data: Dataset) -> None:
        comm = self.problem.operator.comm
        together(comm, lambda: write_dataset(self.out / "data.h5", data) if comm.rank == 0 else None)

    def _row(self, factor: float) -> dict[str, Any]:
        """What is kept of the step; collective."""
        found, domain = self.solution, self.built.domain
        held = [one.side for one in self.problem.supports]
        sides = [side for side in held if isinstance(side, str)]
        return {
            "factor": factor,
            "reactions": {side: found.reaction(side).tolist() for side in sides},
            "displacements": {side: side_displacement(found, side).tolist() for side in sorted(domain.names)},
            "volume_change": volume_change(found),
        }

    def _write_step(self, number: int) -> None:
        comm = self.problem.operator.comm
        write_cells(self.out / f"step-{number}.vtkhdf", self.solution)
        files = [{"name": f"step-{k + 1}.vtkhdf", "time": row["factor"]} for k, row in enumerate(self.rows)]
        if comm.rank == 0:
            with atomic_path(self.out / "fields.vtkhdf.series") as temporary:
                temporary.write_text(json.dumps({"file-series-version": "1.0", "files": files}, indent=1) + "\n")

    def figures(self) -> dict[str, tuple[Any, str]]:
        """What the summary says; collective."""
        last = self.rows[-1]
        found = self.solution.figures() | {
            "reactions": (last["reactions"], "N"),
            "displacements": (last["displacements"], "m"),
            "volume_change": (last["volume_change"], "1"),
            "stress_measure": (MEASURE, ""),
            "warnings": ([], ""),
        }
        units = {"factor": "1", "reactions": "N", "displacements": "m", "volume_change": "1", "seconds": "s"}
        return found | {f"{name}_steps": ([row[name] for row in self.rows], unit) for name, unit in units.items()}


def scene_parameters(built: Built) -> dict[str, Any]:
    """For the summary: the scene as it was understood, in SI."""
    kinds = dict(zip(built.names, built.kinds, strict=True))
    tissues = {name: one.as_dict() for name, one in zip(built.names, built.tissues, strict=True)}
    return {"scene": built.model.model_dump(mode="json"), "tissues": tissues, "kinds": kinds}
