"""Running under mpirun or without: the communicator, and an end that leaves no rank hanging."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

__all__ = ["check_alone", "launched_rank", "leave", "under_mpirun", "world"]

_LAUNCHERS = ("PMI_SIZE", "PMIX_RANK", "OMPI_COMM_WORLD_SIZE", "MPI_LOCALNRANKS")
_RANK = ("PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK")
_SIZE = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE")
_PATIENCE = 10.0


def under_mpirun() -> bool:
    """Whether an MPI launcher started this process."""
    return any(name in os.environ for name in _LAUNCHERS)


def launched_rank() -> int:
    """The rank that the launcher gave to this process, known before MPI is; 0 without a launcher."""
    return _number(_RANK, 0)


def check_alone(command: str) -> None:
    """Raise InputError where mpirun started several ranks of a command that does not share its work among them."""
    size = _number(_SIZE, 1)
    if size > 1:
        from tsg_micro.errors import InputError  # here: the command line starts without NumPy and SciPy

        raise InputError(
            f"{command}: expected one process, got {size} ranks; start it without mpirun (sample and solve run on many)"
        )


def _number(names: tuple[str, ...], default: int) -> int:
    return next((int(os.environ[name]) for name in names if os.environ.get(name, "").isdigit()), default)


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
        if mpi is not None or launched_rank() == 0:
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
