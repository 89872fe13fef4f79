"""tsgdd paper: the multiscale study of the paper (Section 4) from end to end, in stages that are not repeated."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path, output_folder
from workflows.runs.loads import LOADS
from workflows.store.record import write_summary
from workflows.store.stages import Stages
from workflows.studies.coverage import FEWEST
from workflows.studies.prerequisites import Chain

if TYPE_CHECKING:
    from workflows.studies.one_load import Study

__all__ = ["paper"]


def paper(
    out: Path,
    *,
    chain: Chain,
    largest: int = 6,
    sizes: int = 16,
    draws: int = 10,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Run every stage that is not in ``out`` already with the same parameters, and write report.md.

    ``largest`` RVE of the size study in blocks; ``sizes`` numbers of data and ``draws`` of each in the data-size study.
    A killed run goes on: finished stages are kept, the full tensegrity goes on after its last load step, the data-size
    study after its last draw.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: a solver did not converge.
    """
    from workflows.runs.compare import compare
    from workflows.studies.bench_frontier import frontier
    from workflows.studies.causes import causes
    from workflows.studies.data_size import data_size
    from workflows.studies.one_load import Study
    from workflows.studies.report import write_report
    from workflows.studies.rve_size import study_rve_size
    from workflows.studies.sampling import study_sampling

    for load in LOADS:
        chain.check_reach(load)
    for name, value, least in (
        ("paths * steps", chain.paths * chain.steps, FEWEST),
        ("largest", largest, 2),
        ("sizes", sizes, 2),
        ("draws", draws, 1),
    ):
        if value < least:
            raise InputError(f"{name}: expected at least {least}, got {value}")
    out = output_folder(out)
    begin = time.perf_counter()
    stages = Stages(out, say)
    forces = sorted({1e-9, chain.bar_force, 5e-8})
    stages.run(
        "rve-size",
        {"largest": largest, "bar_force": forces},
        partial(study_rve_size, largest=largest, bar_force=forces, say=say),
    )
    for load in LOADS:
        data = chain.data(stages, load)
        dns = chain.dns(stages, load, say)
        chain.dns(stages, load, say, flat=False)
        dd = chain.solution(stages, load, data, say)
        runs = {"load": load, "chain": chain.parameters()}
        pair = (f"data-{load}", f"dns-{load}")
        study = partial(Study, load=load, chain=chain, dns=dns, data=data, stages=stages, say=say)
        stages.run(f"compare-{load}", runs, partial(compare, dd=dd, dns=dns), (*pair, f"dd-{load}"))
        sampled = partial(study_sampling, load=load, data=data, dd=dd, tissue=chain.tissue, say=say)
        stages.run(f"sampling-{load}", runs, sampled, (f"data-{load}", f"dd-{load}"))
        sized, asked = partial(data_size, count=sizes, draws=draws), {**runs, "sizes": sizes, "draws": draws}
        stages.run(f"data-size-{load}", asked, _of(study, sized), pair)
        stages.run(f"frontier-{load}", runs, _of(study, partial(frontier, models=["small strain"])), pair)
        stages.run(f"causes-{load}", runs, _of(study, causes), (*pair, f"dns-{load}-free"))
    with atomic_path(out / "report.md") as temporary:
        rows = write_report(temporary, out, chain)
    say(f"report: {out / 'report.md'}")
    return write_summary(
        out,
        command="paper",
        parameters={**chain.parameters(), "largest": largest, "sizes": sizes, "draws": draws},
        figures={
            "table": (rows, ""),
            "stages_run": (stages.ran, ""),
            "stages_kept": (stages.skipped, ""),
            "seconds": (time.perf_counter() - begin, "s"),
        },
    )


def _of(study: Callable[[Path], Study], run: Callable[[Study], Any]) -> Callable[[Path], Any]:
    """The stage that runs a study in its folder."""
    return lambda folder: run(study(folder))
