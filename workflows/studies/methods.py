"""Ways to solve a scene with material data, which studies hold against one another."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

import dd_macro as dd
from dd_macro.material.tangent_spaces import TangentSpaces
from dd_macro.methods.second_order import Method as Step
from dd_macro.methods.second_order_steps import LocalTangentStep, Record
from dd_macro.methods.theory import local_tangent_step
from tsg_micro.data.dataset import Dataset

__all__ = ["CLASSICAL", "PLAIN", "SECOND_ORDER", "Classical", "SecondOrder", "Way", "on_spaces"]

_ESTIMATE, _ESTIMATE_NOISY, _AVERAGE = 16, 100, 40
"""Neighbours from which a tangent is estimated, with noise too, and those that are averaged at a point."""
_PATIENT = 1000
"""A metric that is far too stiff needs hundreds of iterations."""


@dataclass(frozen=True)
class Classical:
    """A datum is a point; queries are over-relaxed by omega = ``over_relaxation``, 1 is the plain iteration."""

    over_relaxation: float = 1.7
    order = 1

    def data(self, dataset: Dataset) -> Dataset:
        """The data as this method gets them."""
        return dataset

    def search(self, dataset: Dataset, metric: dd.Metric) -> dd.MaterialSearch:
        """The search for the data of this method."""
        return dd.MaterialSearch(dataset, metric)

    def solve(
        self, projection: dd.Projection, search: dd.MaterialSearch, start: dd.MechanicalState | None = None
    ) -> dd.DataDrivenResult:
        """Solve, from the elastic solution if ``start`` is None.

        Raises:
            ConvergenceError: the solve did not converge.
        """
        options = dd.SolverOptions(max_iterations=_PATIENT, over_relaxation=self.over_relaxation)
        return dd.solve(projection, search, start=start, options=options)

    def once(self, projection: dd.Projection, search: dd.MaterialSearch, z: dd.MechanicalState) -> dd.MechanicalState:
        """One plain iteration: the projection of the data nearest to ``z``."""
        index, _ = search.nearest(search.metric.whiten(z.strain, z.stress))
        return projection.project(search.dataset.strain[index], search.dataset.stress[index])


def _as_they_are(dataset: Dataset) -> Dataset:
    return dataset


@dataclass(frozen=True)
class SecondOrder:
    """A datum is its tangent space, up to ``neighbours`` of them are averaged, at most a fifth of the data.

    ``data`` makes what the method gets of a data set; data without tangents get them from ``estimate`` neighbours.
    """

    step: Step = "local-tangent"
    data: Callable[[Dataset], Dataset] = _as_they_are
    estimate: int = _ESTIMATE
    neighbours: int = 1
    order = 2

    def search(self, dataset: Dataset, metric: dd.Metric) -> dd.TangentSearch:
        """The search for the data of this method.

        Raises:
            InputError: less than four data without tangents.
        """
        n = len(np.unique(np.column_stack([dataset.strain, dataset.stress]), axis=0))
        if dataset.tangent is None:
            dataset = dd.estimate_tangents(dataset, neighbours=min(len(dataset) - 1, _share(self.estimate, n)))
        return dd.TangentSearch(dataset, metric, neighbours=min(self.neighbours, max(1, n // 5)))

    def solve(
        self, projection: dd.Projection, search: dd.MaterialSearch, start: dd.MechanicalState | None = None
    ) -> dd.DataDrivenResult:
        """As :meth:`Classical.solve`; ``search`` is of this method."""
        assert isinstance(search, dd.TangentSearch)
        return dd.solve_second_order(projection, search, method=self.step, start=start)

    def once(self, projection: dd.Projection, search: dd.MaterialSearch, z: dd.MechanicalState) -> dd.MechanicalState:
        """One plain iteration: equilibrium on the tangent spaces of the data nearest to ``z``, none of them held.

        Raises:
            ConvergenceError: there is none.
        """
        assert isinstance(search, dd.TangentSearch)
        return on_spaces(projection, search.spaces(z.strain, z.stress), z)


Way = Classical | SecondOrder


def _share(most: int, count: int) -> int:
    """A fifth of ``count``, but not less than 16 nor more than ``most``."""
    return min(most, max(_ESTIMATE, count // 5))


def on_spaces(projection: dd.Projection, spaces: TangentSpaces, z: dd.MechanicalState) -> dd.MechanicalState:
    """The state in equilibrium on these tangent spaces, found from ``z``.

    Raises:
        ConvergenceError: there is none.
    """
    return _step(projection)(z, spaces, changed=0, search=0.0, final=True)


@lru_cache(maxsize=1)
def _step(projection: dd.Projection) -> LocalTangentStep:
    """The last one is kept: it takes longer to make than to use."""
    return local_tangent_step(Record(projection, sys.maxsize, None))


def _measured(dataset: Dataset) -> Dataset:
    """The data without their tangents."""
    return replace(dataset, tangent=None)


def _noisy(dataset: Dataset, noise: float = 0.02) -> Dataset:
    """The data without their tangents, with scatter in every component that is not silent.

    Strains and stresses get normal noise of ``noise`` times the largest root mean square of their components.
    """
    rng = np.random.default_rng(len(dataset))

    def scatter(a: np.ndarray) -> np.ndarray:
        size = noise * np.sqrt((a**2).mean(axis=0).max())
        return np.asarray(a + size * dataset.counted * rng.standard_normal(a.shape))

    return replace(dataset, strain=scatter(dataset.strain), stress=scatter(dataset.stress), tangent=None)


CLASSICAL: dict[str, Way] = {"classical": Classical()}
PLAIN: dict[str, Way] = {"classical, omega 1": Classical(1.0)}
SECOND_ORDER: dict[str, Way] = {
    "second order": SecondOrder(),
    "second order, alternating": SecondOrder("alternating"),
    "second order, estimated tangents": SecondOrder(data=_measured),
    "second order, 2 % noise, averages": SecondOrder(data=_noisy, estimate=_ESTIMATE_NOISY, neighbours=_AVERAGE),
}
