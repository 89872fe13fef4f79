"""PETSc's solver of a linear system as a scene needs it, factorised or iterated, and options that hold for a while."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from petsc4py import PETSc

__all__ = ["counts_pivots", "make_solver", "option"]

_WEAK = 0.05
"""Entries of K, relative to the diagonal, that GAMG does not count as a connection: half the iterations in sheets."""


@contextlib.contextmanager
def option(prefix: str, name: str, value: float) -> Iterator[None]:
    """A PETSc option that holds for the block, unless it is given."""
    options = PETSc.Options(prefix)
    given = options.hasName(name)
    if not given:
        options[name] = value
    try:
        yield
    finally:
        if not given:
            options.delValue(name)


def counts_pivots(pc: PETSc.PC) -> bool:
    """Whether the factorisation tells how many pivots are negative."""
    return bool(pc.getType() == "cholesky" and pc.getFactorSolverType() == "mumps")


def make_solver(K: PETSc.Mat, prefix: str, *, direct: bool, pivots: bool) -> PETSc.KSP:
    """The solver by a factorisation (``direct``) that counts all negative ``pivots``, or by iterations."""
    ksp = PETSc.KSP().create(K.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(K)
    ksp.setTolerances(rtol=1e-10, max_it=1000)  # of an iterative solver, ours or one asked for by options
    pc = ksp.getPC()
    package = next((name for name in ("mumps", "superlu_dist") if PETSc.Sys.hasExternalPackage(name)), None)
    ksp.setErrorIfNotConverged(direct)  # iterations end by their reason: an error would leave the vectors locked
    if direct and (package or K.comm.size == 1):
        ksp.setType("preonly")
        pc.setType("lu" if package == "superlu_dist" else "cholesky")
        pc.setFactorSolverType(package or "petsc")
    else:
        ksp.setType("cg")
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        pc.setType("gamg")
    with option(prefix, "pc_gamg_threshold", _WEAK):
        ksp.setFromOptions()
    if pivots and counts_pivots(pc):
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(13, 1)  # those of the root front too
    return ksp
