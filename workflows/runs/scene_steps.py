"""The steps of a scene's load: every one is written, and a run that was cut goes on after the last."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import dd_macro as dd
from dd_macro.methods.finite_projection import scaled_state
from dd_macro.methods.law_method import PreparedLaw
from dd_macro.methods.projection import MechanicalState
from dd_macro.parallel import together
from dd_macro.results.sides import side_displacement, volume_change
from dd_macro.results.vtkhdf import write_cells
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import write_dataset
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import atomic_path
from workflows.runs.edges import in_parts
from workflows.runs.progress import progress
from workflows.runs.scene_checkpoint import Standing, read_standing, remove_standing, write_standing

__all__ = ["Steps"]

_SERIES = "fields.vtkhdf.series"


def _tell(told: Callable[[float], None], before: float, part: float) -> None:
    told(before + part)


class Steps:
    """The steps so far: the last solution, and ``rows`` of what every step said.

    Args:
        out: folder of the results.
        factors: part of the load at every step.
        method: how a step is solved.
        material: of the problem.
        problem: under the whole load.
        run: fingerprint of all that decides the answer.
        say: told how it goes.
    """

    def __init__(
        self,
        out: Path,
        factors: tuple[float, ...],
        *,
        method: dd.Method,
        material: dd.Material,
        problem: dd.Problem,
        run: str,
        say: Callable[[str], None],
    ) -> None:
        self.out, self.factors, self.method, self.problem, self.say = out, factors, method, problem, say
        self.material, self.run = material, run
        self.rows: list[dict[str, Any]] = []
        self._last: dd.Solution | None = None
        self._state: MechanicalState | None = None
        self._at = 0.0  # part of the load that the state is under
        self._data: tuple[Dataset, ...] = ()
        self._prepared: dd.Prepared | None = None

    def follow(self) -> int:
        """Take all steps that are not done, and return how many were; collective.

        Raises:
            ConvergenceError: a step did not converge.
            InputError: the folder cannot be written.
        """
        done = self._resume()
        comm = self.problem.operator.comm
        if not done and comm.rank == 0:
            (self.out / _SERIES).unlink(missing_ok=True)
        dofs, size = self.problem.operator.global_dofs, comm.size
        self.say(f"{dofs} unknowns on {size} rank{'s' * (size > 1)}")
        with progress("solve", len(self.factors) - done) as told:
            for number in range(done + 1, len(self.factors) + 1):
                self._step(number, partial(_tell, told, number - 1.0 - done))
                told(float(number - done))
        return done

    def finish(self) -> None:
        """Remove what is kept to go on from; collective."""
        comm = self.problem.operator.comm
        together(comm, lambda: remove_standing(self.out) if comm.rank == 0 else None)

    def _resume(self) -> int:
        """Go to the last step that is done, and return its number."""
        if len(self.factors) == 1:
            return 0
        try:
            found = read_standing(self.out, self.problem, self.run)
        except InputError as error:
            self.say(f"{error}: starting from the beginning")
            return 0
        if found is None or len(found.rows) > len(self.factors):
            return 0
        self._state, self._data, self._at = found.state, found.data, float(found.rows[-1]["factor"])
        self.rows = found.rows[: len(self.factors) - 1]  # the last one is solved again: its solution is the result
        self.say(f"going on after step {len(self.rows)} of {len(self.factors)}")
        return len(self.rows)

    @property
    def solution(self) -> dd.Solution:
        """That of the last step."""
        assert self._last is not None
        return self._last

    def _step(self, number: int, told: Callable[[float], None]) -> None:
        """Solve step ``number``, from 1, and write it."""
        factors, clock = self.factors, time.perf_counter()
        factor = factors[number - 1]
        prepared = self._prepare(factor)
        self._last = None  # its factorisation takes as much memory as the next one
        try:
            self._last = self._solved(prepared, factor, dd.Watch(self.say, self._keep, told))
        except ConvergenceError as error:
            where = f"step {number} of {len(factors)}, load {factor:g}"
            raise ConvergenceError(f"{where}: {error}", error.history) from None
        self.rows.append(self._row(factor) | {"seconds": time.perf_counter() - clock})
        self.say(f"step {number} of {len(factors)}, load {factor:g}: {self._last.note} ({self._last.reason})")
        self._state, self._at = self._last.mechanical, factor
        self._data = self._last.part_data if isinstance(self._last, dd.AdaptiveResult) else ()
        if len(factors) > 1:
            self._write_step(number)
            write_standing(self.out, self.problem, Standing(self.rows, self._state, self._data), self.run)

    def _prepare(self, factor: float) -> dd.Prepared:
        """The method for this part of the load; what does not change with it is not made anew."""
        material, last = self.material, self._prepared
        if self._data:
            parts = [replace(part, dataset=own) for part, own in zip(material.each, self._data, strict=True)]
            material = in_parts(parts)
        projection = last.projection.at(factor) if isinstance(last, dd.PreparedData) else None
        self._prepared = self.method.prepare(self.problem.at(factor), material, projection=projection)
        return self._prepared

    def _solved(self, prepared: dd.Prepared, factor: float, watch: dd.Watch) -> dd.Solution:
        """From the last step on, if there was one that was loaded."""
        last = self._state
        if last is None or self._at == 0.0:
            return prepared.solve(watch=watch)
        if isinstance(prepared, PreparedLaw):
            return prepared.solve(last, watch, start_factor=self._at)
        if isinstance(self.method, dd.PointMethod):
            return prepared.solve(watch=watch)  # its answer is the better for the elastic start
        return prepared.solve(scaled_state(self.problem, last, factor / self._at), watch)

    def _keep(self, data: Dataset) -> None:
        comm = self.problem.operator.comm
        together(comm, lambda: write_dataset(self.out / "data.h5", data) if comm.rank == 0 else None)

    def _row(self, factor: float) -> dict[str, Any]:
        """What is kept of the step; collective."""
        found, domain = self.solution, self.problem.operator.domain
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
            with atomic_path(self.out / _SERIES) as temporary:
                temporary.write_text(json.dumps({"file-series-version": "1.0", "files": files}, indent=1) + "\n")
