"""How far along a direction: as members allow, and as the energy falls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tsg_micro.equilibrium.members import MemberState, MemberSystem

__all__ = ["elongation_limit", "leave_saddle", "line_search"]

Array = NDArray[np.float64]


def elongation_limit(system: MemberSystem, step: Array, state: MemberState, *, max_elongation: float) -> Array:
    """The multiple of ``step`` (3n + 9,) at which some member's length changes by the part ``max_elongation`` of it.

    Of many states, a step (3n + 9, b) of each, it is (b,).
    """
    change = (system.D @ step).reshape(state.vector.shape)
    along = np.abs((change * state.vector).sum(axis=1)) / state.length
    turn = (change * change).sum(axis=1) / (2.0 * state.length)
    limit = max_elongation * state.length
    # along a + turn a^2 = limit, in the form that does not cancel
    return np.min(2.0 * limit / np.maximum(along + np.sqrt(along**2 + 4.0 * turn * limit), 1e-300), axis=0)


def line_search(
    system: MemberSystem, y: Array, step: Array, pull: Array, state: MemberState, slope: float, *, max_elongation: float
) -> float:
    """Length of ``step`` (3n + 9,) from ``y``: limited in elongation, then where the energy's slope has fallen enough.

    ``slope`` is that at ``y``, whose members are ``state``, negative; ``pull`` as of :func:`leave_saddle`.
    """
    high = min(1.0, float(elongation_limit(system, step, state, max_elongation=max_elongation)))
    low, low_slope, length = 0.0, slope, high
    for _ in range(12):
        here = float((system.gradient(system.state(y + length * step)) - pull) @ step)
        if abs(here) <= 0.5 * abs(slope) or (here < 0.0 and length == high):
            return length
        if here < 0.0:
            low, low_slope = length, here
            length = min(high, 0.5 * (length + high))
        else:
            high = length
            secant = low - low_slope * (length - low) / (here - low_slope)
            length = float(np.clip(secant, low + 0.1 * (length - low), low + 0.9 * (length - low)))
    return length


def leave_saddle(
    system: MemberSystem, y: Array, modes: list[tuple[Array, float]], pull: Array, *, max_elongation: float
) -> Array:
    """Unknowns ``y`` (3n + 9,) moved along the lowest mode as far as the energy falls and the elongation limit allows.

    ``modes`` (3n + 9,) come with their stiffness, N/m, lowest first; ``pull`` (3n + 9,) is what loads and constraints
    do, N. ``y`` itself where there is no mode, or the energy does not fall along it (a neutral motion).
    """
    if not modes:
        return y
    mode, _ = modes[0]
    state = system.state(y)
    if np.vdot(mode, system.tangent_product(state, mode[:, None])[:, 0]) >= 0.0:
        return y
    if (system.gradient(state) - pull) @ mode > 0.0:
        mode = -mode
    largest = np.abs(mode).max()
    farthest = float(elongation_limit(system, mode / largest, state, max_elongation=max_elongation) / largest)
    best, length = 0.0, farthest / 1024.0
    while length <= farthest:
        if (system.gradient(system.state(y + length * mode)) - pull) @ mode >= 0.0:
            break
        best, length = length, 2.0 * length
    return y + best * mode if best else y
