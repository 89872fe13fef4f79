"""Random scenes of the study of trust: bodies, loads, tissues, data and methods, each drawn by its number."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tsg_micro.cells.tissue import Tissue
from workflows.runs.scene import Scene

__all__ = ["CUBE", "TrustScene", "draw_scene"]

METHODS = ("order 1", "order 2", "adaptive")
_BOXES = {"stretch": ("stretch", "inplane", "full"), "compression": ("inplane", "full"), "shear": ("shear", "full")}
_STRAINS = {"stretch": (0.002, 0.06), "compression": (-0.04, -0.002), "shear": (0.004, 0.06)}


@dataclass(frozen=True)
class TrustScene:
    """A body of ``kind`` under ``load``, and the ``method`` with so many ``data`` of a ``box``, or with that budget."""

    name: str
    kind: str
    elements: tuple[int, int, int]
    element: str
    kinematics: str
    load: str
    strain: float
    bar_force: float
    method: str
    box: str
    data: int
    seed: int

    @property
    def scene(self) -> Scene:
        """What is solved; a sheet in finite strain is held flat, so that FE2 and the solve have one solution.

        One element a block: what the data leave is asked for, on the mesh that FE2 has as well.
        """
        return Scene(
            load=self.load,
            strain=self.strain,
            elements=self.elements,
            element=self.element,
            kinematics=self.kinematics,
            kind=self.kind,
            flat=self.kind == "sheet" and self.kinematics == "finite",
            graded=False,
        )

    @property
    def tissue(self) -> Tissue:
        """Of the body and of its data."""
        return Tissue(bar_force=self.bar_force)

    @property
    def paths(self) -> tuple[int, int]:
        """Loading paths of the data and points along each."""
        steps = min(10, max(1, self.data // 10))
        return max(1, self.data // steps), steps

    def parameters(self) -> dict[str, Any]:
        """All values, for a row of the table."""
        return asdict(self) | {"elements": " ".join(map(str, self.elements))}


CUBE = TrustScene(
    *("cube", "bulk", (4, 4, 4), "enhanced", "small", "shear", 0.05, 1e-8),
    *("order 1", "full", 900, 0),
)
"""Bulk tissue under shear with random data of six strains, as points: far from right, and converged."""


def draw_scene(number: int, *, largest: int = 8, most: int = 3000) -> TrustScene:
    """Scene ``number``; sheets are up to ``largest`` blocks wide, cubes half of that, of up to ``most`` data."""
    random = np.random.default_rng([number, largest, most])
    kind = str(random.choice(["sheet", "bulk"]))
    wide = largest if kind == "sheet" else max(2, largest // 2)
    size = random.integers(min(3, wide) if kind == "sheet" else 2, wide + 1, 3)
    how = str(random.choice(list(_STRAINS)))
    method = str(random.choice(METHODS))
    boxes = _BOXES[how] if kind == "sheet" else ("full",)
    few = np.log10([4, 200] if method == "adaptive" else [10, max(most, 10)])
    return TrustScene(
        name=str(number),
        kind=kind,
        elements=(int(size[0]), int(size[1]), 1 if kind == "sheet" else int(size[2])),
        element=str(random.choice(["enhanced", "trilinear"])),
        kinematics=str(random.choice(["small", "finite"])),
        load="shear" if how == "shear" else "stretch",
        strain=float(np.round(random.uniform(*_STRAINS[how]), 4)),
        bar_force=float(f"{10 ** random.uniform(-9, -7.3):.2e}"),
        method=method,
        box=str(random.choice(boxes)),
        data=int(10 ** random.uniform(*few)),
        seed=number,
    )
