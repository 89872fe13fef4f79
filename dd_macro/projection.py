"""Closest-point projection onto the states that are compatible and in equilibrium (paper, Section 4.1).

    (sum w B^T C B) u   = sum w B^T C epsilon*,        u as prescribed
    (sum w B^T C B) eta = f - sum w B^T sigma*,        eta = 0 where u is prescribed
    epsilon = B u,   sigma = sigma* + C B eta
One matrix, factorised once, serves both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dd_macro.boundary import Displacement, Traction, nodal_forces, prescribed_displacement, side_dofs
from dd_macro.metric import Metric
from dd_macro.parallel import total
from dd_macro.spaces import StrainOperator, stiffness_matrix
from tsg_micro.errors import ConvergenceError

__all__ = ["DIRECT_BELOW", "MechanicalState", "Projection"]

Array = NDArray[np.float64]

DIRECT_BELOW = 200_000
"""Number of unknowns up to which the default solver is a factorisation."""


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


class Projection:
    """The assembled and factorised projection of one scene.

    Small problems are solved with a Cholesky factorisation (MUMPS where PETSc has it), large ones with CG and
    GAMG on the rigid-body near-nullspace; PETSc options with the prefix ``dd_`` override all of it.
    ``solver`` says what is used.

    Args:
        operator: mesh, space and strain operator.
        metric: the C of the metric.
        conditions: prescribed displacements; they must leave no rigid-body motion free.
        tractions: dead tractions; f of the equations.

    Raises:
        InputError: bad conditions or tractions.
        ConvergenceError: the factorisation fails.
    """

    def __init__(
        self,
        operator: StrainOperator,
        metric: Metric,
        conditions: Sequence[Displacement],
        tractions: Sequence[Traction] = (),
    ) -> None:
        self.operator, self.metric = operator, metric
        self.fixed, self.prescribed = prescribed_displacement(operator, conditions)
        self.loads = nodal_forces(operator, tractions)
        self._prescribed_strain = operator.strain(self.prescribed)
        K = stiffness_matrix(operator, metric.C)
        first = K.getOwnershipRange()[0]
        rows = (np.flatnonzero(self.fixed) + first).astype(PETSc.IntType)
        K.zeroRowsColumns(rows, diag=K.getDiagonal().sum() / K.getSize()[0])
        K.setOption(PETSc.Mat.Option.SPD, True)
        self.matrix = K
        self._x, self._b = K.createVecs()
        self._attach_rigid_modes()
        self._ksp = self._make_solver()
        ksp, pc = self._ksp, self._ksp.getPC()
        factor = pc.getFactorSolverType() if pc.getType() in ("cholesky", "lu") else None
        self.solver = f"{ksp.getType()} + {pc.getType()}" + (f" ({factor})" if factor else "")

    def project(self, strain: Array, stress: Array) -> MechanicalState:
        """Mechanical state closest to the material state strain (n, 6), stress (n, 6) in Pa.

        Raises:
            ConvergenceError: the linear solver fails.
        """
        op, C = self.operator, self.metric.C
        u = self.prescribed + self._solve(op.force((strain - self._prescribed_strain) @ C))
        eta = self._solve(self.loads - op.force(stress))
        return MechanicalState(u, eta, op.strain(u), stress + op.strain(eta) @ C)

    def elastic(self) -> MechanicalState:
        """Solution of linear elasticity, sigma = C epsilon; the start of the iteration.

        Raises:
            ConvergenceError: the linear solver fails.
        """
        op, C = self.operator, self.metric.C
        u = self.prescribed + self._solve(self.loads - op.force(self._prescribed_strain @ C))
        strain = op.strain(u)
        return MechanicalState(u, np.zeros_like(u), strain, strain @ C)

    def residual(self, stress: Array) -> float:
        """Norm of the out-of-balance force on the free components, relative to that of all nodal forces."""
        force = self.operator.force(stress)
        out = np.where(self.fixed, 0.0, force - self.loads)
        squares = total(self.operator.comm, [out @ out, force @ force + self.loads @ self.loads])
        return float(np.sqrt(squares[0] / squares[1])) if squares[1] > 0 else 0.0

    def reaction(self, stress: Array, side: str) -> Array:
        """Force (3,) in N that the supports of ``side`` exert on the body.

        Raises:
            InputError: no such side.
        """
        nodes = side_dofs(self.operator, side)
        force = (self.operator.force(stress) - self.loads).reshape(-1, 3)
        return total(self.operator.comm, force[nodes].sum(axis=0))

    def _solve(self, right_side: Array) -> Array:
        self._b.array[:] = np.where(self.fixed, 0.0, right_side)
        try:
            self._ksp.solve(self._b, self._x)
        except PETSc.Error:
            reason = self._ksp.getConvergedReason()
            raise ConvergenceError(
                f"linear solver {self.solver}: stopped after {self._ksp.getIterationNumber()} iterations, "
                f"PETSc reason {reason}"
            ) from None
        return np.where(self.fixed, 0.0, self._x.array)

    def _attach_rigid_modes(self) -> None:
        x = self.matrix.createVecLeft()
        x.setBlockSize(3)
        x.array[:] = self.operator.node_coordinates().reshape(-1)
        self.matrix.setNearNullSpace(PETSc.NullSpace().createRigidBody(x))

    def _make_solver(self) -> PETSc.KSP:
        ksp = PETSc.KSP().create(self.operator.comm)
        ksp.setOptionsPrefix("dd_")
        ksp.setOperators(self.matrix)
        ksp.setErrorIfNotConverged(True)
        ksp.setTolerances(rtol=1e-10, max_it=1000)  # of an iterative solver, ours or one asked for by options
        pc = ksp.getPC()
        package = next((name for name in ("mumps", "superlu_dist") if PETSc.Sys.hasExternalPackage(name)), None)
        if self.operator.global_dofs <= DIRECT_BELOW and (package or self.operator.comm.size == 1):
            ksp.setType("preonly")
            pc.setType("lu" if package == "superlu_dist" else "cholesky")
            pc.setFactorSolverType(package or "petsc")
        else:
            ksp.setType("cg")
            pc.setType("gamg")
        ksp.setFromOptions()
        try:
            ksp.setUp()
        except PETSc.Error as error:
            raise ConvergenceError(f"linear solver {ksp.getType()} + {pc.getType()}: set-up failed ({error})") from None
        return ksp
