"""The macroscopic loads by name (paper, Section 4.2): the bottom side (y = 0) is held, the top side is moved."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tsg_micro.data.errors import InputError

__all__ = ["LOADS", "SheetLoad", "check_load", "check_reach"]


@dataclass(frozen=True)
class SheetLoad:
    """The top side moves along ``axis`` by the strain times the height of the sheet; its other displacements are zero.

    The load is judged by ``symbol``, pressure p or effective stress q. If it were homogeneous, ``component`` of the
    small strain would be ``share`` of the strain; ``box`` of tsg_micro.BOXES has data for it.
    """

    axis: int
    symbol: str
    component: str
    share: float
    box: str

    def top_displacement(self, strain: float, height: float) -> tuple[float, float, float]:
        """Displacement of the top side, m: ``strain`` times the ``height`` of the sheet along y."""
        u = [0.0, 0.0, 0.0]
        u[self.axis] = strain * height
        return (u[0], u[1], u[2])

    def nominal(self, strain: float) -> float:
        """Value of the tensor component of the small strain."""
        return self.share * strain


LOADS = {
    "stretch": SheetLoad(axis=1, symbol="p", component="yy", share=1.0, box="stretch"),
    "shear": SheetLoad(axis=0, symbol="q", component="xy", share=0.5, box="shear"),
}
"""A new load is a line here: runs, studies, report and figures take what there is."""


def check_load(load: str, strain: float) -> None:
    """Raise InputError where the load is unknown, or its strain is zero, not finite or beyond -0.5 .. 1."""
    if load not in LOADS:
        raise InputError(f"load: expected {' or '.join(LOADS)}, got {load!r}")
    if not (math.isfinite(strain) and strain != 0.0 and -0.5 < strain < 1.0):
        raise InputError(f"strain: expected a number between -0.5 and 1 other than 0, got {strain}")


def check_reach(load: str, strain: float, low: float, high: float) -> None:
    """Raise InputError where the nominal strain component is outside the range of the data."""
    value = LOADS[load].nominal(strain)
    if not low <= value <= high:
        raise InputError(
            f"strain: expected a nominal eps_{LOADS[load].component} within the data's range [{low:.4g}, {high:.4g}], "
            f"got {value:.4g}"
        )
