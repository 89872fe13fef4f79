"""What the studies of the paper's Section 4 stand on: material data, the full tensegrity, the data-driven solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.sampling import BOXES
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError
from workflows.runs.loads import LOADS, check_load, check_reach
from workflows.store.stages import Stages

if TYPE_CHECKING:
    from workflows.runs.scene import Scene

__all__ = ["Chain"]


@dataclass(frozen=True)
class Chain:
    """The scene and its data; the default values are the paper's.

    ``blocks`` along x and y, nominal ``strain``, ``bar_force`` in N; ``paths`` loading paths of ``steps`` points in
    the load's strain box, from ``seed``.

    Raises:
        InputError: on construction, where a value is not valid.
    """

    blocks: tuple[int, int] = (60, 30)
    strain: float = 0.05
    bar_force: float = 1e-8
    paths: int = 1000
    steps: int = 10
    seed: int = 0

    def __post_init__(self) -> None:
        check_load("stretch", self.strain)
        self.tissue  # noqa: B018  (checks the bar force)
        if min(self.blocks) < 3:
            raise InputError(f"blocks: expected at least 3 3, to leave the outer ones out, got {self.blocks}")
        for name, value, least in (("paths", self.paths, 1), ("steps", self.steps, 1), ("seed", self.seed, 0)):
            if not least <= value < 2**63:
                raise InputError(f"{name}: expected at least {least}, got {value}")

    def check_reach(self, load: str) -> None:
        """Raise InputError where the box of data of this load does not hold the nominal strain."""
        box = BOXES[LOADS[load].box]
        check_reach(load, self.strain, *box.ranges[LOADS[load].component])

    def check_bar_force(self, dataset: Dataset, data: Path) -> None:
        """Raise InputError where the data of the file ``data`` are of another bar force; measured ones have none."""
        for source in dataset.sources:
            force = source.get("bar_force")
            if force not in (None, self.bar_force):
                raise InputError(f"bar_force: expected {self.bar_force:g} N in {data}, got {force:g} N")

    @property
    def tissue(self) -> Tissue:
        """What the cells are made of."""
        return Tissue(bar_force=self.bar_force)

    @property
    def elements(self) -> tuple[int, int, int]:
        """One element a block."""
        return (*self.blocks, 1)

    def data(self, stages: Stages, load: str, name: str = "", **more: Any) -> Path:
        """The file of material data in the strain box of the load; sampled unless it is there.

        ``more`` are other arguments of :func:`workflows.runs.sample.sample`; the stage is then called by ``name``.
        """
        from workflows.runs.sample import sample

        chosen: dict[str, Any] = {"load": load, "paths": self.paths, "steps": self.steps, "seed": self.seed, **more}
        folder = stages.run(
            name or f"data-{load}",
            {**chosen, "bar_force": self.bar_force},
            lambda out: sample(out / "data.h5", tissue=self.tissue, **chosen),
        )
        return folder / "data.h5"

    def dns(self, stages: Stages, load: str, say: Callable[[str], None], *, flat: bool = True) -> Path:
        """The folder of the full tensegrity; computed unless it is there."""
        from workflows.runs.dns import dns

        scene: dict[str, Any] = {"blocks": self.blocks, "load": load, "strain": self.strain, "flat": flat}
        run = partial(dns, **scene, tissue=self.tissue, say=say)
        return stages.run(f"dns-{load}" + "-free" * (not flat), {**scene, "bar_force": self.bar_force}, run)

    def fe2(self, stages: Stages, scene: Scene, say: Callable[[str], None]) -> Path:
        """The folder of FE2 of this scene; computed unless it is there."""
        from workflows.runs.fe2 import fe2
        from workflows.runs.scene import OLDER

        run: dict[str, Any] = {**scene.parameters(), "bar_force": self.bar_force}
        for name, old in OLDER.items():
            if run.get(name) in (old, None):
                run.pop(name, None)
        name = "-".join(["fe2", scene.load, scene.kinematics, scene.clamp] + ["flat"] * scene.flat)
        solve = partial(fe2, scene=scene, tissue=self.tissue, plots=False, say=say)
        return stages.run(name, run, solve)

    def solution(self, stages: Stages, load: str, data: Path, say: Callable[[str], None]) -> Path:
        """The folder of the data-driven solution with the file ``data``, a stage of its own; computed unless there."""
        from workflows.runs.solve import solve

        scene = self.scene(load)
        run = {"load": load, "strain": self.strain, "elements": self.elements}
        return stages.run(f"dd-{load}", run, lambda out: solve(out, data=data, scene=scene, say=say), (f"data-{load}",))

    def scene(self, load: str, **more: Any) -> Scene:
        """The macroscopic scene as the paper has it: trilinear elements, one material; ``more`` of a scene's fields."""
        from workflows.runs.scene import Scene

        plain: dict[str, Any] = {"element": "trilinear", "edges": False}
        return Scene(load, self.strain, elements=self.elements, **{**plain, **more})

    def parameters(self) -> dict[str, object]:
        """All values, for a summary or a hash."""
        return asdict(self)
