"""A command of tsgdd in processes of its own, so that its time and memory are its alone."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Sequence

from tsg_micro.data.errors import ConvergenceError

__all__ = ["run_tsgdd"]

_START = "from workflows.cli import main; main()"


def run_tsgdd(arguments: Sequence[object], *, ranks: int = 1, seconds: float | None = None) -> float | None:
    """CPU time, in s, of ``tsgdd`` with these arguments on a number of ranks; None where it did not end in ``seconds``.

    Raises:
        ConvergenceError: it failed.
    """
    start = [] if ranks == 1 else ["mpiexec", "-n", str(ranks)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        done = subprocess.run(
            [*start, sys.executable, "-c", _START, *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        return None
    if done.returncode != 0:
        said = (done.stderr.strip() or "failed").splitlines()[-1]
        raise ConvergenceError(f"tsgdd {arguments[0]}: {said.removeprefix('tsgdd: ')}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
