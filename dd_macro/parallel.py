"""What all ranks have to do together: fail alike, sum, and write one file in turn."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from tsg_micro.data.errors import InputError, OutputError
from tsg_micro.data.files import atomic_path, reserve

__all__ = ["atomic_path_of_all", "check_everywhere", "in_turn", "one_thread", "span", "together", "total"]

one_thread = threadpool_limits.wrap(limits=1)
"""Decorator: BLAS with one thread. The blocks of a sheet are small, and threads slow them down; work is for ranks."""


def total(comm: MPI.Comm, value: ArrayLike) -> NDArray[np.float64]:
    """Sum over the ranks of ``value``, a number or an array of equal shape on every rank."""
    local = np.asarray(value, dtype=float)
    summed = np.empty_like(local)
    comm.Allreduce(local, summed)
    return summed


def span(comm: MPI.Comm, values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and largest of ``values`` (n, ...) along their first axis on all ranks, some of which may have none."""
    ends = np.stack([-values.min(axis=0, initial=np.inf), values.max(axis=0, initial=-np.inf)])
    comm.Allreduce(MPI.IN_PLACE, ends, op=MPI.MAX)
    return -ends[0], ends[1]


def check_everywhere(comm: MPI.Comm, problem: str | InputError | None) -> None:
    """Raise InputError (OutputError, if it is one) on every rank with the text of the first rank that has one.

    Raises:
        InputError: ``problem`` is not None on some rank.
    """
    first = comm.allreduce(comm.size if problem is None else comm.rank, op=MPI.MIN)
    if first < comm.size:
        kind, text = comm.bcast((OutputError if isinstance(problem, OutputError) else InputError, str(problem)), first)
        raise kind(text)


def in_turn(comm: MPI.Comm, action: Callable[[], None]) -> None:
    """Run ``action`` on one rank after another; where one fails, all raise.

    Raises:
        InputError: the action failed on some rank; the text is that rank's. OutputError where the disk failed.
    """
    for turn in range(comm.size):
        problem: InputError | None = None
        if comm.rank == turn:
            try:
                action()
            except Exception as error:  # any failure must reach the ranks that wait for their turn
                kind = OutputError if isinstance(error, OSError) else InputError
                problem = kind(f"output: rank {turn}: {type(error).__name__}: {error}")
        check_everywhere(comm, problem)


@contextlib.contextmanager
def atomic_path_of_all(
    comm: MPI.Comm, path: str | Path, *, size: int = 0, finish: Callable[[Path], None] = lambda temporary: None
) -> Iterator[Path]:
    """One temporary path for all ranks, renamed to ``path`` by rank 0 when the block ends well on all of them.

    The block must fail on all ranks or on none (see :func:`in_turn`). There must be room for ``size`` bytes before it;
    rank 0 does ``finish`` with the temporary file after it.

    Raises:
        InputError: the folder does not exist or cannot be written.
        OutputError: the disk is full or fails.
    """
    stack, name = contextlib.ExitStack(), None
    if comm.rank == 0:
        name = together(comm, lambda: str(stack.enter_context(_with_room(path, size, finish))))
    else:
        together(comm, lambda: None)
    with contextlib.ExitStack() as on_failure:
        on_failure.push(stack)
        yield Path(comm.bcast(name))
        on_failure.pop_all()
    together(comm, stack.close)  # rank 0 renames


@contextlib.contextmanager
def _with_room(path: str | Path, size: int, finish: Callable[[Path], None]) -> Iterator[Path]:
    with atomic_path(path) as temporary:
        reserve(temporary, size)
        os.truncate(temporary, 0)
        yield temporary
        finish(temporary)


def together[T](comm: MPI.Comm, action: Callable[[], T]) -> T:
    """What ``action`` returns on each rank; bad input that only some ranks see is raised on all of them."""
    problem = None
    try:
        result = action()
    except InputError as error:
        problem = error
    check_everywhere(comm, problem)
    return result
