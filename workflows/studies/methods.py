"""The methods that studies hold against one another, out of dd_macro.METHODS, by the names that reports give them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

import dd_macro as dd
from dd_macro.methods.registry import data_methods
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.dataset import Dataset
from workflows.runs.adaptation import rve_of, source_for
from workflows.runs.scene import Scene

__all__ = ["Entry", "adaptive", "entries", "grid_methods", "named"]

_AVERAGES, _NOISY = "second order, averages", "second order, 2 % noise, averages"


def named(*names: str) -> dict[str, dd.DataMethod]:
    """Methods that are given data."""
    known = data_methods()
    return {name: known[name] for name in names}


def grid_methods() -> dict[str, dd.DataMethod]:
    """All methods that are given data, those that average with noise in them."""
    found = data_methods()
    averages = found.pop(_AVERAGES)
    assert isinstance(averages, dd.TangentMethod)
    return {**found, _NOISY: replace(averages, data=_noisy)}


def _noisy(dataset: Dataset, noise: float = 0.02) -> Dataset:
    """The data without their tangents, with scatter in every component that is not silent.

    Strains and stresses get normal noise of ``noise`` times the largest root mean square of their components.
    """
    rng = np.random.default_rng(len(dataset))

    def scatter(a: np.ndarray) -> np.ndarray:
        size = noise * np.sqrt((a**2).mean(axis=0).max())
        return np.asarray(a + size * dataset.counted * rng.standard_normal(a.shape))

    return replace(dataset, strain=scatter(dataset.strain), stress=scatter(dataset.stress), tangent=None)


@dataclass(frozen=True)
class Entry:
    """A way to solve a scene with given data, and the theories of strain with which it is on the frontier."""

    name: str
    method: str
    metric: str = "auto"
    theories: tuple[str, ...] = ("small",)

    def solve(self, scene: Scene, dataset: Dataset) -> dd.Solution:
        """The solution; all that it needs is made here.

        Raises:
            InputError: the data give no metric or law, or are too few for tangents to be estimated.
            ConvergenceError: the solve did not converge.
        """
        problem = scene.problem(MPI.COMM_SELF)
        return dd.METHODS[self.method].prepare(problem, dd.Material(dataset, self.metric)).solve()


_ENTRIES = (
    Entry("data-driven, metric tangent", "classical", "tangent"),
    Entry("data-driven, metric visited", "classical", "visited"),
    Entry("data-driven, metric secant", "classical", "secant"),
    Entry("second-order data", "second order", theories=("small", "finite")),
    Entry("second-order data, estimated tangents", "second order, estimated tangents"),
    Entry("linear elastic law", "linear elastic law"),
    Entry("polynomial energy law", "polynomial energy law"),
)
_OTHERWISE = ("adaptive", "FE2")
"""Those that are not given data."""


def entries() -> tuple[Entry, ...]:
    """All that solve a scene with given data, once each: variants of a method are left out."""
    known = {entry.method for entry in _ENTRIES} | set(_OTHERWISE)
    new = {name: one for name, one in dd.METHODS.items() if name not in known and not one.variant_of}
    return *_ENTRIES, *(Entry(name, name, theories=one.theories) for name, one in new.items())


def adaptive(
    problem: dd.Problem, scene: Scene, *, tissue: Tissue, budget: int, measure: str | None = None
) -> dd.AdaptiveResult:
    """From nothing: the scene decides at which strains its ``budget`` of RVEs of ``tissue`` is computed.

    ``measure`` is the stress of the solution, first Piola if None.

    Raises:
        ConvergenceError: the solve did not converge.
    """
    method = dd.AdaptiveMethod(dd.Adaptation(budget, tolerance=0.0))
    source = source_for(scene, rve_of(tissue, None), problem)
    return method.prepare(problem, dd.Material(source=source, measure=measure)).solve()
