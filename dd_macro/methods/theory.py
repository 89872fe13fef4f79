"""Small and finite strain, each with all that it decides: spaces, projection, step on tangent spaces, form of the data.

An operator names its theory; nothing else asks which one it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from dd_macro.material.metric import Metric
from dd_macro.methods.finite_projection import FiniteProjection, biot_dataset
from dd_macro.methods.projection import Projection
from dd_macro.methods.second_order_steps import FiniteTangentStep, LocalTangentStep, StepRecord
from dd_macro.scene.boundary import Displacement
from dd_macro.scene.enhanced import EnhancedGradientOperator, EnhancedStrainOperator
from dd_macro.scene.loads import Load
from dd_macro.scene.mesh import TaggedMesh
from dd_macro.scene.problem import Problem
from dd_macro.scene.spaces import GradientOperator, StrainOperator
from tsg_micro.data.dataset import Dataset, convert_dataset

__all__ = ["THEORIES", "Theory", "local_tangent_step", "make_projection", "project", "theory_of"]


class Theory(Protocol):
    """How displacements strain the material. ``linear``: equilibrium on tangent spaces is a linear problem."""

    linear: bool

    def operator(self, domain: TaggedMesh, *, degree: int = 1, enhanced: bool = False) -> StrainOperator:
        """B and W of the mesh; elements of degree 1 are trilinear, or ``enhanced``.

        Raises:
            InputError: enhanced elements of another degree, or no such degree.
        """

    def projection(self, problem: Problem, metric: Metric) -> Projection:
        """The factorised projection onto the constraint set."""

    def tangent_step(self, record: StepRecord) -> LocalTangentStep:
        """Equilibrium on tangent spaces."""

    def dataset(self, dataset: Dataset, measure: str | None) -> Dataset:
        """The data as they are solved with, where a user asks for the stress ``measure``."""

    def solved(self, measure: str | None) -> str | None:
        """The stress to solve in, None where it is that of the data."""

    def shown(self, dataset: Dataset, measure: str | None) -> str:
        """The stress to write, of a solution with these data."""


class _Small:
    """Stress and strain of the equations are those of the material, in whatever measure the data have."""

    linear = True

    def operator(self, domain: TaggedMesh, *, degree: int = 1, enhanced: bool = False) -> StrainOperator:
        return EnhancedStrainOperator(domain, degree=degree) if enhanced else StrainOperator(domain, degree=degree)

    def projection(self, problem: Problem, metric: Metric) -> Projection:
        return Projection.of(problem, metric)

    def tangent_step(self, record: StepRecord) -> LocalTangentStep:
        return LocalTangentStep(record)

    def dataset(self, dataset: Dataset, measure: str | None) -> Dataset:
        return convert_dataset(dataset, measure or dataset.stress_measure)

    def solved(self, measure: str | None) -> str | None:
        return measure

    def shown(self, dataset: Dataset, measure: str | None) -> str:
        return dataset.stress_measure


class _Finite:
    """Biot strain and Biot stress at the points, turned with the body; any stress can be written."""

    linear = False

    def operator(self, domain: TaggedMesh, *, degree: int = 1, enhanced: bool = False) -> StrainOperator:
        return EnhancedGradientOperator(domain, degree=degree) if enhanced else GradientOperator(domain, degree=degree)

    def projection(self, problem: Problem, metric: Metric) -> Projection:
        return FiniteProjection.of(problem, metric)

    def tangent_step(self, record: StepRecord) -> LocalTangentStep:
        return FiniteTangentStep(record)

    def dataset(self, dataset: Dataset, measure: str | None) -> Dataset:
        return biot_dataset(dataset)

    def solved(self, measure: str | None) -> str | None:
        return "first_piola"

    def shown(self, dataset: Dataset, measure: str | None) -> str:
        return measure or dataset.stress_measure


THEORIES: dict[str, Theory] = {"small": _Small(), "finite": _Finite()}


def theory_of(operator: StrainOperator) -> Theory:
    """The theory of strain that ``operator`` is of."""
    return THEORIES[operator.theory]


def project(problem: Problem, metric: Metric) -> Projection:
    """The projection of a problem in ``metric``, in the theory of its operator.

    Raises:
        ConvergenceError: the factorisation fails.
    """
    return theory_of(problem.operator).projection(problem, metric)


def make_projection(
    operator: StrainOperator,
    metric: Metric,
    conditions: Sequence[Displacement],
    tractions: Sequence[Load] = (),
) -> Projection:
    """The projection of a scene, in finite strain if ``operator`` is that of gradients.

    Raises:
        InputError: bad conditions or tractions.
        ConvergenceError: the factorisation fails.
    """
    return project(Problem(operator, conditions, tractions), metric)


def local_tangent_step(record: StepRecord) -> LocalTangentStep:
    """The step with local tangents in the theory of the record's scene."""
    return theory_of(record.projection.operator).tangent_step(record)
