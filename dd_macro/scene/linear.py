"""Linear systems K x = b of a scene: x = 0 where the displacement is prescribed, one solver for many right-hand sides.

Systems whose factor fits the memory and is made in a minute or two are factorised (MUMPS where PETSc has it), others
solved by CG with GAMG on the rigid-body near-nullspace. PETSc options with the solver's prefix override all of it.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dd_macro.parallel import span, total
from dd_macro.scene.problem import Problem
from dd_macro.scene.rigid import SHIFT, HeldMean
from dd_macro.scene.spaces import Stiffness, StrainOperator
from tsg_micro.data.errors import ConvergenceError
from tsg_micro.data.memory import available_memory

__all__ = ["LinearSolver", "factor_memory"]

Array = NDArray[np.float64]

_ENTRY, _SHARE = 12.0, 0.7
"""Bytes of an entry of a factor, with what MUMPS works with; part of the memory that one may take."""
_CLOSE, _MOST_OLD, _MANY = 1e-10, 30, 15
"""Conjugate gradients with an older factorisation: residual, iterations at most, and at which a new one is due."""
_MOST_WORK = 5e11
"""Squares of the entries of a row of the factor, summed: a minute, or two. Blocks of 240,000 unknowns have as many."""
_RESIDUAL, _ROUND_OFF = 1e-6, 1e-13
"""Of the right side, and of K x; Euclidean norms."""


class LinearSolver:
    """The solver of one stiffness, whose values may change.

    Args:
        problem: mesh, space, what is prescribed, and the rigid motions that are held in the mean.
        stiffness: with an assembled matrix, in which rows and columns of prescribed components are replaced.
        prefix: of its PETSc options.
        definite: K is positive definite, so Cholesky will do; if not, a factorisation is LDL^T (MUMPS).
        older: the solver of a near matrix of the same problem, whose factorisation serves first, as in :meth:`update`;
            it solves no more itself.

    Raises:
        ConvergenceError: the factorisation fails.
    """

    def __init__(
        self,
        problem: Problem,
        stiffness: Stiffness,
        *,
        prefix: str,
        definite: bool = True,
        older: LinearSolver | None = None,
    ) -> None:
        K = self.matrix = stiffness.matrix
        self._comm = problem.operator.comm
        operator, fixed = problem.operator, problem.fixed
        self._stiffness, self._fixed = stiffness, fixed[: 3 * operator.owned_nodes]
        self._motions = problem.motions
        self._mean: HeldMean | None = None
        self._rows = (np.flatnonzero(fixed) + K.getOwnershipRange()[0]).astype(PETSc.IntType)
        self._kind = PETSc.Mat.Option.SPD if definite else PETSc.Mat.Option.SYMMETRIC
        self._x, self._b = K.createVecs()
        self._r = self._b.duplicate()
        self._pair: tuple[PETSc.Mat, ...] | None = None
        self._old, self._many, self._gradients = False, False, PETSc.KSP().create(operator.comm)
        x = K.createVecLeft()
        x.setBlockSize(3)
        x.array[:] = operator.node_coordinates().reshape(-1)
        K.setNearNullSpace(PETSc.NullSpace().createRigidBody(x))
        self._ksp = _make_solver(operator, K, prefix, direct=older is not None and older._direct)
        self._factor: PETSc.PC | None = None if older is None else older._factor
        self._gradients.setType("cg")
        self._gradients.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self._gradients.setTolerances(rtol=_CLOSE, max_it=_MOST_OLD)
        if not definite and _counts_pivots(self._ksp.getPC()):
            self._ksp.getPC().setFactorSetUpSolverType()
            self._ksp.getPC().getFactorMatrix().setMumpsIcntl(13, 1)  # count the pivots of the root front too
        self.update(keep=True)

    @property
    def name(self) -> str:
        """What is used."""
        ksp, pc = self._ksp, self._ksp.getPC()
        factor = pc.getFactorSolverType() if pc.getType() in ("cholesky", "lu") else None
        return f"{ksp.getType()} + {pc.getType()}" + (f" ({factor})" if factor else "")

    def update(self, *, keep: bool = False) -> None:
        """Take over the values that K was newly assembled with.

        With ``keep`` a factorisation of earlier values stays, as long as conjugate gradients find solutions with it in
        a few iterations; one that is not positive definite does not.

        Raises:
            ConvergenceError: the factorisation fails.
        """
        older = self._factor if keep and self._direct and not self._many and not len(self._motions) else None
        self._old = older is not None and not self.negative_pivots
        pc = self._ksp.getPC() if older is None or not self._old else older
        K, ksp = self.matrix, self._ksp
        mean = abs(K.getDiagonal()).sum() / K.getSize()[0]
        K.zeroRowsColumns(self._rows, diag=mean)
        if len(self._motions):
            K.shift(SHIFT * mean)
        K.setOption(self._kind, True)  # new values have made PETSc forget it
        self._gradients.setPC(pc)
        self._factor, self._many = (pc if self._direct else None), False
        pc.setReusePreconditioner(self._old)
        (self._gradients if self._old else ksp).setOperators(K)
        try:
            if not self._old:
                ksp.setUp()  # or PETSc would put the factorisation off to the next solve
        except PETSc.Error as error:
            raise ConvergenceError(
                f"linear solver {ksp.getType()} + {ksp.getPC().getType()}: set-up failed ({error})"
            ) from None
        if len(self._motions):
            self._mean = HeldMean(
                self._comm, self._motions, solve=self._solved, product=self._product, shift=SHIFT * mean
            )

    def solve(self, right_side: Array, *, within: float = _CLOSE) -> Array:
        """The unknowns for the forces ``right_side`` on them, whose prescribed components do not count.

        With a factorisation of earlier values (:meth:`update`) they are right to a residual of ``within`` of it.

        Raises:
            ConvergenceError: the solver fails, or its solution does not solve the system.
        """
        nodal = np.where(self._fixed, 0.0, self._stiffness.condense(right_side))
        x = self._close(nodal, within) if self._old else None
        if x is None:
            x = self._solved(nodal) if self._mean is None else self._mean.solve(nodal)
        return self._stiffness.expand(np.where(self._fixed, 0.0, x), right_side)

    def _close(self, b: Array, within: float) -> Array | None:
        """K^-1 b by conjugate gradients with an older factorisation; None, and a new one, where that fails."""
        self._b.array[:] = b
        self._gradients.setTolerances(rtol=min(max(within, _CLOSE), 0.1))
        self._gradients.solve(self._b, self._x)
        if self._gradients.getConvergedReason() > 0:
            self._many |= self._gradients.getIterationNumber() > _MANY
            return np.array(self._x.array)
        self.update()
        return None

    def _solved(self, b: Array) -> Array:
        """K^-1 b (3 * nodes,)."""
        self._b.array[:] = b
        try:
            self._ksp.solve(self._b, self._x)
        except PETSc.Error:
            raise self._stopped() from None
        self._check_residual()
        return np.array(self._x.array)

    def _product(self, x: Array) -> Array:
        """K x (3 * nodes,)."""
        self._x.array[:] = x
        self.matrix.mult(self._x, self._r)
        return np.array(self._r.array)

    def solve_both(self, one: Array, other: Array) -> tuple[Array, Array]:
        """As :meth:`solve`, for two right sides; a factorisation takes both at once.

        Raises:
            ConvergenceError: see there.
        """
        if self._mean is not None or self._old or not self._direct:
            return self.solve(one), self.solve(other)
        sides = [np.where(self._fixed, 0.0, self._stiffness.condense(side)) for side in (one, other)]
        if self._pair is None:
            sizes = (self._b.getSizes(), (PETSc.DECIDE, 2))
            self._pair = tuple(PETSc.Mat().createDense(sizes, comm=self._b.comm) for _ in range(2))
        B, X = self._pair
        B.getDenseArray()[:] = np.column_stack(sides)
        B.assemble()
        try:
            self._ksp.matSolve(B, X)
        except PETSc.Error:
            raise self._stopped() from None
        found = []
        for side, x, b in zip((one, other), X.getDenseArray().T, sides, strict=True):
            self._x.array[:], self._b.array[:] = x, b
            self._check_residual()
            found.append(self._stiffness.expand(np.where(self._fixed, 0.0, x), side))
        return found[0], found[1]

    def _stopped(self) -> ConvergenceError:
        return ConvergenceError(
            f"linear solver {self.name}: stopped after {self._ksp.getIterationNumber()} iterations, "
            f"PETSc reason {self._ksp.getConvergedReason()}"
        )

    def _check_residual(self) -> None:
        """Raise ConvergenceError, on all ranks, where K x is not b: options may ask for what solves nothing."""
        K, r = self.matrix, self._r
        K.mult(self._x, r)
        r.axpy(-1.0, self._b)
        off, size = r.norm(), self._b.norm()
        # a factorisation of a badly conditioned K is right to round-off of K x
        if off <= _RESIDUAL * size or off <= _ROUND_OFF * K.norm(PETSc.NormType.INFINITY) * self._x.norm():
            return
        raise ConvergenceError(
            f"linear solver {self.name}: expected a residual below {_RESIDUAL:.0e} of the right side, got "
            f"{off / size if size else off:.1e}; do the options in PETSC_OPTIONS ask for it?"
        )

    @property
    def negative_pivots(self) -> int | None:
        """Negative eigenvalues of K, where the factorisation counts them (MUMPS, LDL^T); None otherwise."""
        pc = self._factor
        if pc is None or not _counts_pivots(pc):
            return None
        return self._stiffness.negative + int(pc.getFactorMatrix().getMumpsInfog(12))

    @property
    def _direct(self) -> bool:
        return self._ksp.getType() == "preonly" and self._ksp.getPC().getType() in ("cholesky", "lu")


def _counts_pivots(pc: PETSc.PC) -> bool:
    return bool(pc.getType() == "cholesky" and pc.getFactorSolverType() == "mumps")


def factor_memory(operator: StrainOperator) -> float:
    """Bytes that the factor of a stiffness takes, estimated; collective.

    Nested dissection of a sheet of N unknowns, t nodes thick, leaves 11.5 sqrt(t) log2 N entries an unknown, that of a
    block 21 N^(1/3) (METIS, sheets and blocks of 2000 to 175,000 unknowns: it had 3 to 44 % less).
    """
    comm, x, N = operator.comm, operator.node_coordinates(), operator.global_dofs
    low, high = span(comm, x)
    spacing = (float(total(comm, operator.weights.sum())) / (N / 3)) ** (1 / 3)
    thick = 1.0 + (high - low).min() / spacing
    return _ENTRY * N * min(21.0 * N ** (1 / 3), 11.5 * np.sqrt(thick) * np.log2(N))


def _pays(operator: StrainOperator) -> bool:
    """Whether the factor fits the memory that is there, and its making the time that iterations take; collective."""
    here = available_memory()
    there = operator.comm.allreduce(np.inf if here is None else here, MPI.MIN)
    memory = factor_memory(operator)
    work = (memory / _ENTRY) ** 2 / operator.global_dofs
    return bool(memory <= _SHARE * there and work <= _MOST_WORK)


def _make_solver(operator: StrainOperator, K: PETSc.Mat, prefix: str, *, direct: bool) -> PETSc.KSP:
    """By factorisation where it pays, or where it is known to (``direct``)."""
    ksp = PETSc.KSP().create(operator.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(K)
    ksp.setErrorIfNotConverged(True)
    ksp.setTolerances(rtol=1e-10, max_it=1000)  # of an iterative solver, ours or one asked for by options
    pc = ksp.getPC()
    package = next((name for name in ("mumps", "superlu_dist") if PETSc.Sys.hasExternalPackage(name)), None)
    if (direct or _pays(operator)) and (package or operator.comm.size == 1):
        ksp.setType("preonly")
        pc.setType("lu" if package == "superlu_dist" else "cholesky")
        pc.setFactorSolverType(package or "petsc")
    else:
        ksp.setType("cg")
        pc.setType("gamg")
    ksp.setFromOptions()
    return ksp
