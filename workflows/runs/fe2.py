"""tsgdd fe2: Newton's method on the macroscale with an RVE at every quadrature point, on any number of MPI ranks.

It has the kinematics of the data-driven solve and no data: what separates it from the full tensegrity
is the macroscopic model, what separates a data-driven solution from it is the data.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

import dd_macro as dd
from dd_macro.parallel import together, total
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_law import FOLLOW, RVELaw
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from workflows.runs.edges import in_parts, specs_of
from workflows.runs.progress import progress
from workflows.runs.scene import Scene
from workflows.store.record import drop_summary, peak_memory, write_summary

__all__ = ["MEASURE", "fe2"]

MEASURE = "first_piola"
"""The stress that is written."""


def fe2(
    out: Path,
    *,
    scene: Scene,
    tissue: Tissue | None = None,
    steps: int = 1,
    options: dd.ReferenceOptions | None = None,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Solve ``scene`` with an RVE of ``tissue`` at every quadrature point, in ``steps`` load steps.

    Writes quadrature.h5, fields.vtkhdf, figures and summary.json into ``out``, as ``tsgdd solve`` does; the material
    state is the mechanical one.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: Newton's method did not converge.
    """
    comm, tissue = MPI.COMM_WORLD, tissue or Tissue()
    if steps < 1:
        raise InputError(f"steps: expected at least 1, got {steps}")
    begin = time.perf_counter()
    spec = RVESpec.of_kind(scene.kind or "sheet", tissue)
    rve = spec.build()
    together(comm, lambda: output_folder(out) if comm.rank == 0 else None)

    problem = scene.problem(comm, tissue, spec)
    laws = [RVELaw(rve, follow=FOLLOW), *(RVELaw(one.build(), follow=FOLLOW) for one in specs_of(spec, problem)[1:])]
    material = in_parts([dd.Material(law=law) for law in laws])
    points = int(total(comm, len(problem.operator.weights)))
    ranks = f"{comm.size} rank{'s' * (comm.size > 1)}"
    say(f"{problem.operator.global_dofs} unknowns, {points} RVEs on {ranks}")
    ready = time.perf_counter()
    method = dd.LawMethod(steps=steps, options=options or dd.ReferenceOptions())
    with progress("FE2") as told:
        solution = method.prepare(problem, material).solve(watch=dd.Watch(say, done=told))
    done = time.perf_counter()

    drop_summary(out, comm)
    dd.write_solution(out, solution, stress_measure=MEASURE)
    figures = {
        **solution.figures(),
        **_rve_figures(comm, laws),
        "top_force": (scene.top_force(solution), "N"),
        "stress_measure": (MEASURE, ""),
        "seconds": (done - begin, "s"),
        "seconds_setup": (ready - begin, "s"),
        "peak_memory": (comm.allreduce(peak_memory(), MPI.MAX), "B"),
    }
    parameters = {**scene.parameters(), "steps": steps, **tissue.as_dict()}
    summary = None
    if comm.rank == 0:
        summary = write_summary(out, command="fe2", parameters=parameters, figures=figures)
        if plots:
            from workflows.runs.scene_figures import draw_solution

            draw_solution(out, solution)
    return comm.bcast(summary)


def _rve_figures(comm: MPI.Comm, laws: list[RVELaw]) -> dict[str, tuple[Any, str]]:
    """What the RVEs of all ranks did; collective. Unknowns and linear solver are those of the first one."""
    newton = laws[0].rve.solver.newton
    numbers = np.sum([law.effort.numbers() for law in laws], axis=0)
    _, asked, solves, iterations, factorisations, seconds = total(comm, numbers)
    slowest = comm.allreduce(float(numbers[-1]), MPI.MAX)
    return {
        "rve_solves": (int(solves), ""),
        "rve_states_asked": (int(asked), ""),
        "rve_newton_iterations": (int(iterations), ""),
        "rve_factorisations": (int(factorisations), ""),
        "rve_unknowns": (newton.pattern.size, ""),
        "rve_linear_solver": (newton.choice.backend, ""),
        "unstable_rves": (int(total(comm, sum(law.unstable for law in laws))), ""),
        "seconds_rve": (slowest, "s"),
        "seconds_rve_all_ranks": (float(seconds), "s"),
        "rank_imbalance": (slowest * comm.size / float(seconds), "slowest rank over mean"),
    }
