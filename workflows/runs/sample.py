"""tsgdd sample: material data from random loading paths through an RVE."""

from __future__ import annotations

import itertools
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import get_context, parent_process, resource_tracker
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from tsg_micro.cells.lattice import Images
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve import RVE
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES, PathData, StrainBox, join_paths, sample_paths
from tsg_micro.data.dataset import Dataset, convert_dataset
from tsg_micro.data.dataset_file import append_dataset, read_dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import locked, output_file
from tsg_micro.data.stress import check_measure
from workflows.runs.progress import progress
from workflows.runs.ranks import world
from workflows.runs.sample_kept import KeptPaths
from workflows.store.checkpoint import fingerprint
from workflows.store.limits import check_memory
from workflows.store.record import read_summary, summary_path, versions, write_summary

__all__ = ["Plan", "sample"]

_worker: dict[str, Any] = {}
_AT_ONCE, _TOGETHER = 4, 32
"""Batches of each process that are asked for at once; paths of one block that are followed together."""
_LISTENS = 0.5
"""Seconds between two looks at whether Ctrl-C was pressed."""
_PER_PATH, _PER_POINT, _PER_BLOCK = 2e3, 1.5e3, 3e5
"""Bytes, roughly: a path on its way, a point with its tangent (twice, as it is joined), a block of an RVE."""


@dataclass(frozen=True)
class Plan:
    """What is sampled; checked when made.

    Raises:
        InputError: on construction, where a value is not valid.
    """

    load: str
    paths: int
    steps: int
    seed: int = 0
    tissue: Tissue = field(default_factory=Tissue)
    blocks: tuple[int, int, int] = (1, 1, 1)
    images: Images = "merged"
    kind: str = "sheet"
    axes: str | None = None

    def __post_init__(self) -> None:
        if self.load not in BOXES:
            raise InputError(f"load: expected one of {', '.join(BOXES)}, got {self.load!r}")
        for name, value, least in (("paths", self.paths, 1), ("steps", self.steps, 1), ("seed", self.seed, 0)):
            if value < least:
                raise InputError(f"{name}: expected at least {least}, got {value}")
        assert self.spec  # checks itself
        if self.seed >= 2**63:
            raise InputError(f"seed: expected less than 2^63, got {self.seed}")
        check_memory(f"paths, steps: {self.paths} and {self.steps}", self.paths * (_PER_PATH + self.steps * _PER_POINT))
        check_memory(f"blocks: {' x '.join(map(str, self.blocks))}", _PER_BLOCK * math.prod(self.spec.blocks))

    @property
    def box(self) -> StrainBox:
        """The strain box of the load; bulk tissue has no faces that would leave a strain free."""
        return replace(BOXES[self.load], free=()) if self.kind == "bulk" else BOXES[self.load]

    @property
    def spec(self) -> RVESpec:
        """The RVE that is sampled."""
        more: dict[str, Any] = {"blocks": self.blocks, "images": self.images, "free": self.box.free}
        inside = RVESpec.of_kind(self.kind, self.tissue, **more)
        return inside if self.axes is None else inside.with_axes(self.axes)

    def parameters(self) -> dict[str, Any]:
        """All values, for a summary."""
        one = {"load": self.load, "paths": self.paths, "steps": self.steps, "bar_force": self.tissue.bar_force}
        one |= {"seed": self.seed, "blocks": self.blocks, "images": self.images, "kind": self.kind, "axes": self.axes}
        return {**one, "box": asdict(self.box), "cell": asdict(self.tissue.cell)}

    def together(self, paths: int, processes: int) -> int:
        """How many of the ``paths`` that are left each of the processes follows at once."""
        return max(1, min(_TOGETHER // math.prod(self.spec.blocks), -(-paths // (2 * processes))))

    def run(self, rve: RVE, paths: Iterable[int], progress: Callable[[], None] | None = None) -> list[PathData]:
        """Follow the paths of these numbers."""
        return sample_paths(rve, self.box, paths=paths, steps=self.steps, seed=self.seed, progress=progress)


def sample(
    out: Path,
    *,
    load: str,
    paths: int,
    steps: int,
    tissue: Tissue,
    seed: int = 0,
    blocks: tuple[int, int, int] = (1, 1, 1),
    images: Images = "merged",
    kind: str = "sheet",
    axes: str | None = None,
    stress_measure: str = "first_piola",
    append: bool = False,
    processes: int | None = None,
    plots: bool = True,
) -> dict[str, Any]:
    """Sample ``paths`` paths of ``steps`` points in the strain box ``load``; the data set goes to the file ``out``.

    ``kind`` and ``axes`` say of which RVE: tsg_micro.continuum.rve_spec.KINDS, and the words of RVESpec.with_axes.
    Paths are shared among the ranks under mpirun, else among ``processes`` (all cores if None); the data are the same.
    A run that was cut short goes on from the paths that it had done when the same is asked for again.

    Raises:
        InputError: an argument is not valid, or no path reached any state.
    """
    comm = world()
    rank, size = (0, 1) if comm is None else (comm.rank, comm.size)
    plan = Plan(load, paths, steps, seed, tissue, blocks, images, kind, axes)
    output_file(out)
    check_measure(stress_measure)
    if append and out.exists():
        _check_append(out, plan, stress_measure)
    if processes is not None and processes < 1:
        raise InputError(f"processes: expected at least 1, got {processes}")
    kept = KeptPaths(out, fingerprint({**plan.parameters(), **plan.spec.parameters()}), comm)
    left = kept.left(paths)
    processes = max(1, min(len(left), processes or os.cpu_count() or 1)) if comm is None else 1
    begin = time.perf_counter()
    with progress("sampling", -(-len(left) // size)) as told:
        count = itertools.count(1)

        def advance() -> None:
            told(next(count))

        if processes > 1:
            _in_processes(processes, plan, left, kept, advance)
        else:
            with threadpool_limits(1):
                rve = plan.spec.build()
                for some in itertools.batched(left[rank::size], plan.together(len(left), size)):
                    kept.add(plan.run(rve, some, advance))
    done = kept.done
    if comm is not None:
        parts = comm.gather(done)
        done = [data for part in parts for data in part] if rank == 0 else []
    seconds = time.perf_counter() - begin
    if rank != 0:
        return comm.bcast(None)  # type: ignore[no-any-return]
    ran = {"processes": (size if comm is not None else processes, ""), "seconds": (seconds, "s")}
    stored, summary = _store(out, plan, done, ran, stress_measure=stress_measure, append=append)
    kept.remove(others=not append)
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from tsg_micro.figures.data import plot_dataset

        save_figure(plot_dataset(stored), out.with_suffix(".png"))
    if comm is not None:
        comm.bcast(summary)
    return summary


def _store(
    out: Path,
    plan: Plan,
    done: list[PathData],
    ran: dict[str, tuple[Any, str]],
    *,
    stress_measure: str,
    append: bool,
) -> tuple[Dataset, dict[str, Any]]:
    """What is in the file ``out`` now that the paths are ``done``, and its summary; ``ran`` says on what, how long."""
    made = {**plan.parameters(), **plan.spec.parameters()}
    dataset = convert_dataset(join_paths(done, seed=plan.seed, parameters=made, versions=versions()), stress_measure)
    seconds = ran["seconds"][0]
    failures = sorted(data.failure for data in done if data.failure)
    before: float | None = 0.0
    with locked(out) if append else nullcontext():
        if append and out.exists():
            _check_append(out, plan, stress_measure)  # another process may have added to it meanwhile
            before = _seconds_before(out)
        summary_path(out).unlink(missing_ok=True)
        stored = append_dataset(out, dataset) if append else dataset
        if not append:
            write_dataset(out, stored)
        summary = write_summary(
            out,
            command="sample",
            parameters={**plan.parameters(), "stress_measure": stress_measure, "append": append},
            figures={
                "points": (len(dataset), ""),
                "points_in_file": (len(stored), ""),
                "paths": (plan.paths, ""),
                "failed_paths": (len(failures), ""),
                "failures": (failures[:5], ""),
                "silent": (stored.silent, ""),
                "negative_pivots": (max(data.negative_pivots for data in done), ""),
                **ran,
                "seconds_in_file": (None if before is None else before + seconds, "s"),
                "seconds_per_point": (seconds / len(dataset), "s"),
            },
        )
    return stored, summary


def _seconds_before(out: Path) -> float | None:
    """Time that the data in the file took; None where its summary is not there or does not say."""
    try:
        return read_summary(out, "sample").get("seconds_in_file")
    except InputError:
        return None


def _check_append(out: Path, plan: Plan, stress_measure: str) -> None:
    """Raise InputError where the file holds another stress measure or bar force, or the very points to be added."""
    there = read_dataset(out)
    if there.stress_measure != stress_measure:
        raise InputError(f"out {out}: expected a data set of {stress_measure} stress to append to")
    for source in there.sources:
        there_force = source.get("bar_force", plan.spec.tissue.bar_force)
        if there_force != plan.spec.tissue.bar_force:
            raise InputError(
                f"bar_force: expected that of the data in {out}, {there_force} N, got {plan.spec.tissue.bar_force}"
            )
        drawn = source.get("load"), source.get("seed")
        if drawn == (plan.load, plan.seed) and RVESpec.from_parameters(source) == plan.spec:
            raise InputError(f"seed: expected another than that of the data in {out}, got {plan.seed} again")


def _in_processes(processes: int, plan: Plan, left: list[int], kept: KeptPaths, advance: Callable[[], None]) -> None:
    """The paths that are left, shared among processes of this machine."""
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
