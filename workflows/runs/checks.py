"""What is said of a solution: its error, estimated by RVEs at strains that it visits, and warnings with remedies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import dd_macro as dd
from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.errors import ConvergenceError, InputError
from workflows.runs.cautions import body_cautions, scatter_caution
from workflows.runs.edges import specs_of
from workflows.runs.materials import TissueData, point_bar_forces, scene_sources
from workflows.runs.scene import Scene
from workflows.scenes.scene import Built

__all__ = ["LARGE_DISTANCE", "LARGE_ERROR", "Verdict", "check_limit", "estimate_error", "judge", "judge_scene"]

LARGE_ERROR, LARGE_DISTANCE = 0.05, 0.05
"""Estimated error, and where there is none normalised distance, beyond which a run warns."""
_KEYS = {
    "--rve-budget": "solve.budget",
    "--kinematics finite": 'solve.kinematics = "finite"',
    "--order 2": 'solve.method = "tangents"',
    "--adapt": 'solve.method = "adaptive"',
    "--kind bulk": 'kind = "bulk"',
    "--kind sheet": 'kind = "sheet"',
    "--element enhanced": 'solve.element = "enhanced"',
    "--degree 2": "solve.degree = 2",
}
"""Options, and the keys of scene files that say the same."""


@dataclass(frozen=True)
class Verdict:
    """The estimate of the error, the ``line`` that tells it, and what is to be said against the solution."""

    estimate: dd.ErrorEstimate
    line: str
    warnings: list[str]
    limit: float | None = None

    @property
    def within_limit(self) -> bool | None:
        """Whether the error is known to be no more than was asked for; None where nothing was."""
        error = self.estimate.error
        return None if self.limit is None else error is not None and error <= self.limit

    def figures(self) -> dict[str, tuple[Any, str]]:
        """For the summary, each with its unit."""
        return self.estimate.figures() | {"within_max_error": (self.within_limit, ""), "warnings": (self.warnings, "")}

    def enforce(self) -> None:
        """Raise ConvergenceError where the error is not known to be within the limit."""
        if self.within_limit is not False:
            return
        error = self.estimate.error
        got = "no estimate" if error is None else f"{error:.1%}"
        why = f": {self.warnings[0]}" if self.warnings else ""
        raise ConvergenceError(
            f"estimated error: expected at most {self.limit:.1%} (--max-error), got {got}; the results are written, "
            f"and their summary says so{why}"
        )


def check_limit(limit: float | None) -> None:
    """Raise InputError where the largest error that is wanted is no positive number."""
    if limit is not None and not (math.isfinite(limit) and limit > 0):
        raise InputError(f"max_error: expected a positive number, got {limit}")


def judge(solution: dd.Solution, scene: Scene, rve: RVESpec | None, limit: float | None = None) -> Verdict:
    """Estimate the error of ``solution`` and say what is to be said; ``rve`` is that of its inside; collective.

    Where the data do not say of one tissue alone that they are from, they are held against each other instead.

    Raises:
        InputError: what the data say of their RVE is not valid.
    """
    rve = rve if _of_one_tissue(solution) else None
    estimate = estimate_error(solution, None if rve is None else specs_of(rve, solution.problem))
    figures = solution.figures()
    warnings = _of_the_data(estimate, figures)
    warnings += body_cautions(solution.problem, rve, bends=scene.bends, trilinear=scene.trilinear)
    warnings += scatter_caution(solution)
    return Verdict(estimate, _line(estimate, figures), warnings, limit)


def judge_scene(
    built: Built, known: Sequence[TissueData], solution: dd.Solution, limit: float | None = None
) -> Verdict | None:
    """The same of the solution of a scene file; None where its material is a law that needs no data; collective."""
    if solution.dataset is None:
        return None
    sources = scene_sources(built, known, solution.problem)
    if sources is None:
        estimate = dd.check_by_data(solution)
    else:
        estimate = dd.check_by_source(solution, sources, bar_force=point_bar_forces(built, solution.problem))
    figures, solve = solution.figures(), built.model.solve
    warnings = _of_the_data(estimate, figures)
    trilinear = solve.degree == 1 and solve.element == "trilinear"
    for rve in {one.rve for one in known}:
        warnings += body_cautions(solution.problem, rve, bends=(0, 1, 2), trilinear=trilinear)
    warnings = [_in_keys(text) for text in dict.fromkeys(warnings)] + scatter_caution(solution)
    return Verdict(estimate, _line(estimate, figures), warnings, limit)


def _in_keys(text: str) -> str:
    """A warning that names options, in the keys of a scene file."""
    for option, key in _KEYS.items():
        text = text.replace(option, key)
    return text


def _of_one_tissue(solution: dd.Solution) -> bool:
    assert solution.dataset is not None
    specs = [RVESpec.from_parameters(source) for source in solution.dataset.sources]
    return all(spec is not None for spec in specs) and len({(s.tissue, s.images) for s in specs if s is not None}) == 1


def estimate_error(solution: dd.Solution, specs: Sequence[RVESpec] | None) -> dd.ErrorEstimate:
    """The error by a few RVEs of ``specs``, one for each region of the problem; by the data where it is None.

    There is none yet where the bar force of the tissue varies from point to point.

    Raises:
        InputError: the stress of the data cannot be had of the RVEs.
    """
    if solution.dataset is not None and solution.dataset.bar_force is not None:
        return dd.ErrorEstimate(None, "the bar force varies")
    if specs is None:
        return dd.check_by_data(solution)
    comm = solution.problem.operator.comm
    return dd.check_by_source(solution, [RVESource(spec, comm=comm) for spec in specs])


def _line(estimate: dd.ErrorEstimate, figures: Mapping[str, tuple[Any, str]]) -> str:
    """What one wants to know of a solution, in a line."""
    error = "unknown" if estimate.error is None else f"{estimate.error:.2%}"
    parts = [f"estimated error {error} ({estimate.kind})"]
    for name, text in (("extrapolated", "extrapolated"), ("outside_data", "outside the data")):
        if name in figures:
            parts.append(f"{text} {figures[name][0]:.1%}")
    if "held" in figures:
        parts.append(f"held {figures['held'][0]}")
    return ", ".join(parts)


def _of_the_data(estimate: dd.ErrorEstimate, figures: Mapping[str, tuple[Any, str]]) -> list[str]:
    """That the data do not do, and what helps."""
    found = []
    if "adapt_reason" in figures:
        remedy = "a larger --rve-budget lowers it, beyond a strain of some 10 % --kinematics finite too"
    elif "extrapolated" in figures:
        remedy = "more data where the scene is, or --adapt, which computes them there, lower it"
    else:
        remedy = "more data where the scene is, --order 2 or --adapt lower it"
    error, distance = estimate.error, figures["normalised_distance"][0]
    if error is not None and error > LARGE_ERROR:
        found.append(f"the data leave an estimated error of {error:.1%}: {remedy}")
    elif error is None and distance > LARGE_DISTANCE:
        found.append(
            f"mechanical and material states are {distance:.1%} apart, the data do not hold what this scene needs: "
            f"{remedy}"
        )
    if estimate.failed:
        found.append(
            f"the tissue has no equilibrium at {estimate.failed} of {estimate.checks} strains that were checked: "
            "the scene goes beyond what it bears"
        )
    return found
