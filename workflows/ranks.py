"""Running under mpirun or without: the communicator, and an end that leaves no rank hanging."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

__all__ = ["under_mpirun", "world", "leave"]

_LAUNCHERS = ("PMI_SIZE", "PMIX_RANK", "OMPI_COMM_WORLD_SIZE", "MPI_LOCALNRANKS")
_PATIENCE = 10.0


def under_mpirun() -> bool:
    """Whether an MPI launcher started this process."""
    return any(name in os.environ for name in _LAUNCHERS)


def world() -> Any:
    """The communicator of all ranks under mpirun, else None; mpi4py is not needed then."""
    if not under_mpirun():
        return None
    import contextlib

    with contextlib.suppress(ImportError):
        import dolfinx_solver  # noqa: F401  (the wheel that carries MPI wants to be first)
    from mpi4py import MPI

    return MPI.COMM_WORLD


def leave(message: str, code: int) -> None:
    """Print one line for all ranks and exit with ``code``; ranks that do not come along are ended too."""
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
    mpi.COMM_WORLD.Abort(code)
