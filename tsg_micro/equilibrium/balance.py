"""What loads and constraints leave out of balance: forces on the free unknowns, and how much they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tsg_micro.equilibrium.members import MemberState, MemberSystem
from tsg_micro.equilibrium.tangent import Border

__all__ = ["Balance", "times"]

Array = NDArray[np.float64]


class Balance:
    """Balance of the ``free`` nodal unknowns (numbers) and of the border; of many states, arrays have a last axis."""

    def __init__(self, system: MemberSystem, free: NDArray[np.int64], border: Border, tolerance: float) -> None:
        self.system, self.free, self.border, self.tolerance = system, free, border, tolerance
        a, m = border.constraint, system.nodal_size
        lever = np.concatenate([a[:, free].T, (a[:, m:] @ border.macro).T, np.zeros((len(a), len(a)))])
        self._best = np.linalg.pinv(lever)

    def residual(self, y: Array, gradient: Array, force: Array, multipliers: Array) -> tuple[Array, Array, Array]:
        """Out-of-balance forces on the free nodal unknowns, N; on the border, and what the constraints lack of zero.

        With them come the multipliers that balance the present forces best; those given are where they start.
        """
        nodal, rest = self._residual(y, gradient, force, multipliers)
        if len(multipliers):
            multipliers = multipliers + times(self._best, np.concatenate([nodal, rest]))
            nodal, rest = self._residual(y, gradient, force, multipliers)
        return nodal, rest, multipliers

    def _residual(self, y: Array, gradient: Array, force: Array, multipliers: Array) -> tuple[Array, Array]:
        m = self.system.nodal_size
        balance = gradient + times(self.border.constraint.T, multipliers)
        nodal = force - balance[:m]
        macro = -times(self.border.macro.T, balance[m:])
        return nodal[self.free], np.concatenate([macro, -times(self.border.constraint, y)])

    def measure(self, nodal: Array, rest: Array, state: MemberState) -> Array:
        """Residual relative to the mean member force; the macroscopic part is divided by the box size.

        A constraint that is off by 1e-12 of the box counts like a force that is off by the tolerance.
        """
        scale, length = np.abs(state.force).mean(axis=0), self.system.structure.size.max()
        macro, drift = (np.abs(part).max(axis=0, initial=0.0) for part in np.split(rest, [self.border.macro.shape[1]]))
        largest = np.maximum(np.abs(nodal).max(axis=0, initial=0.0), macro / length)
        relative = np.where(scale > 0.0, largest / np.where(scale > 0.0, scale, 1.0), largest > 0.0)
        return np.maximum(relative, self.tolerance * drift / (1e-12 * length))


def times(matrix: Array, x: Array) -> Array:
    """``matrix`` times a vector, or many (k, b), each alone: round-off does not depend on those beside it."""
    if x.ndim == 1:
        return np.asarray(matrix @ x)
    return np.ascontiguousarray((matrix @ np.ascontiguousarray(x.T)[:, :, None])[:, :, 0].T)
