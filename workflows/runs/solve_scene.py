"""tsgdd solve SCENE.toml: a scene from a file, by any method, in steps of its load, on any number of MPI ranks."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dd_macro as dd
from dd_macro.parallel import together
from tsg_micro.data.files import output_folder
from workflows.runs.checks import check_limit, judge_scene
from workflows.runs.materials import TissueData, method_of, read_tissues, the_material
from workflows.runs.scene_steps import Steps
from workflows.scenes.model import SceneModel
from workflows.scenes.scene import Built, build
from workflows.store.checkpoint import fingerprint
from workflows.store.record import drop_summary, peak_memory, write_summary

__all__ = ["scene_parameters", "solve_scene"]

MEASURE = "first_piola"
"""The stress that is written."""


def solve_scene(
    out: Path,
    model: SceneModel,
    *,
    command: str = "solve",
    max_error: float | None = None,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Solve the scene in the steps of its load; all ranks of the world take part. ``command`` is for the summary.

    An estimated error beyond ``max_error`` is an error.

    Writes quadrature.h5 and fields.vtkhdf of the last step, step-N.vtkhdf of each and fields.vtkhdf.series of all where
    there are several, data.h5 of an adaptive run, figures and, last of all, summary.json into ``out``.

    Raises:
        InputError: the scene is not valid, before any work.
        ConvergenceError: a step did not converge, or the error is too large, after all files were written.
    """
    check_limit(max_error)
    comm, begin = MPI.COMM_WORLD, time.perf_counter()
    built = build(comm, model)
    method = method_of(built)
    known = together(comm, lambda: read_tissues(built, method))
    computed = isinstance(method, dd.AdaptiveMethod) or (isinstance(method, dd.LawMethod) and method.fit is None)
    keep = [one.keep(computed=computed) for one in known]
    problem = built.problem([one.rve for one in known], keep)
    parameters = scene_parameters(built)
    steps = Steps(
        out,
        model.solve.factors,
        method=method,
        material=the_material(built, method, known, problem),
        problem=problem,
        run=_fingerprint(parameters, known),
        say=say,
    )
    together(comm, lambda: output_folder(out) if comm.rank == 0 else None)
    drop_summary(out, comm)
    resumed = steps.follow()
    dd.write_solution(out, steps.solution, stress_measure=MEASURE)
    verdict = judge_scene(built, known, steps.solution, max_error)
    if verdict is not None:
        say(verdict.line)
    figures = _figures(steps) | ({} if verdict is None else verdict.figures())
    figures |= {"resumed_after_step": (resumed, ""), "peak_memory": (peak_memory(), "B")}
    figures |= {"seconds": (time.perf_counter() - begin, "s")}
    summary = None
    if comm.rank == 0:
        summary = write_summary(out, command=command, parameters=parameters, figures=figures)
        if plots:
            from workflows.runs.scene_figures import draw_scene

            draw_scene(out, steps.solution, steps.rows)
    steps.finish()
    if verdict is not None:
        verdict.enforce()
    return comm.bcast(summary)


def _figures(steps: Steps) -> dict[str, tuple[Any, str]]:
    """What the summary says; collective."""
    last = steps.rows[-1]
    found = steps.solution.figures() | {
        "reactions": (last["reactions"], "N"),
        "displacements": (last["displacements"], "m"),
        "volume_change": (last["volume_change"], "1"),
        "stress_measure": (MEASURE, ""),
        "warnings": ([], ""),
    }
    units = {"factor": "1", "reactions": "N", "displacements": "m", "volume_change": "1", "seconds": "s"}
    return found | {f"{name}_steps": ([row[name] for row in steps.rows], unit) for name, unit in units.items()}


def _fingerprint(parameters: dict[str, Any], known: list[TissueData]) -> str:
    """Of all that decides the answer: the scene, the content of its mesh and data, and the version."""
    scene = {name: value for name, value in parameters["scene"].items() if name != "solve"}
    files = [Path(parameters["scene"]["body"]["mesh"])] if parameters["scene"]["body"]["mesh"] else []
    content = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    data = [None if one.dataset is None else hashlib.sha256(one.dataset.stress.tobytes()).hexdigest() for one in known]
    decisive = {"scene": scene, "solve": parameters["scene"]["solve"], "tissues": parameters["tissues"]}
    return fingerprint(decisive | {"files": content, "data": data})


def scene_parameters(built: Built) -> dict[str, Any]:
    """For the summary: the scene as it was understood, in SI."""
    kinds = dict(zip(built.names, built.kinds, strict=True))
    tissues = {name: one.as_dict() for name, one in zip(built.names, built.tissues, strict=True)}
    return {"scene": built.model.model_dump(mode="json"), "tissues": tissues, "kinds": kinds}
