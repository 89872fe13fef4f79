"""Running under mpirun or without: the communicator, and an end that leaves no rank hanging."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from typing import Any

__all__ = ["check_alone", "leave", "under_mpirun", "world"]

_LAUNCHERS = ("PMI_SIZE", "PMIX_RANK", "OMPI_COMM_WORLD_SIZE", "MPI_LOCALNRANKS")
_SIZE = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE")
_PATIENCE = 10.0
_DELIVERY = 1.0
"""Seconds for the launcher to pass on what a rank printed; it may drop what is on the way when a rank aborts."""


def under_mpirun() -> bool:
    """Whether an MPI launcher started this process."""
    return any(name in os.environ for name in _LAUNCHERS)


def check_alone(command: str) -> None:
    """Raise InputError where mpirun started several ranks of a command that does not share its work among them."""
    size = _launched_size()
    if size > 1:
        from tsg_micro.data.errors import InputError  # here: the command line starts without NumPy and SciPy

        raise InputError(
            f"{command}: expected one process, got {size} ranks; start it without mpirun (sample and solve run on many)"
        )


def _launched_size() -> int:
    """The number of ranks that the launcher has started, known before MPI is; 1 without a launcher."""
    return next((int(os.environ[name]) for name in _SIZE if os.environ.get(name, "").isdigit()), 1)


def world() -> Any:
    """The communicator of all ranks under mpirun, else None; mpi4py is not needed then."""
    if not under_mpirun():
        return None
    with contextlib.suppress(ImportError):
        import dolfinx_solver  # noqa: F401  (the wheel that carries MPI wants to be first)
    from mpi4py import MPI

    return MPI.COMM_WORLD


def leave(message: str, code: int) -> None:
    """Print one line for all ranks and exit with ``code``; ranks that do not come along are ended too."""
    if _launched_size() > 1:  # the others may be waiting where MPI starts
        with contextlib.suppress(ImportError):
            world()
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is None or mpi.COMM_WORLD.size == 1:
        print(message, file=sys.stderr, flush=True)
        sys.exit(code)
    request = mpi.COMM_WORLD.Ibarrier()
    deadline = time.monotonic() + _PATIENCE
    while time.monotonic() < deadline:
        if request.Test():
            if mpi.COMM_WORLD.rank == 0:
                print(message, file=sys.stderr, flush=True)
            sys.exit(code)
        time.sleep(0.01)
    print(f"rank {mpi.COMM_WORLD.rank}: {message}", file=sys.stderr, flush=True)
    time.sleep(_DELIVERY)
    mpi.COMM_WORLD.Abort(code)
    time.sleep(_PATIENCE)  # Abort may come back before the launcher has ended this rank
    os._exit(code)
