"""tsgdd fe2: Newton's method on the macroscale with an RVE at every quadrature point, on any number of MPI ranks.

It has the kinematics of the data-driven solve and no data: what separates it from the full tensegrity
is the macroscopic model, what separates a data-driven solution from it is the data.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dd_macro as dd
from dd_macro.parallel import together, total
from tsg_micro.continuum.rve_law import RVELaw, sheet_rve
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from workflows.runs.loads import LOADS
from workflows.runs.scene import Scene
from workflows.store.record import peak_memory, write_summary

__all__ = ["MEASURE", "fe2"]

MEASURE = "first_piola"
"""The stress that is written."""


def fe2(
    out: Path,
    *,
    scene: Scene,
    bar_force: float,
    steps: int = 1,
    options: dd.ReferenceOptions | None = None,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Solve ``scene`` with an RVE of bar force ``bar_force`` (N) at every quadrature point, in ``steps`` load steps.

    Writes quadrature.h5, fields.vtkhdf, figures and summary.json into ``out``, as ``tsgdd solve`` does; the material
    state is the mechanical one.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: Newton's method did not converge.
    """
    comm = MPI.COMM_WORLD
    if steps < 1:
        raise InputError(f"steps: expected at least 1, got {steps}")
    begin = time.perf_counter()
    law = RVELaw(sheet_rve(bar_force))
    together(comm, lambda: output_folder(out) if comm.rank == 0 else None)

    domain = scene.build(comm)
    operator = scene.operator(domain)
    conditions = scene.conditions(domain)
    points = int(total(comm, len(operator.weights)))
    say(f"{operator.global_dofs} unknowns, {points} RVEs on {comm.size} rank{'s' * (comm.size > 1)}")
    ready = time.perf_counter()

    def progress(it: dd.NewtonIteration) -> None:
        seconds = time.perf_counter() - ready
        say(f"load {it.load:.4g}, step {it.step:.4g}: residual {it.residual:.2e}, {seconds:.0f} s")

    result = dd.solve_law(operator, law, conditions, steps=steps, options=options, progress=progress)
    done = time.perf_counter()

    dd.write_solution(out, result, stress_measure=MEASURE)
    numbers = law.effort.numbers()
    _, asked, solves, iterations, factorisations, seconds_rve = total(comm, numbers)
    slowest = comm.allreduce(float(numbers[-1]), MPI.MAX)
    figures = {
        **result.figures(),
        "top_force": (float(result.reactions["top"][LOADS[scene.load]]), "N"),
        "rve_solves": (int(solves), ""),
        "rve_states_asked": (int(asked), ""),
        "rve_newton_iterations": (int(iterations), ""),
        "rve_factorisations": (int(factorisations), ""),
        "rve_unknowns": (law.rve.solver.newton.pattern.size, ""),
        "rve_linear_solver": (law.rve.solver.newton.choice.backend, ""),
        "unstable_rves": (int(total(comm, law.unstable)), ""),
        "stress_measure": (MEASURE, ""),
        "seconds": (done - begin, "s"),
        "seconds_setup": (ready - begin, "s"),
        "seconds_rve": (slowest, "s"),
        "seconds_rve_all_ranks": (float(seconds_rve), "s"),
        "rank_imbalance": (slowest * comm.size / float(seconds_rve), "slowest rank over mean"),
        "peak_memory": (comm.allreduce(peak_memory(), MPI.MAX), "B"),
    }
    parameters = {
        **scene.parameters(),
        "bar_force": bar_force,
        "steps": steps,
    }
    summary = None
    if comm.rank == 0:
        summary = write_summary(out, command="fe2", parameters=parameters, figures=figures)
        if plots:
            _draw(out, result.history)
    return comm.bcast(summary)


def _draw(out: Path, history: tuple[dd.NewtonIteration, ...]) -> None:
    """Figures from the written file; rank 0 only, nothing is gathered."""
    from dd_macro.results.figures import plot_newton
    from tsg_micro.data.figure_style import plot_maps, save_figure

    fields = dd.read_quadrature(out / "quadrature.h5")
    maps = {
        "pressure $p$": (fields.cell_mean(fields.mechanical_p), "Pa"),
        "effective stress $q$": (fields.cell_mean(fields.mechanical_q), "Pa"),
    }
    save_figure(plot_maps(fields.corners[:, :4, :2], maps), out / "fields.png")
    save_figure(plot_newton(history), out / "convergence.png")
