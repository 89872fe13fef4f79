"""Adaptive sampling: the problem decides at which strains data are computed, from a single datum or none on."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from dd_macro.methods.adaptive_rounds import Adaptation, Round, Rounds
from dd_macro.methods.method import SILENT, Material, Watch, with_iterations
from dd_macro.methods.projection import MechanicalState, Projection
from dd_macro.methods.second_order import SecondOrderOptions, SecondOrderResult
from dd_macro.parallel import one_thread
from dd_macro.scene.problem import Problem
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["AdaptiveMethod", "AdaptiveResult", "PreparedAdaptive"]

Array = NDArray[np.float64]
_HOLD_AFTER = 8
"""Points still between two data after so many searches of the last solve do not matter to the error."""


@dataclass(frozen=True, kw_only=True, repr=False)
class AdaptiveResult(SecondOrderResult):
    """The last solve and the data that it used; all rounds, and why they ended."""

    rounds: tuple[Round, ...]
    adapt_reason: str
    seconds_steps: float = 0.0
    """What the linear solves of the rounds took, s."""
    part_data: tuple[Dataset, ...] = ()
    """The data of every part of the material, in their order."""

    @property
    def note(self) -> str:
        """How it went."""
        return f"{len(self.rounds)} rounds, {sum(r.iterations for r in self.rounds)} iterations"

    def figures(self) -> dict[str, tuple[Any, str]]:
        """Numbers of the solution for a summary, with the history, one number a round; collective."""
        last = self.rounds[-1]
        units = {"change": "1", "error": "1", "gap": "1", "surprise": "1", "seconds_rve": "s", "seconds": "s"}
        history = {
            f"{name}_rounds": ([getattr(r, name) for r in self.rounds], units.get(name, "")) for name in asdict(last)
        }
        ends = {"adapt_reason": (self.adapt_reason, ""), "rves": (last.rves, ""), "failed_rves": (last.failed, "")}
        costs = {"estimated_error": (last.error, "1"), "seconds_rve": (last.seconds_rve, "s")}
        found = super().figures()
        found["seconds_linear_solves"] = (found["seconds_linear_solves"][0] + self.seconds_steps, "s")
        return found | ends | costs | history


@dataclass(frozen=True)
class AdaptiveMethod:
    """Data as tangent spaces, and more of them from the source of the material.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))])
        >>> tissue = tsg.Tissue(bar_force=1e-8)
        >>> material = dd.Material(source=tsg.RVESource(tsg.RVESpec.of_kind("sheet", tissue)))
        >>> solution = dd.AdaptiveMethod(dd.Adaptation(budget=20)).prepare(problem, material).solve()
        >>> f"{solution.reaction('top')[1]:.1e}"
        '3.0e-08'
    """

    plan: Adaptation = field(default_factory=Adaptation)
    options: SecondOrderOptions = field(default_factory=SecondOrderOptions)
    theories: tuple[str, ...] = ("small", "finite")
    variant_of: str = ""

    def prepare(
        self, problem: Problem, material: Material, *, projection: Projection | None = None
    ) -> PreparedAdaptive:
        """Nothing is made before the first data are there; see dd_macro.Method."""
        for part in material.each:
            if part.source is None:
                raise InputError("material: expected a source of data, got none")
            if part.dataset is not None and part.dataset.tangent is None:
                raise InputError("data: expected tangents for --adapt, got none")
        return PreparedAdaptive(self, problem, material)

    def tuned(self, *, max_iterations: int | None = None, over_relaxation: float | None = None) -> Self:
        """See dd_macro.Method."""
        return with_iterations(self, max_iterations, over_relaxation)


@dataclass(frozen=True, eq=False)
class PreparedAdaptive:
    """A problem, and its material with the sources of its data."""

    method: AdaptiveMethod
    problem: Problem
    material: Material
    text: str = ""
    seconds_metric: float = 0.0

    @one_thread
    def solve(self, start: MechanicalState | None = None, watch: Watch = SILENT) -> AdaptiveResult:
        """The solution; ``watch.keep`` gets the data of every round. It does not depend on the number of ranks.

        Raises:
            InputError: the measure does not fit the data.
            ConvergenceError: a solve failed; the data until then were kept.
        """
        begin, plan = time.perf_counter(), self.method.plan
        rounds = Rounds(self.problem, self.material, plan, start)
        data = rounds.data
        while not rounds.reason:
            known = data.all
            watch.keep(known)
            numbers = rounds.step(known)
            error = numbers["error"]
            told = f": estimated error {error:.2e}" if error is not None else ""
            watch.say(f"{data.rves} RVEs, {len(known)} data{told}")
            watch.done(_part_done(plan, data.rves, error))
            if error is not None and error <= plan.tolerance:
                rounds.reason = "estimated error reached"
            elif data.rves >= plan.budget:
                rounds.reason = "RVE budget used"
            else:
                rounds.grow(known)
            if rounds.reason:
                options = replace(self.method.options, hold_after=_HOLD_AFTER)
                result = rounds.finish(options)
                numbers["iterations"] += result.iterations
            rounds.done.append(Round(**numbers, seconds=time.perf_counter() - begin))
        found = {f.name: getattr(result, f.name) for f in fields(result)}
        parts = tuple(part.all for part in data.parts)
        found |= {"rounds": tuple(rounds.done), "adapt_reason": rounds.reason, "part_data": parts}
        return AdaptiveResult(**found, seconds_steps=rounds.seconds)


def _part_done(plan: Adaptation, rves: int, error: float | None) -> float:
    """The part of the budget that is used, or of the way of the error down to the tolerance, as far as either is."""
    near = 0.0
    if error is not None and error < 1.0 and plan.tolerance > 0.0:
        near = math.log(max(error, plan.tolerance)) / math.log(plan.tolerance)
    return min(max(rves / plan.budget, near), 1.0)
