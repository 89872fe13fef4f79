"""Sampled paths shared among processes of this machine, which end with their parent and leave Ctrl-C to it."""

from __future__ import annotations

import itertools
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process, resource_tracker
from typing import Any

from threadpoolctl import threadpool_limits

from tsg_micro.continuum.sampling import PathData
from workflows.runs.sample_kept import KeptPaths
from workflows.runs.sample_plan import Plan

__all__ = ["in_processes"]

_worker: dict[str, Any] = {}
_AT_ONCE = 4
"""Batches of each process that are asked for at once."""
_LISTENS = 0.5
"""Seconds between two looks at whether Ctrl-C was pressed."""


def in_processes(processes: int, plan: Plan, left: list[int], kept: KeptPaths, advance: Callable[[], None]) -> None:
    """Follow the paths that are ``left`` in so many processes; ``advance`` is called once a path.

    Raises:
        ChildProcessError: a process was ended from outside, or for lack of memory.
    """
    resource_tracker.ensure_running()  # it would end the deafness below when it starts
    pool = ProcessPoolExecutor(processes, get_context("spawn"), initializer=_start_worker, initargs=(plan,))
    with _interrupt() as asked, pool:
        try:
            batches = itertools.batched(left, plan.together(len(left), processes))
            for some in itertools.batched(batches, _AT_ONCE * processes):  # few are there to cancel
                with _deaf():
                    futures = {pool.submit(_work, plan, paths) for paths in some}
                while futures:
                    done, futures = wait(futures, timeout=_LISTENS, return_when=FIRST_COMPLETED)
                    for future in done:
                        kept.add(future.result())
                        for _ in future.result():
                            advance()
                    if asked.is_set():
                        raise KeyboardInterrupt
        except BrokenProcessPool:
            raise ChildProcessError("sample: a worker process was ended from outside, or for lack of memory") from None
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


@contextmanager
def _interrupt() -> Iterator[threading.Event]:
    """An event that Ctrl-C sets, so that it does not break into the pool's own code, which may then wait for ever."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():  # where Ctrl-C is never heard
        yield asked
        return
    before = signal.signal(signal.SIGINT, lambda *_: asked.set())
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _deaf() -> Iterator[None]:
    """Ctrl-C waits while processes are started, which inherit that they do not hear it from their first moment on."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker(plan: Plan) -> None:
    """What a process keeps between paths."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent answers Ctrl-C for all
    threading.Thread(target=_end_with_parent, daemon=True).start()
    threadpool_limits(1)
    _worker["rve"] = plan.spec.build()


def _end_with_parent() -> None:
    """End this process when its parent is gone; the pool itself would wait for work for ever."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _work(plan: Plan, paths: tuple[int, ...]) -> list[PathData]:
    """A batch of paths, in a process of the pool."""
    return plan.run(_worker["rve"], paths)
