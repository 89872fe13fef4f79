"""What a method is: prepared for a problem and a material, it solves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.laws import Law
from dd_macro.material.metric import Metric
from dd_macro.material.source import Source
from dd_macro.methods.projection import MechanicalState, Projection
from dd_macro.methods.solution import Solution
from dd_macro.scene.problem import Problem
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["SILENT", "Material", "Method", "Prepared", "Watch", "with_iterations"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Material:
    """What answers a strain; a method takes of it what it needs.

    ``metric`` is one of dd_macro.METRICS, or a metric. ``measure`` is the stress to solve in where data are computed,
    that of ``dataset``, or first Piola, if None.

    Example:
        >>> rve = tsg.RVESpec.of_kind("bulk", tsg.Tissue(bar_force=1e-8))
        >>> dd.Material(source=tsg.RVESource(rve)).dataset is None  # data are computed where they are needed
        True
    """

    dataset: Dataset | None = None
    metric: Metric | str = "auto"
    law: Law | None = None
    source: Source | None = None
    measure: str | None = None
    bar_force: Array | None = None
    """f_b (cells,) in N of every cell this rank owns, in a tissue where it varies from cell to cell."""
    parts: tuple[Material, ...] = ()
    """One for each region of the problem, in their order, where it has regions."""

    @property
    def each(self) -> tuple[Material, ...]:
        """The parts, or the material itself where there is one only."""
        return self.parts or (self,)

    def bar_forces(self, problem: Problem, part: int) -> Array | None:
        """f_b (n,) in N at the points of the region ``part`` of ``problem``; None where it is one."""
        if self.bar_force is None:
            return None
        return np.repeat(self.bar_force, problem.operator.points_per_cell)[problem.region_of_points == part]

    def data(self) -> Dataset:
        """The data set.

        Raises:
            InputError: there is none.
        """
        if self.dataset is None:
            raise InputError("material: expected a data set, got none")
        return self.dataset


@dataclass(frozen=True)
class Watch:
    """Who is told how a solve goes: a line at a time, the data so far of a method that adds to them, and the part of
    the work that is done, in [0, 1], as far as it is known.
    """

    say: Callable[[str], None] = lambda text: None
    keep: Callable[[Dataset], None] = lambda dataset: None
    done: Callable[[float], None] = lambda part: None


SILENT = Watch()


class Prepared(Protocol):
    """All that is made once: metric, factorised matrix, search tree, fitted law.

    ``text`` says what was chosen, "" where nothing was; ``seconds_metric`` the choice of the metric took.
    """

    @property
    def problem(self) -> Problem:
        """What is solved."""

    @property
    def text(self) -> str:
        """Linear solver and metric."""

    @property
    def seconds_metric(self) -> float:
        """Time, s."""

    def solve(self, start: MechanicalState | None = None, watch: Watch = SILENT) -> Solution:
        """The solution, from the state ``start`` on where the method takes one; collective.

        Raises:
            ConvergenceError: the method did not converge; it has the history.
        """


class Method(Protocol):
    """A way to solve a problem; dd_macro.METHODS has them by name."""

    @property
    def theories(self) -> tuple[str, ...]:
        """The theories of strain (dd_macro.THEORIES) that it can do."""

    @property
    def variant_of(self) -> str:
        """The name of a method with the same solutions, or of one that it is for other data; "" if there is none."""

    def prepare(self, problem: Problem, material: Material, *, projection: Projection | None = None) -> Prepared:
        """The method for this problem and material; collective.

        ``projection`` is that of the problem in the metric of the material, if it is there already.

        Raises:
            InputError: the material is not what the method needs.
            ConvergenceError: a factorisation failed.
        """

    def tuned(self, *, max_iterations: int | None = None, over_relaxation: float | None = None) -> Self:
        """The method with these numbers; None leaves what it has.

        Raises:
            InputError: a number is out of range, or the method has no such number.
        """


def with_iterations[M: Any](method: M, max_iterations: int | None, over_relaxation: float | None) -> M:
    """:meth:`Method.tuned` of a method whose ``options`` have a number of iterations, and no omega.

    Raises:
        InputError: the number is out of range, or there is an omega.
    """
    if over_relaxation is not None:
        raise InputError(
            f"over_relaxation: expected none but with data as points (order 1), which it is for, got {over_relaxation}"
        )
    if max_iterations is None:
        return method
    return replace(method, options=replace(method.options, max_iterations=max_iterations))
