"""The solution with a law, and how Newton's method finds it (dd_macro.methods.newton)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dd_macro.methods.solution import Solution
from tsg_micro.data.errors import InputError

__all__ = ["NewtonIteration", "ReferenceOptions", "ReferenceResult"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReferenceOptions:
    """How Newton's method runs.

    ``tolerance`` is the out-of-balance force on the free components over that of supports and loads, below which a
    load step has converged; ``max_iterations`` bounds the iterations of a load step, ``max_halvings`` those of a
    Newton step, and ``max_cuts`` the number of times that the load step is halved.

    Raises:
        InputError: on construction, where a value is out of range.
    """

    tolerance: float = 1e-9
    max_iterations: int = 25
    max_halvings: int = 8
    max_cuts: int = 6

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1:
            raise InputError(f"tolerance: expected a number between 0 and 1, got {self.tolerance}")
        for name, least in (("max_iterations", 1), ("max_halvings", 0), ("max_cuts", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{name}: expected at least {least}, got {getattr(self, name)}")


@dataclass(frozen=True)
class NewtonIteration:
    """One linear solve: the fraction of the load, how much of the step was taken, and where that led.

    ``residual`` is relative (ReferenceOptions.tolerance); ``negative_pivots`` are those of the tangent that was solved
    with, None where the linear solver does not count them.
    """

    load: float
    step: float
    residual: float
    negative_pivots: int | None


@dataclass(frozen=True, kw_only=True, repr=False)
class ReferenceResult(Solution):
    """The solution with a law, whose states are the mechanical ones; eta is zero.

    ``tangent`` (n, 6, 6) in Pa is the law's there, and ``reactions`` the force (3,) in N on the body by side with a
    prescribed displacement. ``iterations`` counts the linear solves, ``load_steps`` the load steps that converged.
    """

    tangent: Array
    reactions: dict[str, Array]
    residual: float
    load_steps: int
    history: tuple[NewtonIteration, ...]

    @property
    def note(self) -> str:
        """How it went."""
        return f"{self.iterations} Newton iterations"

    def figures(self) -> dict[str, tuple[Any, str]]:
        """Numbers of the solution for a summary, each with its unit; collective."""
        return super().figures() | {
            "load_steps": (self.load_steps, ""),
            "residual": (self.residual, "force of the supports"),
            "residual_history": ([i.residual for i in self.history], "force of the supports"),
            "load_history": ([i.load for i in self.history], ""),
            "step_history": ([i.step for i in self.history], ""),
        }
