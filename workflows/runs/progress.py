"""A bar with the time left, for what takes a while: on a terminal, of the first rank, one at a time."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

__all__ = ["progress", "tracked"]

_PERIOD = 600.0
"""Seconds over which the speed is measured: parts differ."""
_shown: list[str] = []
"""What is shown now; runs within a run show nothing of their own."""


@contextmanager
def progress(what: str, total: float = 1.0) -> Iterator[Callable[[float], None]]:
    """Give a function that is told how much of ``total`` is done; ``what`` stands before the bar."""
    mpi = sys.modules.get("mpi4py.MPI")
    if _shown or not sys.stderr.isatty() or (mpi is not None and mpi.COMM_WORLD.rank > 0):
        yield lambda done: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), "left", TimeRemainingColumn())
    bar = Progress(
        TextColumn(what, markup=False),
        *columns,
        console=Console(stderr=True),
        redirect_stdout=sys.stdout.isatty(),  # else lines of a run would go where the bar is
        speed_estimate_period=_PERIOD,
        transient=True,
    )
    _shown.append(what)
    try:
        with bar:
            task = bar.add_task("", total=total)
            yield lambda done: bar.update(task, completed=done)
    finally:
        _shown.pop()


def tracked[T](items: Sequence[T], what: str) -> Iterator[T]:
    """The items, one after the other, with a bar of how many are done."""
    with progress(what, len(items)) as told:
        for number, item in enumerate(items):
            yield item
            told(number + 1.0)
