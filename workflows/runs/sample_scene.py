"""tsgdd sample SCENE.toml: random data of one of its tissues, at all the bar forces that it has in the body."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from dd_macro.parallel import span, together
from tsg_micro.continuum.graded_source import GradedSource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES, strain_path
from tsg_micro.data.dataset_file import write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_file
from workflows.runs.sample import sample
from workflows.runs.sample_plan import Plan
from workflows.scenes.model import SceneModel
from workflows.scenes.scene import Built, build
from workflows.store.record import drop_summary, versions, write_summary

__all__ = ["sample_scene"]


def sample_scene(
    out: Path,
    model: SceneModel,
    *,
    tissue: str | None = None,
    load: str = "full",
    paths: int = 400,
    steps: int = 10,
    seed: int = 0,
    processes: int | None = None,
    plots: bool = True,
) -> dict[str, Any]:
    """Sample ``paths`` paths of ``steps`` points in the box ``load`` for the tissue of this name; see sample.

    Where the bar force varies each path has one of its own, drawn between the least and the largest of the body, evenly
    in its logarithm; the data know theirs. Work is shared by the ranks under mpirun;
    ``processes`` counts where it does not vary.

    Raises:
        InputError: an argument is not valid, the scene has no such tissue, or several and none is named.
    """
    built = build(MPI.COMM_WORLD, model)
    number = _number(built, tissue)
    given, kind = built.tissues[number], built.kinds[number]
    if not built.varies(number):
        how: dict[str, Any] = {"seed": seed, "processes": processes, "plots": plots}
        return sample(out, load=load, paths=paths, steps=steps, tissue=given, kind=kind, **how)
    if load != "full":
        raise InputError(f"load: expected full in a tissue whose bar force varies, got {load!r}")
    plan, comm = Plan(load, paths, steps, seed, given, kind=kind), built.domain.comm
    together(comm, lambda: output_file(out))
    begin = time.perf_counter()
    low, high = _range(built, number)
    random = np.random.default_rng([seed, paths])
    forces = np.repeat(np.exp(random.uniform(np.log(low), np.log(high), paths)), steps)
    strains = np.concatenate([strain_path(BOXES[load], steps=steps, seed=seed, path=k) for k in range(paths)])
    parameters = plan.parameters() | {"bar_force": None, "bar_force_range": [low, high]}
    source = GradedSource(RVESpec.of_kind(kind, given), comm=comm, parameters=parameters, versions=versions())
    found = source.states(strains, 0 * strains, forces)
    if found is None:
        raise InputError("paths: expected some state to be reached, got none")
    figures = {
        "points": (len(found), ""),
        "paths": (paths, ""),
        "failed_points": (len(strains) - len(found), ""),
        "bar_force_range": ([low, high], "N"),
        "seconds": (time.perf_counter() - begin, "s"),
    }
    summary = None
    if comm.rank == 0:
        drop_summary(out)
        write_dataset(out, found)
        summary = write_summary(out, command="sample", parameters=parameters, figures=figures)
    return comm.bcast(summary)


def _number(built: Built, name: str | None) -> int:
    if name is None and len(built.names) == 1:
        return 0
    if name not in built.names:
        raise InputError(f"tissue_name: expected one of {', '.join(built.names)}, got {name!r}")
    return built.names.index(name)


def _range(built: Built, number: int) -> tuple[float, float]:
    """Least and largest bar force of the tissue in the body, N; collective."""
    low, high = span(built.domain.comm, built.bar_force[built.cell_tissue == number])
    return float(low), float(high)
