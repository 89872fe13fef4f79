"""Ways to solve a scene with material data, which studies hold against one another."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

import dd_macro as dd
from dd_macro.second_order import Method as Step
from dd_macro.second_order_steps import FiniteTangentStep, LocalTangentStep, Record
from dd_macro.tangent_search import TangentSpaces
from tsg_micro.dataset import Dataset
from workflows.scene import with_tangents

__all__ = ["CLASSICAL", "PLAIN", "SECOND_ORDER", "Classical", "SecondOrder", "estimated", "noisy", "on_spaces"]

_ESTIMATE, _ESTIMATE_NOISY, _AVERAGE = 16, 100, 40
"""Neighbours from which a tangent is estimated, with noise too, and those that are averaged at a point."""
_PATIENT = 1000
"""A metric that is far too stiff needs hundreds of iterations."""


@dataclass(frozen=True)
class Classical:
    """A datum is a point; queries are over-relaxed by omega = ``over_relaxation``, 1 is the plain iteration."""

    over_relaxation: float = 1.7

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


@dataclass(frozen=True)
class SecondOrder:
    """A datum is its tangent space, which ``prepare`` gives the data; up to ``neighbours`` of them are averaged.

    At most a fifth of the data are.
    """

    step: Step = "local-tangent"
    prepare: Callable[[Dataset], Dataset] = with_tangents
    neighbours: int = 1

    def search(self, dataset: Dataset, metric: dd.Metric) -> dd.TangentSearch:
        """The search for the data of this method.

        Raises:
            InputError: too few data for tangents to be estimated.
        """
        different = len(np.unique(np.column_stack([dataset.strain, dataset.stress]), axis=0))
        return dd.TangentSearch(self.prepare(dataset), metric, neighbours=min(self.neighbours, max(1, different // 5)))

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


def on_spaces(projection: dd.Projection, spaces: TangentSpaces, z: dd.MechanicalState) -> dd.MechanicalState:
    """The state in equilibrium on these tangent spaces, found from ``z``.

    Raises:
        ConvergenceError: there is none.
    """
    return _step(projection)(z, spaces, changed=0, search=0.0, final=True)


@lru_cache(maxsize=1)
def _step(projection: dd.Projection) -> LocalTangentStep:
    """The last one is kept: it takes longer to make than to use."""
    record = Record(projection, sys.maxsize, None)
    if isinstance(projection, dd.FiniteProjection):
        return FiniteTangentStep(record, projection)
    return LocalTangentStep(record)


def estimated(dataset: Dataset, neighbours: int = _ESTIMATE) -> Dataset:
    """The data with tangents estimated from their neighbours, whether they have tangents or not.

    Raises:
        InputError: less than four data.
    """
    return dd.estimate_tangents(dataset, neighbours=min(neighbours, len(dataset) - 1))


def noisy(dataset: Dataset, noise: float = 0.02) -> Dataset:
    """The data with scatter in every component, and tangents estimated from a fifth of those, at most 100.

    Strains and stresses get normal noise of ``noise`` times the largest root mean square of their components.

    Raises:
        InputError: less than four data.
    """
    rng = np.random.default_rng(len(dataset))

    def scatter(a: np.ndarray) -> np.ndarray:
        return np.asarray(a + noise * np.sqrt((a**2).mean(axis=0).max()) * rng.standard_normal(a.shape))

    measured = replace(dataset, strain=scatter(dataset.strain), stress=scatter(dataset.stress))
    return estimated(measured, min(_ESTIMATE_NOISY, max(_ESTIMATE, len(dataset) // 5)))


CLASSICAL: dict[str, Classical | SecondOrder] = {"classical": Classical()}
PLAIN: dict[str, Classical | SecondOrder] = {"classical, omega 1": Classical(1.0)}
SECOND_ORDER: dict[str, Classical | SecondOrder] = {
    "second order": SecondOrder(),
    "second order, alternating": SecondOrder("alternating"),
    "second order, estimated tangents": SecondOrder(prepare=estimated),
    "second order, 2 % noise, averages": SecondOrder(prepare=noisy, neighbours=_AVERAGE),
}
