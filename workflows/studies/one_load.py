"""What the studies of one load share: their inputs, and data-driven solves measured against the full tensegrity."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import dd_macro as dd
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError
from workflows.runs.loads import LOADS, check_load
from workflows.runs.scene import Scene, read_material
from workflows.runs.tensegrity import check_same_scene, solution_errors
from workflows.store.record import read_summary
from workflows.store.stages import Stages
from workflows.studies.methods import named
from workflows.studies.prerequisites import Chain

__all__ = ["COLUMNS", "Bench", "Inputs", "Row", "Study", "make_bench"]

Row = dict[str, float]

COLUMNS = (
    *("error_mech", "error_mat", "error_mech_all", "error_mat_all", "distance", "distance_all"),
    *("iterations", "seconds", "seconds_search", "seconds_linear_solves"),
)
"""Names of a row; errors and distances are relative, without ``_all`` the outer blocks are left out."""


@dataclass(frozen=True)
class Inputs:
    """What a study of one load starts from."""

    stages: Stages
    dns: Path
    """Folder of the full tensegrity."""
    data: Path
    """File of the material data."""
    dataset: Dataset
    scene: Scene


@dataclass(frozen=True)
class Study:
    """A study of one load, its results in ``out``.

    ``dns`` is a folder of ``tsgdd dns`` and ``data`` a file of ``tsgdd sample``; what is None is a stage of ``stages``,
    which are in ``out`` if None.

    Raises:
        InputError: on construction, where the load or the strain is not valid, or beyond the data to be sampled.
    """

    out: Path
    load: str
    chain: Chain
    dns: Path | None = None
    data: Path | None = None
    stages: Stages | None = None
    say: Callable[[str], None] = lambda text: None

    def __post_init__(self) -> None:
        check_load(self.load, self.chain.strain)
        if self.data is None:
            self.chain.check_reach(self.load)

    def prepare(self) -> Inputs:
        """Run what is not there, read what is.

        Raises:
            InputError: a folder or file is not what it should be, or of another load, strain or bar force.
            ConvergenceError: a solver did not converge.
        """
        chain, load = self.chain, self.load
        scene = chain.scene(load)
        dataset = (
            None if self.data is None else self._read(self.data, scene)
        )  # what is given comes first: it may be bad
        if self.dns is not None:
            self._check_reference(self.dns)
        stages = self.stages or Stages(self.out, self.say)
        dns = self.dns or chain.dns(stages, load, self.say)
        data = self.data or chain.data(stages, load)
        return Inputs(stages, dns, data, dataset or self._read(data, scene), scene)

    def _read(self, data: Path, scene: Scene) -> Dataset:
        dataset = read_material(data, scene)
        sampled = dataset.parameters.get("load")
        if sampled in LOADS and sampled != self.load:
            raise InputError(f"data: expected data for {self.load}, those in {data} were sampled for {sampled}")
        self.chain.check_bar_force(dataset, data)
        return dataset

    def _check_reference(self, dns: Path) -> None:
        chain = self.chain
        scene = {"load": self.load, "strain": chain.strain, **chain.tissue.as_dict()}
        check_same_scene(scene, dns, "the study")
        blocks = tuple(read_summary(dns, "dns")["parameters"].get("blocks", ()))
        if blocks != tuple(chain.blocks):
            raise InputError(f"blocks: expected those of the run in {dns}, {blocks}, got {tuple(chain.blocks)}")

    def parameters(self, found: Inputs) -> dict[str, object]:
        """For the summary."""
        return {"load": self.load, **self.chain.parameters(), "dns": found.dns, "data": found.data}


@dataclass(frozen=True)
class Bench:
    """What solves share: mesh, metric, factorised projection, and the tensegrity's block means as reference."""

    projection: dd.Projection
    blocks: Dataset
    symbol: str
    """p or q, whose error counts."""

    def solve(self, dataset: Dataset, start: dd.MechanicalState | None = None) -> tuple[Row, dd.MechanicalState]:
        """Errors, iterations and times of one classical solve, and its mechanical state.

        Raises:
            InputError: the grid of the blocks or a stress measure does not fit.
            ConvergenceError: the solve did not converge.
        """
        begin = time.perf_counter()
        metric, (method,) = self.projection.metric, named("classical").values()
        result = method.solve(self.projection, method.search(dataset, metric), start)
        seconds = time.perf_counter() - begin
        shown = dd.in_space(result, self.blocks.stress_measure)
        row = solution_errors(shown, self.blocks).row(self.symbol)
        row["iterations"] = result.iterations
        row["seconds"] = seconds
        row["seconds_search"] = sum(i.seconds_search for i in result.history)
        row["seconds_linear_solves"] = sum(i.seconds_solve for i in result.history)
        return row, result.mechanical


def make_bench(scene: Scene, metric: dd.Metric | str, dataset: Dataset, blocks: Dataset, *, order: int = 1) -> Bench:
    """The scene in this process, with a metric of its own or made from ``dataset`` by name for solves of ``order``.

    Raises:
        InputError: no such metric, or the data give none.
    """
    problem = scene.problem(MPI.COMM_SELF)
    if isinstance(metric, str):
        metric = dd.choose_metric(metric, problem, dataset, order=order)
    return Bench(dd.project(problem, metric), blocks, LOADS[scene.load].symbol)
