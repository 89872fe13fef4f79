"""Methods that are given data: a datum is a point, or its tangent space."""

from __future__ import annotations

import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.estimated_tangents import estimate_tangents
from dd_macro.material.graded import GradedPoints, GradedTangents
from dd_macro.material.metric import Metric
from dd_macro.material.regional import search_in_regions
from dd_macro.material.search import MaterialSearch
from dd_macro.material.tangent_spaces import TangentSearch, TangentSpaces
from dd_macro.methods.method import SILENT, Material, Watch, with_iterations
from dd_macro.methods.metric_choice import choose_metric
from dd_macro.methods.points import DataDrivenResult, SolverOptions, solve
from dd_macro.methods.projection import MechanicalState, Projection
from dd_macro.methods.second_order import SecondOrderOptions, StepName, solve_second_order
from dd_macro.methods.second_order_steps import LocalTangentStep, StepRecord
from dd_macro.methods.theory import local_tangent_step, project
from dd_macro.scene.problem import Problem
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["DataMethod", "PointMethod", "PreparedData", "TangentMethod", "without_tangents"]

Array = NDArray[np.float64]
_ESTIMATE = 16


class DataMethod(ABC):
    """A method that looks data up; a new one says how it searches and solves, and what one plain iteration is."""

    order = 1
    """2 if tangents are asked, which answer every strain, silent or not."""
    averages = False
    """Whether a point has more than one datum."""
    theories: tuple[str, ...] = ("small", "finite")
    """Of strain, among dd_macro.THEORIES."""
    variant_of: str = ""
    """The method in the registry that it is another setting of; "" if none."""

    def given(self, dataset: Dataset) -> Dataset:
        """The data as this method gets them."""
        return dataset

    @abstractmethod
    def search(self, dataset: Dataset, metric: Metric) -> MaterialSearch:
        """The search for the data of this method.

        Raises:
            InputError: the data are not what it needs.
        """

    def graded(self, dataset: Dataset, metric: Metric, forces: Array) -> MaterialSearch:
        """The search in a tissue whose bar force is ``forces`` (n,) in N at the points.

        Raises:
            InputError: the data are not what it needs, or do not know their bar force.
        """
        gamma = float(np.sqrt(((dataset.strain @ metric.factor) ** 2).sum(axis=1).mean()))
        kind = GradedTangents if self.order == 2 and dataset.tangent is not None else GradedPoints
        if self.order == 2 and kind is GradedPoints:
            raise InputError("data: expected tangents in a tissue whose bar force varies, got none")
        return kind(dataset, metric, at=forces, gamma=gamma)

    @abstractmethod
    def solve(
        self, projection: Projection, search: MaterialSearch, start: MechanicalState | None = None
    ) -> DataDrivenResult:
        """Solve with a search of this method, from the elastic solution if ``start`` is None.

        Raises:
            ConvergenceError: the solve did not converge.
        """

    @abstractmethod
    def state_of(
        self, projection: Projection, search: MaterialSearch, index: NDArray[np.int64], z: MechanicalState
    ) -> MechanicalState:
        """The state that the data of these numbers (n,) lead to, found from ``z``.

        Raises:
            ConvergenceError: there is none.
        """

    def once(self, projection: Projection, search: MaterialSearch, z: MechanicalState) -> MechanicalState:
        """One plain iteration: the state that the data nearest to ``z`` lead to, no point of it held.

        Raises:
            ConvergenceError: there is none.
        """
        return self.state_of(projection, search, search.nearest(search.metric.whiten(z.strain, z.stress))[0], z)

    def prepare(self, problem: Problem, material: Material, *, projection: Projection | None = None) -> PreparedData:
        """Metric, projection and search; see dd_macro.Method."""
        clock = time.perf_counter()
        datasets, metric = [self.given(part.data()) for part in material.each], material.metric
        if isinstance(metric, str):
            metric = choose_metric(metric, problem, datasets[0], order=self.order)
        seconds = time.perf_counter() - clock
        projection = projection or project(problem, metric)
        searches = []
        for number, (part, dataset) in enumerate(zip(material.each, datasets, strict=True)):
            forces = part.bar_forces(problem, number)
            searches.append(self.search(dataset, metric) if forces is None else self.graded(dataset, metric, forces))
        return PreparedData(self, projection, search_in_regions(searches, problem.region_of_points), seconds)

    def tuned(self, *, max_iterations: int | None = None, over_relaxation: float | None = None) -> Self:
        """See dd_macro.Method; a method without such numbers refuses them."""
        for name, value in (("max_iterations", max_iterations), ("over_relaxation", over_relaxation)):
            if value is not None:
                raise InputError(f"{name}: expected none with this method, got {value}")
        return self


@dataclass(frozen=True, eq=False)
class PreparedData:
    """A method, the projection and the search that it works with."""

    method: DataMethod
    projection: Projection
    search: MaterialSearch
    seconds_metric: float = 0.0

    @property
    def problem(self) -> Problem:
        """What is solved."""
        return self.projection.problem

    @property
    def text(self) -> str:
        """Linear solver and metric."""
        return f"{self.projection.solver}; metric: {self.projection.metric.reason}"

    def solve(self, start: MechanicalState | None = None, watch: Watch = SILENT) -> DataDrivenResult:
        """The solution; see dd_macro.Prepared."""
        return self.method.solve(self.projection, self.search, start)


@dataclass(frozen=True)
class PointMethod(DataMethod):
    """A datum is a point (paper, Section 4.1); ``options`` have omega, 1 is the plain iteration.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))])
        >>> strain = np.random.default_rng(0).uniform(-0.02, 0.02, (500, 6))
        >>> C = dd.isotropic(young=1e3, poisson=0.3).C
        >>> data = tsg.Dataset(strain, strain @ C, "first_piola", path=np.zeros(500, int), step=np.arange(500))
        >>> solution = dd.PointMethod().prepare(problem, dd.Material(data)).solve()
        >>> solution.converged
        True
    """

    options: SolverOptions = field(default_factory=lambda: SolverOptions(max_iterations=1000))
    """A metric that is far too stiff needs hundreds of iterations."""
    theories: tuple[str, ...] = ("small", "finite")
    variant_of: str = ""

    def search(self, dataset: Dataset, metric: Metric) -> MaterialSearch:
        """The nearest datum."""
        return MaterialSearch(dataset, metric)

    def solve(
        self, projection: Projection, search: MaterialSearch, start: MechanicalState | None = None
    ) -> DataDrivenResult:
        """The fixed-point iteration."""
        return solve(projection, search, start=start, options=self.options)

    def state_of(
        self, projection: Projection, search: MaterialSearch, index: NDArray[np.int64], z: MechanicalState
    ) -> MechanicalState:
        """The projection of the data."""
        return projection.project(search.dataset.strain[index], search.dataset.stress[index])

    def tuned(self, *, max_iterations: int | None = None, over_relaxation: float | None = None) -> Self:
        """See dd_macro.Method."""
        options = replace(
            self.options, over_relaxation=self.options.over_relaxation if over_relaxation is None else over_relaxation
        )
        return with_iterations(replace(self, options=options), max_iterations, None)


def without_tangents(dataset: Dataset) -> Dataset:
    """The data without their tangents, as measured ones are."""
    return replace(dataset, tangent=None)


def _as_they_are(dataset: Dataset) -> Dataset:
    return dataset


@dataclass(frozen=True)
class TangentMethod(DataMethod):
    """A datum is its tangent space, up to ``neighbours`` of them are averaged, at most a fifth of the data.

    ``data`` makes what the method gets of a data set; data without tangents get them from ``estimate`` neighbours.
    """

    step: StepName = "local-tangent"
    data: Callable[[Dataset], Dataset] = _as_they_are
    estimate: int = _ESTIMATE
    neighbours: int = 1
    options: SecondOrderOptions = field(default_factory=SecondOrderOptions)
    theories: tuple[str, ...] = ("small", "finite")
    variant_of: str = ""
    order = 2

    @property
    def averages(self) -> bool:  # type: ignore[override]
        """Whether a point has more than one datum."""
        return self.neighbours > 1

    def given(self, dataset: Dataset) -> Dataset:
        """The data as this method gets them."""
        return self.data(dataset)

    def search(self, dataset: Dataset, metric: Metric) -> TangentSearch:
        """The nearest data and their tangent spaces.

        Raises:
            InputError: less than four data without tangents.
        """
        n = len(np.unique(np.column_stack([dataset.strain, dataset.stress]), axis=0))
        if dataset.tangent is None:
            dataset = estimate_tangents(dataset, neighbours=min(len(dataset) - 1, _share(self.estimate, n)))
        return TangentSearch(dataset, metric, neighbours=min(self.neighbours, max(1, n // 5)))

    def solve(
        self, projection: Projection, search: MaterialSearch, start: MechanicalState | None = None
    ) -> DataDrivenResult:
        """The second-order iteration."""
        assert isinstance(search, TangentSearch)
        return solve_second_order(projection, search, method=self.step, start=start, options=self.options)

    def state_of(
        self, projection: Projection, search: MaterialSearch, index: NDArray[np.int64], z: MechanicalState
    ) -> MechanicalState:
        """The state in equilibrium on the tangent spaces of the data."""
        assert isinstance(search, TangentSearch)
        return _on_spaces(projection, search.of(index), z)

    def once(self, projection: Projection, search: MaterialSearch, z: MechanicalState) -> MechanicalState:
        """Equilibrium on the tangent spaces of the data nearest to ``z``, averages where these are asked."""
        assert isinstance(search, TangentSearch)
        return _on_spaces(projection, search.spaces(z.strain, z.stress), z)

    def tuned(self, *, max_iterations: int | None = None, over_relaxation: float | None = None) -> Self:
        """See dd_macro.Method."""
        return with_iterations(self, max_iterations, over_relaxation)


def _share(most: int, count: int) -> int:
    """A fifth of ``count``, but not less than 16 nor more than ``most``."""
    return min(most, max(_ESTIMATE, count // 5))


def _on_spaces(projection: Projection, spaces: TangentSpaces, z: MechanicalState) -> MechanicalState:
    """The state in equilibrium on these tangent spaces, found from ``z``.

    Raises:
        ConvergenceError: there is none.
    """
    return _step(projection)(z, spaces, changed=0, search=0.0, final=True)


@lru_cache(maxsize=1)
def _step(projection: Projection) -> LocalTangentStep:
    """The last one is kept: it takes longer to make than to use."""
    return local_tangent_step(StepRecord(projection, sys.maxsize, None))
