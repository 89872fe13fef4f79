"""What all ranks have to do together: fail alike, sum, and write one file in turn."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path

__all__ = ["atomic_path_of_all", "check_everywhere", "in_turn", "one_thread", "together", "total"]

one_thread = threadpool_limits.wrap(limits=1)
"""Decorator: BLAS with one thread. The blocks of a sheet are small, and threads slow them down; work is for ranks."""


def total(comm: MPI.Comm, value: ArrayLike) -> NDArray[np.float64]:
    """Sum over the ranks of ``value``, a number or an array of equal shape on every rank."""
    local = np.asarray(value, dtype=float)
    summed = np.empty_like(local)
    comm.Allreduce(local, summed)
    return summed


def check_everywhere(comm: MPI.Comm, message: str | None) -> None:
    """Raise InputError on every rank with the text of the first rank that has one.

    Raises:
        InputError: ``message`` is not None on some rank.
    """
    first = comm.allreduce(comm.size if message is None else comm.rank, op=MPI.MIN)
    if first < comm.size:
        raise InputError(comm.bcast(message, root=first))


def in_turn(comm: MPI.Comm, action: Callable[[], None]) -> None:
    """Run ``action`` on one rank after another; where one fails, all raise.

    Raises:
        InputError: the action failed on some rank; the text is that rank's.
    """
    for turn in range(comm.size):
        message = None
        if comm.rank == turn:
            try:
                action()
            except Exception as error:  # any failure must reach the ranks that wait for their turn
                message = f"rank {turn}: {type(error).__name__}: {error}"
        message = comm.bcast(message, root=turn)
        if message is not None:
            raise InputError(f"output: {message}")


@contextlib.contextmanager
def atomic_path_of_all(comm: MPI.Comm, path: str | Path) -> Iterator[Path]:
    """One temporary path for all ranks, renamed to ``path`` by rank 0 when the block ends well on all of them.

    The block must fail on all ranks or on none (see :func:`in_turn`).

    Raises:
        InputError: the folder does not exist or cannot be written.
    """
    stack = contextlib.ExitStack()
    name, message = None, None
    if comm.rank == 0:
        try:
            name = str(stack.enter_context(atomic_path(path)))
        except InputError as error:
            message = str(error)
    check_everywhere(comm, message)
    with contextlib.ExitStack() as on_failure:
        on_failure.push(stack)
        yield Path(comm.bcast(name))
        on_failure.pop_all()
    try:
        stack.close()  # rank 0 renames
    except OSError as error:
        message = f"output {path}: cannot be written ({error.strerror})"
    check_everywhere(comm, message)


def together[T](comm: MPI.Comm, action: Callable[[], T]) -> T:
    """What ``action`` returns on each rank; bad input that only some ranks see is raised on all of them."""
    message = None
    try:
        result = action()
    except InputError as error:
        message = str(error)
    check_everywhere(comm, message)
    return result
