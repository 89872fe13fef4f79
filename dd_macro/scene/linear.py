"""Linear systems K x = b of a scene: x = 0 where the displacement is prescribed, one solver for many right-hand sides.

Systems whose factor fits the memory and has few entries a row, as that of a sheet, are factorised (MUMPS where PETSc
has it), others solved by CG with GAMG on the rigid-body near-nullspace; where that fails, as it may where K is not
positive definite, they are factorised if they can be. PETSc options with the solver's prefix override all of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dd_macro.scene.factor_size import factor_entries, factor_fits
from dd_macro.scene.petsc_solver import counts_pivots, make_solver, option
from dd_macro.scene.problem import Problem
from dd_macro.scene.rigid import SHIFT, HeldMean
from dd_macro.scene.spaces import Stiffness
from tsg_micro.data.errors import ConvergenceError

__all__ = ["LinearSolver"]

Array = NDArray[np.float64]

_CLOSE, _MOST_OLD, _MANY = 1e-10, 30, 15
"""Conjugate gradients with an older factorisation: residual, iterations at most, and at which a new one is due."""
_SLOWER = 1.5
"""Iterations for a digit, over those with values of its own, at which GAMG is set up anew."""
_MOST_ENTRIES = 800.0
"""Of a row of the factor: making it costs their square a row, in a block of 55,000 unknowns what the iterations of GAMG
cost. Sheets one element thick have half as many at a million unknowns, and GAMG needs more iterations there."""
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
            it solves no more itself. One that iterates has nothing to give.

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
        PETSc.garbage_cleanup(operator.comm)  # on several ranks factors that nobody has any more stay until then
        self.stiffness, self._fixed = stiffness, fixed[: 3 * operator.owned_nodes]
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
        fits = factor_fits(operator)
        direct = (older is not None and older.direct) or (fits and factor_entries(operator) <= _MOST_ENTRIES)
        self._ksp = make_solver(K, prefix, direct=direct, pivots=not definite)
        self._closest, self._kept, self._digit = self._ksp.getTolerances()[0], False, np.inf
        self._may_factorise = fits and not direct and self._ksp.getPC().getType() == "gamg"
        self._factor: PETSc.PC | None = None if older is None else older._factor
        self._gradients.setType("cg")
        self._gradients.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self._gradients.setTolerances(rtol=_CLOSE, max_it=_MOST_OLD)
        self.update(keep=True)

    @property
    def name(self) -> str:
        """What is used."""
        ksp, pc = self._ksp, self._ksp.getPC()
        factor = pc.getFactorSolverType() if pc.getType() in ("cholesky", "lu") else None
        return f"{ksp.getType()} + {pc.getType()}" + (f" ({factor})" if factor else "")

    def update(self, *, keep: bool = False) -> None:
        """Take over the values that K was newly assembled with.

        With ``keep`` a factorisation of earlier values, or the levels of GAMG, stay, as long as conjugate gradients
        find solutions with them in a few iterations; a factorisation that is not positive definite does not.

        Raises:
            ConvergenceError: the factorisation fails.
        """
        keeps = keep and not self._many and not len(self._motions)
        older = self._factor if keeps and self.direct else None
        self._old = older is not None and not self.negative_pivots
        self._kept = keeps and not self.direct and self._digit < np.inf
        pc = self._ksp.getPC() if older is None or not self._old else older
        K = self.matrix
        mean = abs(K.getDiagonal()).sum() / K.getSize()[0]
        K.zeroRowsColumns(self._rows, diag=mean)
        if len(self._motions):
            K.shift(SHIFT * mean)
        K.setOption(self._kind, True)  # new values have made PETSc forget it
        self._gradients.setPC(pc)
        self._factor, self._many = (pc if self.direct else None), False
        pc.setReusePreconditioner(self._old or self._kept)
        if self._old:
            self._gradients.setOperators(K)
        else:
            self._set_up()
        if len(self._motions):
            self._mean = HeldMean(
                self._comm, self._motions, solve=self._solved, product=self._product, shift=SHIFT * mean
            )

    def _set_up(self) -> None:
        """The factorisation, or what else the solver needs; PETSc would put it off to the next solve.

        Nothing is kept for making the matrix products of GAMG anew: it is twice what the levels are.
        """
        ksp = self._ksp
        ksp.setOperators(self.matrix)
        self._digit = self._digit if self._kept else np.inf
        try:
            with option("", "mat_product_clear", True):
                ksp.setUp()
        except PETSc.Error as error:
            raise ConvergenceError(
                f"linear solver {ksp.getType()} + {ksp.getPC().getType()}: set-up failed ({error})"
            ) from None

    def solve(self, right_side: Array, *, within: float = _CLOSE) -> Array:
        """The unknowns for the forces ``right_side`` on them, whose prescribed components do not count.

        By iterations, also with a factorisation of earlier values (:meth:`update`), they are right to a residual of
        ``within`` of it.

        Raises:
            ConvergenceError: the solver fails, or its solution does not solve the system.
        """
        nodal = np.where(self._fixed, 0.0, self.stiffness.condense(right_side))
        x = self._close(nodal, within) if self._old else None
        if x is None:
            x = self._solved(nodal, within) if self._mean is None else self._mean.solve(nodal)
        return self.stiffness.expand(np.where(self._fixed, 0.0, x), right_side)

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

    def _solved(self, b: Array, within: float = _CLOSE) -> Array:
        """K^-1 b (3 * nodes,)."""
        asked = min(max(within, self._closest), 0.1)
        self._ksp.setTolerances(rtol=asked)
        self._b.array[:] = b
        try:
            self._ksp.solve(self._b, self._x)
        except PETSc.Error:
            raise self._stopped() from None
        if self._ksp.getConvergedReason() < 0:
            if not self._kept and not self._may_factorise:
                raise self._stopped()
            if self._kept:
                self._kept = False
                self._ksp.getPC().setReusePreconditioner(False)
                self._set_up()
                return self._solved(b, within)
            self._may_factorise = False
            pivots = self._kind == PETSc.Mat.Option.SYMMETRIC
            self._ksp = make_solver(self.matrix, self._ksp.getOptionsPrefix(), direct=True, pivots=pivots)
            self._factor = self._ksp.getPC()
            self._set_up()
            return self._solved(b)
        if not self.direct:
            digit = self._ksp.getIterationNumber() / np.log10(1.0 / asked)
            self._many |= digit > _SLOWER * self._digit
            self._digit = min(self._digit, digit)
        self._check_residual(_RESIDUAL if self.direct else max(_RESIDUAL, within))
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
        if self._mean is not None or self._old or not self.direct:
            return self.solve(one), self.solve(other)
        sides = [np.where(self._fixed, 0.0, self.stiffness.condense(side)) for side in (one, other)]
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
            found.append(self.stiffness.expand(np.where(self._fixed, 0.0, x), side))
        return found[0], found[1]

    def _stopped(self) -> ConvergenceError:
        return ConvergenceError(
            f"linear solver {self.name}: stopped after {self._ksp.getIterationNumber()} iterations, "
            f"PETSc reason {self._ksp.getConvergedReason()}"
        )

    def _check_residual(self, most: float = _RESIDUAL) -> None:
        """Raise ConvergenceError, on all ranks, where K x is not b: options may ask for what solves nothing."""
        K, r = self.matrix, self._r
        K.mult(self._x, r)
        r.axpy(-1.0, self._b)
        off, size = r.norm(), self._b.norm()
        # a factorisation of a badly conditioned K is right to round-off of K x
        if off <= most * size or off <= _ROUND_OFF * K.norm(PETSc.NormType.INFINITY) * self._x.norm():
            return
        raise ConvergenceError(
            f"linear solver {self.name}: expected a residual below {most:.0e} of the right side, got "
            f"{off / size if size else off:.1e}; do the options in PETSC_OPTIONS ask for it?"
        )

    @property
    def negative_pivots(self) -> int | None:
        """Negative eigenvalues of K, where the factorisation counts them (MUMPS, LDL^T); None otherwise."""
        pc = self._factor
        if pc is None or not counts_pivots(pc):
            return None
        return self.stiffness.negative + int(pc.getFactorMatrix().getMumpsInfog(12))

    @property
    def direct(self) -> bool:
        """Whether it factorises, and does not iterate."""
        return self._ksp.getType() == "preonly" and self._ksp.getPC().getType() in ("cholesky", "lu")
