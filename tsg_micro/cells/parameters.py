"""Geometry and stiffness of one cell, with the values of the paper's Table 1 as defaults."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsg_micro.data.errors import InputError

__all__ = ["TABLE_1", "CellParameters", "check_bar_force"]


_LENGTHS, _MODULI = (1e-12, 1e3, "m"), (1e-6, 1e15, "Pa")
"""Beyond which numbers are mistakes, whose products are none any more."""


@dataclass(frozen=True)
class CellParameters:
    """One truncated-octahedron cell: shape, size and members (paper, Table 1), SI units.

    Raises:
        InputError: on construction, where a value is not positive, r is outside (0, 1), or a length or a modulus is one
            that no member has (below 1 pm, above 1 km; below 1 uPa, above 1e15 Pa).

    Example:
        >>> cell = tsg.CellParameters(height=8e-6)
        >>> round(1e6 * cell.EA_tendon, 3)
        7.854
    """

    half_diagonal: float = 0.5
    """Half-diagonal r of a square face over half the cell height, in (0, 1)."""
    height: float = 10e-6
    """Cell height h, m."""
    E_bar: float = 1.2e9
    """Young's modulus of bars, Pa."""
    E_tendon: float = 10e6
    """Young's modulus of tendons, Pa."""
    d_bar: float = 0.1e-6
    """Diameter of bars, m."""
    d_tendon: float = 1e-6
    """Diameter of tendons, m."""

    def __post_init__(self) -> None:
        if not 0.0 < self.half_diagonal < 1.0:
            raise InputError(f"half_diagonal r: expected a number in (0, 1), got {self.half_diagonal}")
        for name, value in asdict(self).items():
            if not (value > 0.0 and math.isfinite(value)):
                raise InputError(f"{name}: expected a positive number, got {value}")
            least, most, unit = _MODULI if name.startswith("E_") else _LENGTHS
            if not least <= value <= most and name != "half_diagonal":
                raise InputError(f"{name}: expected {least:g} to {most:g} {unit}, got {value}")

    @property
    def EA_bar(self) -> float:
        """Axial stiffness of a bar, N."""
        return self.E_bar * math.pi * self.d_bar**2 / 4.0

    @property
    def EA_tendon(self) -> float:
        """Axial stiffness of a tendon, N."""
        return self.E_tendon * math.pi * self.d_tendon**2 / 4.0


TABLE_1 = CellParameters()
"""The paper's cell."""


def check_bar_force(bar_force: ArrayLike, *, cells: int, EA_bar: float) -> NDArray[np.float64]:
    """Bar forces f_b as one positive number per cell (cells,), N.

    Raises:
        InputError: not a scalar or one per cell, not positive and finite, or beyond what a bar can carry.
    """
    try:
        f = np.asarray(bar_force, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"bar_force: expected numbers in N, got {bar_force!r}") from None
    if f.shape not in ((), (cells,)):
        raise InputError(f"bar_force: expected one number or one per cell ({cells}), got shape {f.shape}")
    if not (np.isfinite(f).all() and (f > 0.0).all()):
        raise InputError(f"bar_force: expected positive forces in N (compression of the bars), got {f.min()}")
    if (f >= EA_bar).any():
        raise InputError(f"bar_force: expected less than the bar stiffness EA = {EA_bar:.3g} N, got {f.max():.3g} N")
    return np.broadcast_to(f, (cells,))
