"""Closest-point projection onto the states that are compatible and in equilibrium (paper, Section 4.1).

    (sum w B^T C B) u   = sum w B^T C epsilon*,        u as prescribed
    (sum w B^T C B) eta = f - sum w B^T sigma*,        eta = 0 where u is prescribed
    epsilon = B u,   sigma = sigma* + C B eta
One matrix, factorised once, serves both, at once.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.metric import Metric
from dd_macro.parallel import total
from dd_macro.scene.boundary import Displacement
from dd_macro.scene.linear import LinearSolver
from dd_macro.scene.loads import Load
from dd_macro.scene.problem import Problem
from dd_macro.scene.spaces import StrainOperator

__all__ = ["MechanicalState", "Projection", "relative_distance"]

Array = NDArray[np.float64]
_LEAST = 1e-5
"""A strain whose stress is the least that out-of-balance forces relate to: 1e-10 of it is round-off of the modulus."""


@dataclass(frozen=True)
class MechanicalState:
    """A state that is compatible and in equilibrium; the part this rank owns.

    u (3 * nodes,) in m; eta (3 * nodes,) in m, the multiplier of equilibrium; strain (n, 6) and stress (n, 6) in Pa
    at the quadrature points, Mandel.
    """

    u: Array
    eta: Array
    strain: Array
    stress: Array

    @property
    def nominal_stress(self) -> Array:
        """The stress of the equations, (n, 6) in Pa."""
        return self.stress


class Projection:
    """The assembled and factorised projection of one problem; :meth:`Projection.of` makes it of a Problem.

    The linear solver is that of :class:`dd_macro.scene.linear.LinearSolver`, its PETSc options have the prefix ``dd_``;
    ``solver`` says what is used.

    Args:
        operator: mesh, space and strain operator.
        metric: the C of the metric.
        conditions: prescribed displacements; they must leave no rigid-body motion free.
        tractions: loads; f of the equations.

    Raises:
        InputError: bad conditions or tractions.
        ConvergenceError: the factorisation fails.
    """

    def __init__(
        self,
        operator: StrainOperator,
        metric: Metric,
        conditions: Sequence[Displacement],
        tractions: Sequence[Load] = (),
    ) -> None:
        self._factorise(Problem(operator, conditions, tractions), metric)

    @classmethod
    def of(cls, problem: Problem, metric: Metric) -> Self:
        """The projection of ``problem`` in ``metric``.

        Raises:
            ConvergenceError: the factorisation fails.
        """
        projection = cls.__new__(cls)
        projection._factorise(problem, metric)
        return projection

    def _factorise(self, problem: Problem, metric: Metric) -> None:
        operator = problem.operator
        self.problem, self.operator, self.metric = problem, operator, metric
        self._prescribed_strain = operator.strain(problem.prescribed)
        self._modulus = operator.modulus(metric.C)
        areas = float(total(operator.comm, (operator.weights ** (4 / 3)).sum()))
        self._least = _LEAST * float(np.abs(metric.C).max()) * float(np.sqrt(areas))
        self.solver = self._linear.name

    @cached_property
    def _linear(self) -> LinearSolver:
        """Matrix and factorisation; they take most of the memory."""
        return LinearSolver(self.problem, self.operator.stiffness(self.metric.C), prefix="dd_")

    def give(self) -> LinearSolver | None:
        """The solver, for near matrices to go on with; it is made anew where it is needed here again."""
        solver: LinearSolver | None = self.__dict__.pop("_linear", None)
        return solver

    def at(self, factor: float) -> Self:
        """The same with another part of the whole load; no new factorisation."""
        scaled = copy.copy(self)
        scaled.problem = self.problem.at(factor)
        scaled._prescribed_strain = self.operator.strain(scaled.problem.prescribed)
        return scaled

    def project(self, strain: Array, stress: Array) -> MechanicalState:
        """Mechanical state closest to the material state strain (n, 6), stress (n, 6) in Pa.

        Raises:
            ConvergenceError: the linear solver fails.
        """
        op, C = self.operator, self.metric.C
        compatibility = op.force((strain - self._prescribed_strain) @ C)
        found, eta = self._linear.solve_both(compatibility, self.problem.forces - op.force(stress))
        u = self.problem.prescribed + found
        return MechanicalState(u, eta, op.strain(u), stress + op.strain(eta) @ C)

    def elastic(self) -> MechanicalState:
        """Solution of linear elasticity, sigma = C epsilon; the start of the iteration.

        Raises:
            ConvergenceError: the linear solver fails.
        """
        op, C = self.operator, self._modulus
        u = self.problem.prescribed + self._linear.solve(self.problem.forces - op.force(self._prescribed_strain @ C))
        strain = op.strain(u)
        return MechanicalState(u, np.zeros_like(u), strain, strain @ C)

    def residual(self, stress: Array, u: Array | None = None) -> float:
        """:meth:`dd_macro.Problem.residual` of the stress of the equations, and the unknowns u."""
        return self.problem.residual(stress, u, floor=self._least)

    def reaction(self, z: MechanicalState, side: str) -> Array:
        """Force (3,) in N that the supports of ``side`` exert on the body.

        Raises:
            InputError: no such side.
        """
        return self.problem.support_force(side, self.problem.out_of_balance(z.nominal_stress, z.u))


class State(Protocol):
    """Strain (n, 6) and stress (n, 6) in Pa at the quadrature points."""

    @property
    def strain(self) -> Array:
        """Mandel strain."""

    @property
    def stress(self) -> Array:
        """Mandel stress, Pa."""


def relative_distance(operator: StrainOperator, metric: Metric, a: State, b: State) -> float:
    """|a - b| / |b| of two states in the metric; collective."""
    off, size = metric.squares(a.strain - b.strain, a.stress - b.stress), metric.squares(b.strain, b.stress)
    sums = total(operator.comm, [operator.weights @ off, operator.weights @ size])
    return float(np.sqrt(sums[0] / sums[1]))
