"""The paper's two macroscopic loads (Section 4.2): the bottom side (y = 0) is held, the top side is moved."""

from __future__ import annotations

import math

from tsg_micro.data.errors import InputError

__all__ = ["LOADS", "SYMBOLS", "check_load", "check_reach", "nominal_component", "top_displacement"]

LOADS = {"stretch": 1, "shear": 0}
"""Load to the axis along which the top side moves; its other displacements are zero."""


SYMBOLS = {"stretch": "p", "shear": "q"}
"""The stress that a load is judged by (paper, Section 4.2): pressure p or effective stress q."""


def check_load(load: str, strain: float) -> None:
    """Raise InputError where the load is unknown, or its strain is zero, not finite or beyond -0.5 .. 1."""
    if load not in LOADS:
        raise InputError(f"load: expected {' or '.join(LOADS)}, got {load!r}")
    if not (math.isfinite(strain) and strain != 0.0 and -0.5 < strain < 1.0):
        raise InputError(f"strain: expected a number between -0.5 and 1 other than 0, got {strain}")


def top_displacement(load: str, strain: float, height: float) -> tuple[float, float, float]:
    """Displacement of the top side, m: ``strain`` times the ``height`` of the sheet along y."""
    u = [0.0, 0.0, 0.0]
    u[LOADS[load]] = strain * height
    return (u[0], u[1], u[2])


def nominal_component(load: str, strain: float) -> tuple[str, float]:
    """Name and value of the tensor component of the small strain that the load would cause if it were homogeneous."""
    return ("yy", strain) if load == "stretch" else ("xy", 0.5 * strain)


def check_reach(name: str, value: float, low: float, high: float) -> None:
    """Raise InputError where the nominal strain component is outside the range of the data."""
    if not low <= value <= high:
        raise InputError(
            f"strain: expected a nominal eps_{name} within the data's range [{low:.4g}, {high:.4g}], got {value:.4g}"
        )
