"""Factorisations of one symmetric matrix behind one interface.

A matrix comes as the upper triangle in CSR form, its pattern fixed, its values changing. A factor solves for any
number of right-hand sides and counts its negative pivots, which by Sylvester's law are the negative eigenvalues:
the inertia tells a stable equilibrium from an unstable one.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import sys
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg
from numpy.typing import NDArray

from tsg_micro.data.errors import ConvergenceError, InputError

__all__ = ["BACKENDS", "Choice", "Factor", "SymmetricSolver", "choose_backend", "make_solver"]

Array = NDArray[np.float64]
Index = NDArray[np.int32]
_PAYS_FROM = {"pardiso": 200, "mumps": 1000}
"""Unknowns above which a backend beats SuperLU, measured on RVEs and sheets."""


@dataclass(frozen=True)
class Factor:
    """A factorised matrix: solves for (n,) or (n, k), and knows its inertia."""

    solve: Callable[[Array], Array]
    negative_pivots: int


class SymmetricSolver(Protocol):
    """Factorises matrices of one pattern."""

    def factorise(self, values: Array) -> Factor:
        """Factor of the matrix whose upper triangle has these values (nnz,); an earlier factor may become invalid."""
        ...


@dataclass(frozen=True)
class Choice:
    """A backend and why it was taken."""

    backend: str
    reason: str


class SuperLU:
    """SciPy's SuperLU with diagonal pivots, so that the signs of U's diagonal are the inertia."""

    def __init__(self, indptr: Index, indices: Index) -> None:
        n = len(indptr) - 1
        row = np.repeat(np.arange(n), np.diff(indptr))
        place = np.arange(len(indices))
        strict = row != indices
        full = sp.csc_array(
            (
                np.concatenate([place, place[strict]]) + 1.0,
                (np.concatenate([indices, row[strict]]), np.concatenate([row, indices[strict]])),
            ),
            shape=(n, n),
        )
        self._gather = full.data.astype(np.int64) - 1
        self._matrix = full

    def factorise(self, values: Array) -> Factor:
        matrix = self._matrix
        matrix.data = values[self._gather]
        try:
            lu = scipy.sparse.linalg.splu(
                matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            raise ConvergenceError(f"linear solver superlu: {error}") from None
        if not np.array_equal(lu.perm_r, lu.perm_c):  # a zero pivot made it leave the diagonal
            raise ConvergenceError("linear solver superlu: the matrix is singular to working precision")
        return Factor(lu.solve, int((lu.U.diagonal() < 0.0).sum()))


class Pardiso:
    """Intel MKL PARDISO through pypardiso, symmetric indefinite; the ordering is worked out once.

    What PARDISO keeps between calls is laid out for a number of threads, and it writes beyond it where another number
    calls: a matrix is analysed anew where the number has changed, and solved with that of its factorisation.
    """

    def __init__(self, indptr: Index, indices: Index) -> None:
        for library in sorted(Path(sys.prefix, "lib").glob("libmkl_rt.*")):  # else the import walks all of Python
            os.environ.setdefault("PYPARDISO_MKL_RT", str(library))
        from pypardiso import PyPardisoSolver

        n = len(indptr) - 1
        self._solver = PyPardisoSolver(mtype=-2)
        os.environ.setdefault("PYPARDISO_MKL_RT", self._solver.libmkl._name)  # else the next one walks all of Python
        iparm = self._solver.iparm
        iparm[0], iparm[1], iparm[9], iparm[20] = 1, 2, 13, 1  # own settings, METIS, pivot 1e-13, Bunch-Kaufman
        iparm[7] = 0  # refinement only where pivots were perturbed
        iparm[10], iparm[12] = 0, 0  # no scaling or matching: the pattern's ordering stays valid
        self._values, self._dummy = np.zeros(len(indices)), np.zeros((n, 1), order="F")
        self._threads = 0  # those of the analysis
        self._pattern = [part.astype(np.int32) + 1 for part in (indptr, indices)]
        self._pardiso = self._solver.libmkl["pardiso"]
        self._phase, self._columns, self._error = (ctypes.c_int32() for _ in range(3))
        one, kind, size, silent = (ctypes.byref(ctypes.c_int32(value)) for value in (1, self._solver.mtype, n, 0))
        values, row, column, pt, perm, own = (
            ctypes.c_void_p(array.ctypes.data)
            for array in (self._values, *self._pattern, self._solver.pt, self._solver.perm, iparm)
        )
        # made once: pypardiso makes them for every call, which takes as long as to solve for a small matrix
        first = (pt, one, one, kind, ctypes.byref(self._phase), size, values, row, column)
        self._arguments = (*first, perm, ctypes.byref(self._columns), own, silent)
        weakref.finalize(self, self._solver.free_memory, everything=True)

    def _call(self, phase: int, b: Array) -> Array:
        x = np.empty_like(b)
        self._phase.value, self._columns.value, self._error.value = phase, b.size // len(b), 0
        at = (ctypes.c_void_p(array.ctypes.data) for array in (b, x))
        self._pardiso(*self._arguments, *at, ctypes.byref(self._error))
        if self._error.value:
            raise ConvergenceError(f"linear solver pardiso: error {self._error.value}")
        return np.ascontiguousarray(x)

    def factorise(self, values: Array) -> Factor:
        self._values[:] = values
        threads = int(self._solver.libmkl.MKL_Get_Max_Threads())
        if self._threads not in (0, threads):
            self._solver.free_memory(everything=True)
            self._threads = 0
        self._call(22 if self._threads else 12, self._dummy)
        self._threads = threads
        return Factor(self._solve, int(self._solver.iparm[22]))

    def _solve(self, b: Array) -> Array:
        set_threads = self._solver.libmkl.MKL_Set_Num_Threads_Local
        before = set_threads(self._threads)
        try:
            return self._call(33, np.asfortranarray(b, dtype=float))
        finally:
            set_threads(before)


class Mumps:
    """MUMPS through petsc4py on this process alone; the ordering is worked out once."""

    def __init__(self, indptr: Index, indices: Index) -> None:
        if importlib.util.find_spec("dolfinx_solver"):  # the PyPI wheel that carries petsc4py must be entered first
            importlib.import_module("dolfinx_solver")
        from petsc4py import PETSc

        n = len(indptr) - 1
        self._csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType))
        self._matrix = PETSc.Mat().createSBAIJ((n, n), 1, csr=(*self._csr, np.ones(len(indices))), comm=PETSc.COMM_SELF)
        self._pc = PETSc.PC().create(PETSc.COMM_SELF)
        self._pc.setType("cholesky")
        self._pc.setFactorSolverType("mumps")
        self._pc.setOperators(self._matrix)
        self._pc.setFactorSetUpSolverType()
        self._pc.getFactorMatrix().setMumpsIcntl(7, 3)  # SCOTCH, three times faster here than the default
        self._pc.getFactorMatrix().setMumpsIcntl(13, 1)  # exact inertia
        self._pc.getFactorMatrix().setMumpsIcntl(24, 1)  # which counts null pivots too
        self._b, self._x = self._matrix.createVecs()

    def factorise(self, values: Array) -> Factor:
        from petsc4py import PETSc

        self._matrix.setValuesCSR(*self._csr, values)
        self._matrix.assemble()
        try:
            self._pc.setOperators(self._matrix)
            self._pc.setUp()
        except PETSc.Error as error:
            raise ConvergenceError(f"linear solver mumps: PETSc error {error.ierr}") from None
        if self._pc.getFactorMatrix().getMumpsInfog(1) < 0:
            code = self._pc.getFactorMatrix().getMumpsInfog(1)
            raise ConvergenceError(f"linear solver mumps: MUMPS error {code}")
        return Factor(self._solve, int(self._pc.getFactorMatrix().getInertia()[0]))

    def _solve(self, b: Array) -> Array:
        columns = b.reshape(len(b), -1)
        out = np.empty_like(columns)
        for k in range(columns.shape[1]):
            self._b.array[:] = columns[:, k]
            self._pc.apply(self._b, self._x)
            out[:, k] = self._x.array
        return out.reshape(b.shape)


BACKENDS: dict[str, Callable[[Index, Index], Any]] = {
    "superlu": SuperLU,
    "pardiso": Pardiso,
    "mumps": Mumps,
}


def _installed(backend: str) -> bool:
    """Whether ``backend`` can be used here."""
    if backend == "pardiso":
        return importlib.util.find_spec("pypardiso") is not None
    if backend == "mumps":
        return any(importlib.util.find_spec(name) is not None for name in ("dolfinx_solver", "petsc4py"))
    return True


def choose_backend(size: int, wanted: str = "auto") -> Choice:
    """The backend for a matrix of ``size`` unknowns: ``wanted``, or by size and by what is installed.

    Raises:
        InputError: ``wanted`` is unknown or not installed.
    """
    if wanted != "auto":
        if wanted not in BACKENDS:
            raise InputError(f"linear solver: expected auto or one of {', '.join(BACKENDS)}, got {wanted!r}")
        if not _installed(wanted):
            raise InputError(f"linear solver: {wanted} is not installed (pip install 'tsgdd[all]')")
        return Choice(wanted, "asked for")
    for backend, least in _PAYS_FROM.items():
        if size > least and _installed(backend):
            return Choice(backend, f"{size} unknowns, the fastest installed for more than {least}")
    if size > max(_PAYS_FROM.values()):
        return Choice("superlu", f"{size} unknowns, neither pypardiso nor petsc4py is installed")
    return Choice("superlu", f"{size} unknowns, the fastest installed for so few")


def make_solver(indptr: Index, indices: Index, backend: str) -> SymmetricSolver:
    """A solver of that backend for matrices whose upper triangle has this CSR pattern."""
    solver: SymmetricSolver = BACKENDS[backend](indptr, indices)
    return solver
