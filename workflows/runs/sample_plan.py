"""What tsgdd sample samples: the RVE, the strain box, and how many paths through it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from tsg_micro.cells.lattice import Images
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve import RVE
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES, PathData, StrainBox, sample_paths
from tsg_micro.data.errors import InputError
from workflows.store.limits import check_memory

__all__ = ["Plan"]

_TOGETHER = 32
"""Paths of one block that are followed together."""
_PER_PATH, _PER_POINT, _PER_BLOCK = 2e3, 1.5e3, 3e5
"""Bytes, roughly: a path on its way, a point with its tangent (twice, as it is joined), a block of an RVE."""


@dataclass(frozen=True)
class Plan:
    """What is sampled; checked when made.

    Raises:
        InputError: on construction, where a value is not valid.
    """

    load: str
    paths: int
    steps: int
    seed: int = 0
    tissue: Tissue = field(default_factory=Tissue)
    blocks: tuple[int, int, int] = (1, 1, 1)
    images: Images = "merged"
    kind: str = "sheet"
    axes: str | None = None

    def __post_init__(self) -> None:
        if self.load not in BOXES:
            raise InputError(f"load: expected one of {', '.join(BOXES)}, got {self.load!r}")
        for name, value, least in (("paths", self.paths, 1), ("steps", self.steps, 1), ("seed", self.seed, 0)):
            if value < least:
                raise InputError(f"{name}: expected at least {least}, got {value}")
        assert self.spec  # checks itself
        if self.seed >= 2**63:
            raise InputError(f"seed: expected less than 2^63, got {self.seed}")
        check_memory(f"paths, steps: {self.paths} and {self.steps}", self.paths * (_PER_PATH + self.steps * _PER_POINT))
        check_memory(f"blocks: {' x '.join(map(str, self.blocks))}", _PER_BLOCK * math.prod(self.spec.blocks))

    @property
    def box(self) -> StrainBox:
        """The strain box of the load; bulk tissue has no faces that would leave a strain free."""
        return replace(BOXES[self.load], free=()) if self.kind == "bulk" else BOXES[self.load]

    @property
    def spec(self) -> RVESpec:
        """The RVE that is sampled."""
        more: dict[str, Any] = {"blocks": self.blocks, "images": self.images, "free": self.box.free}
        inside = RVESpec.of_kind(self.kind, self.tissue, **more)
        return inside if self.axes is None else inside.with_axes(self.axes)

    def parameters(self) -> dict[str, Any]:
        """All values, for a summary."""
        one = {"load": self.load, "paths": self.paths, "steps": self.steps, "bar_force": self.tissue.bar_force}
        one |= {"seed": self.seed, "blocks": self.blocks, "images": self.images, "kind": self.kind, "axes": self.axes}
        return {**one, "box": asdict(self.box), "cell": asdict(self.tissue.cell)}

    def together(self, paths: int, processes: int) -> int:
        """How many of the ``paths`` that are left each of the processes follows at once."""
        return max(1, min(_TOGETHER // math.prod(self.spec.blocks), -(-paths // (2 * processes))))

    def run(self, rve: RVE, paths: Iterable[int], progress: Callable[[], None] | None = None) -> list[PathData]:
        """Follow the paths of these numbers."""
        return sample_paths(rve, self.box, paths=paths, steps=self.steps, seed=self.seed, progress=progress)
