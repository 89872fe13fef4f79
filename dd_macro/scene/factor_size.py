"""How large the factor of a stiffness will be, before it is made."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dd_macro.parallel import span, total
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.memory import available_memory

__all__ = ["factor_entries", "factor_fits", "factor_memory"]

_ENTRY, _SHARE = 12.0, 0.7
"""Bytes of an entry of a factor, with what MUMPS works with; part of the memory that one may take."""


def factor_entries(operator: StrainOperator) -> float:
    """Entries that a row of the factor of a stiffness has, estimated; collective.

    Nested dissection of a sheet of N unknowns, t nodes thick, leaves 11.5 sqrt(t) log2 N entries an unknown, that of a
    block 21 N^(1/3) (METIS, sheets and blocks of 2000 to 175,000 unknowns: it had 3 to 44 % less).
    """
    comm, x, N = operator.comm, operator.node_coordinates(), operator.global_dofs
    low, high = span(comm, x)
    spacing = (float(total(comm, operator.weights.sum())) / (N / 3)) ** (1 / 3)
    thick = 1.0 + (high - low).min() / spacing
    return float(min(21.0 * N ** (1 / 3), 11.5 * np.sqrt(thick) * np.log2(N)))


def factor_memory(operator: StrainOperator) -> float:
    """Bytes that the factor of a stiffness takes, estimated; collective."""
    return _ENTRY * operator.global_dofs * factor_entries(operator)


def factor_fits(operator: StrainOperator) -> bool:
    """Whether the factor fits the memory that is there; collective."""
    here = available_memory()
    there = operator.comm.allreduce(np.inf if here is None else here, MPI.MIN)
    return bool(factor_memory(operator) <= _SHARE * there)
