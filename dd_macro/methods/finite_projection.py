"""The data-driven problem in finite strain, in (F, P): equilibrium of P and compatibility of F stay linear.

Data are pairs of stretch U_i and Biot stress T_i (dd_macro.scene.kinematics). A point with the rotation R of its
F = R U stands at (R U_i, R P_i), so data are looked up in U and turned back with R:
    (sum w B^T C B) u   = sum w B^T C sym(R U_i - I),     u as prescribed
    (sum w B^T C B) eta = f - sum w B^T R P_i,            eta = 0 where u is prescribed
    F = I + grad u,   P = R P_i + C sym(grad eta)
The matrix is that of small strain, factorised once. R is the rotation of the result: a few more solves for u find it,
since a wrong R changes sym(R U_i) by its product with the strain alone. The metric is not turned with the body, so
rotations should stay well below a radian; the second-order solve has no such limit.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro.methods.projection import MechanicalState, Projection
from dd_macro.methods.solution import Solution
from dd_macro.scene.kinematics import FiniteStrain, Kinematics, second_piola
from dd_macro.scene.problem import Problem
from tsg_micro.data.dataset import Dataset, convert_dataset
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import from_mandel, to_mandel
from tsg_micro.data.stress import convert_stress

__all__ = ["FiniteProjection", "FiniteState", "biot_dataset", "in_space", "scaled_state", "state_on"]

Array = NDArray[np.float64]
_TURNS, _SETTLED = 100, 1e-9


@dataclass(frozen=True)
class FiniteState(MechanicalState):
    """``strain`` is the Biot strain, ``stress`` the Biot stress; F and first Piola stress P in Pa are (n, 3, 3).

    ``nominal`` is the stress of the equations, P (n, 9), or (n, 15) where the strain is enhanced.
    """

    F: Array
    first_piola: Array
    nominal: Array

    @property
    def nominal_stress(self) -> Array:
        """The stress of the equations in Pa."""
        return self.nominal


class FiniteProjection(Projection):
    """The projection of one scene in finite strain; ``operator`` is a dd_macro.GradientOperator."""

    _rotation: Array | None = None

    def project(self, strain: Array, stress: Array) -> FiniteState:
        """State in equilibrium closest to data of Biot strain (n, 6) and Biot stress (n, 6) in Pa, turned as it is.

        Raises:
            ConvergenceError: the linear solver fails, the rotations do not settle, or a point is inside out.
        """
        op, C = self.operator, self._modulus
        U = np.eye(3) + from_mandel(strain)
        R = np.broadcast_to(np.eye(3), U.shape) if self._rotation is None else self._rotation
        for _ in range(_TURNS):
            gap = (R @ U - np.eye(3)).reshape(-1, 9) - self._prescribed_strain[:, :9]
            u = self.problem.prescribed + self._linear.solve(op.force(gap @ C[:9]))
            found = self._kinematics(op.strain(u))
            turned = op.comm.allreduce(float(np.abs(found.R - R).max(initial=0.0)), MPI.MAX)
            R = found.R
            if turned <= _SETTLED:
                break
        else:
            raise ConvergenceError(
                f"finite strain: expected rotations to settle within {_TURNS} solves, the last turned by {turned:.3g}"
            )
        self._rotation = R
        data = found.turned(U, stress)
        eta = self._linear.solve(self.problem.forces_at(u) - op.force(data))
        return _state(u, eta, found, data + op.strain(eta) @ C)

    def elastic(self) -> FiniteState:
        """Solution of linear elasticity, and T = C (U - I) where it leads; the start of the iteration.

        Raises:
            ConvergenceError: the linear solver fails, or a point is inside out.
        """
        u = super().elastic().u
        found = self._kinematics(self.operator.strain(u))
        self._rotation = found.R
        return _state(u, np.zeros_like(u), found, found.nominal_stress(found.strain @ self.metric.C))

    def _kinematics(self, gradient: Array) -> FiniteStrain:
        found = self.operator.local(gradient)
        assert isinstance(found, FiniteStrain)
        if self.operator.comm.allreduce(found.inside_out, MPI.LOR):
            raise ConvergenceError("finite strain: expected det F > 0 at every quadrature point, got less")
        return found


def _state(u: Array, eta: Array, found: FiniteStrain, nominal: Array) -> FiniteState:
    P = found.first_piola(nominal)
    return FiniteState(u, eta, found.strain, found.material_stress(nominal), found.deformation, P, nominal)


def state_on(u: Array, found: Kinematics, stress: Array) -> MechanicalState:
    """The state of nodal u (3 * nodes,) with the material's stress (n, 6) in Pa; eta is zero."""
    if isinstance(found, FiniteStrain):
        return _state(u, np.zeros_like(u), found, found.nominal_stress(stress))
    return MechanicalState(u, np.zeros_like(u), found.strain, stress)


def scaled_state(problem: Problem, z: MechanicalState, ratio: float) -> MechanicalState:
    """The state whose displacement and stress are ``ratio`` times those of ``z``: a start under another load."""
    operator, u = problem.operator, ratio * z.u
    return state_on(u, operator.local(operator.strain(u)), ratio * z.stress)


def in_space[S: Solution](result: S, measure: str = "first_piola") -> S:
    """``result`` with strain sym(F - I) and the stress ``measure``, both states turned to where the body is.

    Strains (n, 6) and stresses (n, 6) in Pa stay Mandel vectors. The stresses are those of the members: what clamps
    carry is added. A result in small strain is turned by nothing.

    Raises:
        InputError: no such measure.
    """
    z, support = result.mechanical, result.support
    if not isinstance(z, FiniteState):
        if support is None:
            return result
        shown = dataclasses.replace(z, stress=z.stress + support)
        return dataclasses.replace(
            result, mechanical=shown, material_stress=result.material_stress + support, support=None
        )
    R = FiniteStrain((z.F - np.eye(3)).reshape(-1, 9)).R
    U = np.eye(3) + from_mandel(result.material_strain)
    F = R @ U
    P, of_body = F @ second_piola(U, result.material_stress), z.first_piola
    if support is not None:
        P, of_body = (stress + R @ from_mandel(support) for stress in (P, of_body))
    shown = MechanicalState(
        z.u, z.eta, to_mandel(z.F - np.eye(3)), convert_stress(to_mandel(of_body), z.F, "first_piola", measure)
    )
    return dataclasses.replace(
        result,
        mechanical=shown,
        material_strain=to_mandel(F - np.eye(3)),
        material_stress=convert_stress(to_mandel(P), F, "first_piola", measure),
        support=None,
    )


def biot_dataset(dataset: Dataset) -> Dataset:
    """The data as pairs of Biot strain and Biot stress; for a symmetric F these are strain and first Piola stress.

    Raises:
        InputError: the deformation gradients are missing and needed.
    """
    F = dataset.deformation_gradient
    if F is None and dataset.stress_measure != "first_piola":
        raise InputError(
            "data set: expected deformation gradients, or the first Piola stress of symmetric ones, in finite strain, "
            f"got the {dataset.stress_measure} stress alone"
        )
    if F is None or np.allclose(F, F.swapaxes(1, 2), rtol=0, atol=1e-12):
        return convert_dataset(dataset, "first_piola")
    found = FiniteStrain((F - np.eye(3)).reshape(-1, 9))
    tau = from_mandel(convert_dataset(dataset, "kirchhoff").stress)
    biot = found.material_stress((tau @ np.linalg.inv(F).swapaxes(1, 2)).reshape(-1, 9))
    return dataclasses.replace(
        dataset,
        strain=found.strain,
        stress=biot,
        stress_measure="first_piola",
        tangent=None,
        deformation_gradient=found.U,
    )
