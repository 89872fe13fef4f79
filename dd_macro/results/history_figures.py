"""How a solution was found, as figures; a method with a result of its own registers what it draws."""

from __future__ import annotations

from functools import singledispatch

import numpy as np
from matplotlib.figure import Figure

from dd_macro.methods.adaptive import AdaptiveResult
from dd_macro.methods.points import DataDrivenResult
from dd_macro.methods.reference import ReferenceResult
from dd_macro.methods.solution import Solution
from dd_macro.results.figures import ROUNDS, plot_convergence, plot_newton, plot_rounds

__all__ = ["history_figures"]


@singledispatch
def history_figures(solution: Solution) -> dict[str, Figure]:
    """Figures by the name of their file."""
    return {}


@history_figures.register
def _with_data(solution: DataDrivenResult) -> dict[str, Figure]:
    history = solution.history
    whole = solution.distance / solution.normalised_distance if solution.normalised_distance > 0.0 else np.inf
    distance = [i.distance / whole for i in history]
    figure = plot_convergence(distance, [i.changed for i in history], [i.omega for i in history])
    return {"convergence": figure}


@history_figures.register
def _adaptive(solution: AdaptiveResult) -> dict[str, Figure]:
    rounds = {name: [getattr(one, name) for one in solution.rounds] for name in ROUNDS}
    return {**_with_data(solution), "adaptation": plot_rounds([one.data for one in solution.rounds], rounds)}


@history_figures.register
def _with_law(solution: ReferenceResult) -> dict[str, Figure]:
    return {"convergence": plot_newton(solution.history)}
