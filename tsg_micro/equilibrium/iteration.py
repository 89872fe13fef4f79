"""What Newton's method is told, and what it tells: options, one iteration, an equilibrium."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.equilibrium.members import MemberState
from tsg_micro.equilibrium.tangent import Tangent

__all__ = ["Converged", "Iteration", "NewtonOptions"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NewtonOptions:
    """When an equilibrium is good enough, and how far one iteration may go."""

    tolerance: float = 1e-10
    """Largest out-of-balance force over the mean member force."""
    max_iterations: int = 100
    """Few are needed but on the way out of an unstable equilibrium, down a narrow valley of the energy."""
    max_elongation: float = 0.02
    """Largest change of a member's length in one iteration, over its length."""
    smallest_part: float = 1.0 / 256.0
    """Of a load step, below which the equilibrium counts as lost."""
    linear_solver: str = "auto"
    """Of the factorisations: superlu, pardiso, mumps, or what suits the size and is installed."""

    def __post_init__(self) -> None:
        for name in ("tolerance", "max_elongation", "max_iterations", "smallest_part"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name}: expected a positive number, got {getattr(self, name)}")


@dataclass(frozen=True)
class Iteration:
    """One Newton iteration; ``load`` is the fraction of the load step that it belongs to."""

    load: float
    residual: float
    """Largest out-of-balance force over the mean member force, before the iteration."""
    step_length: float
    shift: float
    """Multiple of the unit matrix added to K, N/m."""
    negative_pivots: int
    """Of K before any shift; 0 where an older factor served and met no negative stiffness."""
    energy: float


@dataclass(frozen=True)
class Converged:
    """An equilibrium: the point, its members, and the price."""

    y: Array
    state: MemberState
    gradient: Array
    multipliers: Array
    residual: float
    iterations: int
    tangent: Tangent | None
    """The factorised tangent at y, where it was asked for."""
