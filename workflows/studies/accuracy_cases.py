"""The scenes of ``tsgdd bench accuracy``: sheets under the loads of the paper, and bodies of bulk tissue."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_law import FOLLOW, RVELaw
from tsg_micro.data.errors import InputError
from workflows.runs.adaptation import rve_of, source_for
from workflows.runs.edges import in_parts, specs_of
from workflows.runs.loads import LOADS
from workflows.runs.materials import method_of, read_tissues, the_material
from workflows.runs.scene import Scene
from workflows.scenes.read import scene_of
from workflows.scenes.scene import build
from workflows.store.stages import Stages

__all__ = ["CASES", "ZONES", "BodyCase", "Case", "SheetCase"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
ZONES = ("inner", "rows", "columns", "all")
"""Inner blocks, those at the clamps, those at the free sides that are no clamped ones, and all of them."""


class Case(Protocol):
    """A scene that is solved in several ways, and by every bar and tendon."""

    @property
    def name(self) -> str:
        """In words."""

    @property
    def symbol(self) -> str:
        """What it is judged by, p or q."""

    @property
    def block(self) -> float:
        """Edge of a block, m."""

    def values(self) -> dict[str, Any]:
        """All that decides it, plain."""

    def check(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """The model that these options ask for, in words; InputError where they are not valid."""

    def dns(self, stages: Stages, say: Callable[[str], None]) -> Path:
        """The folder of the full tensegrity; computed unless it is there."""

    def solve(self, options: Mapping[str, Any], *, exact: bool = False, refine: int = 1) -> dd.Solution:
        """By adaptive data with default numbers, or ``exact``, by FE2; with ``refine`` elements along a block."""

    def clamped(self, midpoint: Array) -> Mask:
        """Which of the blocks at these midpoints (n, 3) are at a clamp."""


@dataclass(frozen=True)
class SheetCase:
    """A sheet of ``blocks`` along x and y whose bars carry ``bar_force`` (N) at rest, under 5 % of ``load``."""

    blocks: tuple[int, int]
    load: str
    bar_force: float
    strain: float = 0.05

    @property
    def name(self) -> str:
        """In words."""
        return f"{self.blocks[0]}x{self.blocks[1]} {self.load} {1e9 * self.bar_force:g} nN"

    @property
    def symbol(self) -> str:
        """That of the load."""
        return LOADS[self.load].symbol

    @property
    def tissue(self) -> Tissue:
        """Its cells."""
        return Tissue(bar_force=self.bar_force)

    @property
    def block(self) -> float:
        """Edge of a block, m."""
        return self.tissue.block

    def values(self) -> dict[str, Any]:
        """Its fields."""
        return asdict(self)

    def check(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """See Case."""
        given = self._scene(options).parameters()
        return {name: given[name] for name in ("kinematics", "clamp", "degree", "element", "flat", "edges", "graded")}

    def dns(self, stages: Stages, say: Callable[[str], None]) -> Path:
        """See Case; a sheet that could buckle is held flat."""
        from workflows.runs.dns import dns

        run: dict[str, Any] = {"blocks": self.blocks, "load": self.load, "strain": self.strain, "flat": True}
        name = "-".join(["dns", *self.name.split()])
        solve = partial(dns, **run, tissue=self.tissue, plots=False, say=say)
        return stages.run(name, {**run, "bar_force": self.bar_force}, solve)

    def solve(self, options: Mapping[str, Any], *, exact: bool = False, refine: int = 1) -> dd.Solution:
        """See Case."""
        scene, inside = replace(self._scene(options), refine=refine), rve_of(self.tissue, None)
        problem = scene.problem(MPI.COMM_SELF, self.tissue, inside)
        specs = specs_of(inside, problem)
        if exact:
            laws = [dd.Material(law=RVELaw(one.build(), follow=FOLLOW)) for one in specs]
            return dd.LawMethod().prepare(problem, in_parts(laws)).solve()
        parts = [dd.Material(source=source_for(scene, one, problem)) for one in specs]
        return dd.AdaptiveMethod().prepare(problem, in_parts(parts)).solve()

    def clamped(self, midpoint: Array) -> Mask:
        """Those of the first and last row."""
        return _ends(midpoint[:, 1], self.block)

    def _scene(self, options: Mapping[str, Any]) -> Scene:
        """Default options; in finite strain a sheet that shear could buckle is held flat, as the full tensegrity is."""
        held = {"flat": options.get("kinematics") == "finite" and LOADS[self.load].axis != 1}
        return Scene(self.load, self.strain, elements=(*self.blocks, 1), **{**held, **options})


@dataclass(frozen=True)
class BodyCase:
    """A body of blocks of bulk tissue from a scene, given as the plain values of its file."""

    name: str
    symbol: str
    body: tuple[tuple[str, Any], ...]
    bar_force: Any
    loads: tuple[tuple[tuple[str, Any], ...], ...]
    held: tuple[str, ...] = ()

    @property
    def block(self) -> float:
        """Edge of a block, m."""
        return Tissue().block

    def values(self) -> dict[str, Any]:
        """Those of its scene."""
        force = dict(self.bar_force) if isinstance(self.bar_force, tuple) else self.bar_force
        return {
            "body": dict(self.body),
            "tissue": {"all": {"bar_force": force, "kind": "bulk"}},
            "support": [{"side": side} for side in self.held],
            "load": [dict(load) for load in self.loads],
        }

    def check(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """See Case; of the options kinematics, element and edges count."""
        known = {"kinematics", "element", "edges"}
        if not set(options) <= known:
            raise InputError(f"options: expected some of {', '.join(sorted(known))} for bodies, got {sorted(options)}")
        solve = scene_of({**self.values(), "solve": dict(options)}).solve
        return {"kinematics": solve.kinematics, "element": solve.element or "enhanced", "edges": bool(solve.edges)}

    def dns(self, stages: Stages, say: Callable[[str], None]) -> Path:
        """See Case."""
        from workflows.runs.dns_scene import dns_scene

        solve = partial(dns_scene, model=scene_of(self.values()), plots=False, say=say)
        return stages.run("-".join(["dns", *self.name.split()]), self.values(), solve)

    def solve(self, options: Mapping[str, Any], *, exact: bool = False, refine: int = 1) -> dd.Solution:
        """See Case."""
        values = self.values()
        values["body"]["refine"] = refine
        method = {"method": "FE2"} if exact else {}
        built = build(MPI.COMM_SELF, scene_of({**values, "solve": {**options, **method}}))
        how = method_of(built)
        known = read_tissues(built, how)
        problem = built.problem([one.rve for one in known])
        return how.prepare(problem, the_material(built, how, known, problem)).solve()

    def clamped(self, midpoint: Array) -> Mask:
        """Those of the first and last layer along y, where these are held."""
        return _ends(midpoint[:, 1], self.block) & bool(self.held)


def _ends(y: Array, block: float) -> Mask:
    return np.asarray((y < y.min() + 0.5 * block) | (y > y.max() - 0.5 * block))


def _cube(name: str, symbol: str, moved: tuple[float, float, float]) -> BodyCase:
    load = (("side", "top"), ("displacement", moved))
    return BodyCase(name, symbol, (("blocks", (6, 6, 6)),), 1e-8, (load,), ("bottom",))


_GRADED = (("profile", "exponential"), ("f_max", 5e-8), ("decay", 2.0))
CASES: tuple[Case, ...] = (
    SheetCase((16, 8), "stretch", 2e-9),
    SheetCase((16, 8), "shear", 5e-8),
    SheetCase((24, 16), "stretch", 2e-8),
    SheetCase((12, 20), "stretch", 1e-8),
    SheetCase((12, 20), "shear", 1e-8),
    SheetCase((24, 8), "shear", 5e-9),
    SheetCase((20, 20), "stretch", 5e-8),
    SheetCase((60, 30), "stretch", 1e-8),
    SheetCase((60, 30), "shear", 1e-8),
    _cube("cube -3 %", "p", (0.0, -3.6e-6, 0.0)),
    _cube("cube shear 5 %", "q", (6e-6, 0.0, 0.0)),
    BodyCase("spheroid radius 4", "p", (("spheroid", 4.0),), _GRADED, ((("side", "surface"), ("pressure", 20.0)),)),
)
"""Sizes, loads and prestresses unlike one another; 8 and 9 are the paper's, the last three are bulk tissue."""
