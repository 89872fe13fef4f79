"""Newton's method with a law: one that is fitted to the data, or one that is given, as RVEs in FE2."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Self

from dd_macro.material.laws import Law
from dd_macro.material.regional import RegionalLaw
from dd_macro.methods.method import SILENT, Material, Watch, with_iterations
from dd_macro.methods.newton import equilibrium
from dd_macro.methods.projection import MechanicalState, Projection
from dd_macro.methods.reference import NewtonIteration, ReferenceOptions, ReferenceResult
from dd_macro.scene.problem import Problem
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["LawMethod", "PreparedLaw"]


@dataclass(frozen=True)
class LawMethod:
    """``fit`` makes the law of the data; None takes the law of the material. The load is applied in ``steps`` parts.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))])
        >>> law = dd.LinearLaw(dd.isotropic(young=1e3, poisson=0.3).C)
        >>> solution = dd.LawMethod().prepare(problem, dd.Material(law=law)).solve()
        >>> f"{solution.reaction('top')[1]:.3e}"
        '2.226e-08'
    """

    fit: Callable[[Dataset], Law] | None = None
    steps: int = 1
    options: ReferenceOptions = field(default_factory=ReferenceOptions)
    theories: tuple[str, ...] = ("small", "finite")
    variant_of: str = ""

    def prepare(self, problem: Problem, material: Material, *, projection: Projection | None = None) -> PreparedLaw:
        """The law; see dd_macro.Method."""
        laws = [self._law(part) for part in material.each]
        law = laws[0] if len(laws) == 1 else RegionalLaw(laws, problem.region_of_points)
        return PreparedLaw(self, problem, law, None if self.fit is None else material.dataset)

    def _law(self, material: Material) -> Law:
        if self.fit is not None:
            return self.fit(material.data())
        if material.law is None:
            raise InputError("material: expected a law, got none")
        return material.law

    def tuned(self, *, max_iterations: int | None = None, over_relaxation: float | None = None) -> Self:
        """See dd_macro.Method; iterations are those of a load step."""
        return with_iterations(self, max_iterations, over_relaxation)


@dataclass(frozen=True, eq=False)
class PreparedLaw:
    """A problem with a law."""

    method: LawMethod
    problem: Problem
    law: Law
    dataset: Dataset | None
    text: str = ""
    seconds_metric: float = 0.0

    def solve(
        self, start: MechanicalState | None = None, watch: Watch = SILENT, *, start_factor: float = 0.0
    ) -> ReferenceResult:
        """The solution, from rest, or from ``start`` that is in equilibrium under the part ``start_factor``."""
        method = self.method
        begin, reached = time.perf_counter(), [start_factor, start_factor]  # before the last load, and at it

        def progress(it: NewtonIteration) -> None:
            seconds = time.perf_counter() - begin
            if it.load != reached[1]:  # a step that was halved begins where it did before
                reached[:] = reached[it.load > reached[1]], it.load
            near = math.log(min(max(it.residual, method.options.tolerance), 1.0)) / math.log(method.options.tolerance)
            watch.done(reached[0] + (reached[1] - reached[0]) * near)
            watch.say(f"load {it.load:.4g}, step length {it.step:.4g}: residual {it.residual:.2e}, {seconds:.0f} s")

        given = None if start is None or start_factor == 0.0 else (start_factor, start.u)
        result = equilibrium(
            self.problem, self.law, steps=method.steps, start=given, options=method.options, progress=progress
        )
        return replace(result, dataset=self.dataset)
