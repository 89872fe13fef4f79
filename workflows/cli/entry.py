"""The entry of the command line: what went wrong is one line and an exit code."""

from __future__ import annotations

import logging
import os
import traceback

from workflows.cli.commands import app
from workflows.runs.ranks import leave, under_mpirun

__all__ = ["main"]


def main() -> None:
    """Run the command line; bad input exits with 2, a run that failed with 1, each with one line."""
    logging.captureWarnings(True)
    # a closed pipe or a kill is no business of PETSc's, which would print a page
    os.environ["PETSC_OPTIONS"] = f"{os.environ.get('PETSC_OPTIONS', '')} -no_signal_handler".strip()
    try:
        code = app(standalone_mode=False)  # a command returns None; typer turns Ctrl-C into 130
    except Exception as error:
        _fail(error)
    except KeyboardInterrupt:
        code = 130
    if code == 130:
        leave("tsgdd: interrupted", 130)


def _fail(error: Exception) -> None:
    """One line and an exit code for what went wrong; a traceback only for what should not happen."""
    from tsg_micro.data.errors import ConvergenceError, InputError

    one_line = " ".join(str(error).split())
    if type(error).__name__ == "NoArgsIsHelpError":  # no command at all: its text is the help page
        leave(str(error), 2)
    usage = getattr(error, "format_message", None)  # a wrong option; typer carries its own copy of click or not
    if usage is not None:
        leave(f"tsgdd: {' '.join(usage().split())} (tsgdd --help lists the commands)", 2)
    if isinstance(error, InputError) and not isinstance(error, OSError):
        leave(f"tsgdd: {one_line}", 2)
    if isinstance(error, ConvergenceError) or type(error).__name__ == "KernelError":
        leave(f"tsgdd: {one_line}", 1)
    missing = (error.name or "").split(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if missing in ("basix", "dolfinx", "mpi4py", "petsc4py", "ufl"):
        leave(f"tsgdd: this command needs DOLFINx, {missing} is not installed: pip install 'tsgdd[fenicsx]'", 1)
    if isinstance(error, OSError | MemoryError):
        leave(f"tsgdd: {one_line or 'not enough memory'}", 1)
    if under_mpirun() or "TSGDD_DEBUG" in os.environ:
        traceback.print_exc()
    leave(f"tsgdd: unexpected {type(error).__name__}: {one_line} (this is a defect; TSGDD_DEBUG=1 shows where)", 1)
