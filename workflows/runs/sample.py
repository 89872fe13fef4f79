"""tsgdd sample: material data from random loading paths through an RVE."""

from __future__ import annotations

import itertools
import os
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from tsg_micro.cells.lattice import Images
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import PathData, join_paths
from tsg_micro.data.dataset import Dataset, convert_dataset
from tsg_micro.data.dataset_file import append_dataset, read_dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import locked, output_file
from tsg_micro.data.stress import check_measure
from workflows.runs.progress import progress
from workflows.runs.ranks import world
from workflows.runs.sample_kept import KeptPaths
from workflows.runs.sample_plan import Plan
from workflows.runs.sample_pool import in_processes
from workflows.store.checkpoint import fingerprint
from workflows.store.record import read_summary, summary_path, versions, write_summary

__all__ = ["sample"]


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
            in_processes(processes, plan, left, kept, advance)
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
