"""Data-driven solves of one scene, each measured against the full tensegrity."""

from __future__ import annotations

import time
from dataclasses import dataclass

from mpi4py import MPI

import dd_macro as dd
from tsg_micro.dataset import Dataset
from workflows.loads import SYMBOLS
from workflows.reference import solution_errors
from workflows.scene import Scene, make_metric

__all__ = ["Bench", "Row", "make_bench"]

Row = dict[str, float]


@dataclass(frozen=True)
class Bench:
    """What solves share: mesh, metric, factorised projection, and the tensegrity's block means as reference."""

    operator: dd.StrainOperator
    conditions: list[dd.Displacement]
    projection: dd.Projection
    blocks: Dataset
    symbol: str
    """p or q, whose error counts."""

    def solve(self, dataset: Dataset, start: dd.MechanicalState | None = None) -> tuple[Row, dd.MechanicalState]:
        """Errors, iterations and times of one solve, and its mechanical state.

        Raises:
            InputError: the grid of the blocks or a stress measure does not fit.
            ConvergenceError: the solve did not converge.
        """
        begin = time.perf_counter()
        metric = self.projection.metric
        result = dd.solve(self.projection, dd.MaterialSearch(dataset, metric), start=start)
        seconds = time.perf_counter() - begin
        row = solution_errors(self.operator, metric, result, self.blocks).row(self.symbol)
        row["iterations"] = result.iterations
        row["seconds"] = seconds
        row["seconds_search"] = sum(i.seconds_search for i in result.history)
        row["seconds_linear_solves"] = sum(i.seconds_solve for i in result.history)
        return row, result.mechanical


def make_bench(scene: Scene, metric: dd.Metric | str, dataset: Dataset, blocks: Dataset) -> Bench:
    """The scene in this process, with a metric of its own or made from ``dataset`` by name.

    Raises:
        InputError: no such metric, or the data give none.
    """
    domain = scene.build(MPI.COMM_SELF)
    operator, conditions = dd.StrainOperator(domain), scene.conditions(domain)
    if isinstance(metric, str):
        metric = make_metric(metric, operator, dataset, conditions)
    projection = dd.Projection(operator, metric, conditions)
    return Bench(operator, conditions, projection, blocks, SYMBOLS[scene.load])
