"""Whether a path of equilibria turns back: a limit point of the load, beyond which there is none nearby.

From the last equilibrium the path is followed by its arc length, with the fraction s of the load as one more unknown:
each step goes along the tangent (dy, ds), scaled by the size of the body, and is corrected in the plane across it. At a
limit point ds changes its sign, while the bordered system stays regular.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import ConvergenceError
from tsg_micro.equilibrium.newton import NewtonSolver
from tsg_micro.equilibrium.tangent import Tangent

__all__ = ["LoadLine", "find_limit"]

Array = NDArray[np.float64]
_STEPS, _CORRECTIONS, _HALVINGS = 30, 12, 4


class LoadLine(NamedTuple):
    """A load that grows along a straight line, from s = 0 to 1."""

    start: Array
    """Nodal forces (3n,) at s = 0, N."""
    force: Array
    """What is added to them up to s = 1, N."""
    rate: Callable[[Array, Tangent], Array]
    """Derivative (3n + 9,) of all unknowns by s at the unknowns y, with the tangent there."""
    press: Callable[[float], None]
    """Set the pressure of the system to that at s."""


def find_limit(newton: NewtonSolver, line: LoadLine, y: Array, s: float, part: float) -> float | None:
    """The largest fraction of the load on the path from the equilibrium ``y`` (3n + 9,) at ``s``, if it turns back.

    ``part`` is the fraction that was tried last. None where no limit point is found; the pressure is then any.
    """
    try:
        return _follow(newton, line, y, s, part)
    except (ConvergenceError, np.linalg.LinAlgError):
        return None


def _follow(newton: NewtonSolver, line: LoadLine, y: Array, s: float, part: float) -> float | None:
    size = newton.system.structure.size.max()
    line.press(s)
    rate = line.rate(y, newton.tangent(newton.system.state(y)))
    along, forward = rate / size, 1.0
    length = part * float(np.hypot(np.linalg.norm(along), 1.0))
    largest = s
    for _ in range(_STEPS):
        norm = float(np.hypot(np.linalg.norm(along), forward))
        along, forward = along / norm, forward / norm
        for _ in range(_HALVINGS):
            found = _correct(newton, line, y + length * size * along, s + length * forward, along, forward)
            if found is not None:
                break
            length *= 0.5
        else:
            return None
        y, s, rate = found
        largest = max(largest, s)
        turned = 1.0 if along @ rate / size + forward >= 0.0 else -1.0
        along, forward = turned * rate / size, turned
        if forward < 0.0:
            return largest
        if s >= 1.0:
            return None
        length *= 1.5
    return None


def _correct(
    newton: NewtonSolver, line: LoadLine, y: Array, s: float, along: Array, forward: float
) -> tuple[Array, float, Array] | None:
    """Equilibrium in the plane through (y, s) across (along, forward), and the rate there; None if not found."""
    system, size = newton.system, newton.system.structure.size.max()
    for _ in range(_CORRECTIONS):
        line.press(s)
        state = system.state(y)
        nodal, rest, residual = newton.out_of_balance(y, state, line.start + s * line.force)
        if not np.isfinite(residual):
            return None
        tangent = newton.tangent(state)
        rate = line.rate(y, tangent)
        if residual <= 1e3 * newton.options.tolerance:
            return y, s, rate
        step = newton.spread(*tangent.solve(nodal, rest))
        ds = -float(along @ step) / float(along @ rate + size * forward)
        y, s = y + step + ds * rate, s + ds
    return None
