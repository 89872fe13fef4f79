"""What a scene file may hold, key by key; pydantic checks it, nothing is made yet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, model_validator

from workflows.scenes.quantities import BodyForceDensity, Force, Length, Number, Pressure

__all__ = ["Body", "CellModel", "Load", "Profile", "SceneModel", "Solve", "Support", "TissueModel"]

Axis = Literal["x", "y", "z"]
Flag = Annotated[bool, Strict()]
Count = Annotated[int, Strict(), Field(ge=1, le=10**9)]


def _rising(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError(f"expected the least coordinate and the largest, got {ends[0]:g} and {ends[1]:g} m")
    return ends


def _some(factors: tuple[float, ...]) -> tuple[float, ...]:
    if not any(factors):
        raise ValueError("expected a part of the load that is not zero, got none")
    return factors


Range = Annotated[tuple[Length, Length], AfterValidator(_rising)]
"""Least and largest coordinate, m."""
Factors = Annotated[tuple[Number, ...], Field(min_length=1, max_length=10_000), AfterValidator(_some)]
Steps = Annotated[int, Strict(), Field(ge=1, le=10_000)] | Factors


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, arbitrary_types_allowed=False)


def _one_of(values: dict[str, object], names: str, *, most: int = 1, least: int = 1) -> None:
    given = [name for name in names.split() if values.get(name) is not None]
    if not least <= len(given) <= most:
        raise ValueError(f"expected one of {names.replace(' ', ', ')}, got {', '.join(given) or 'none'}")


class Body(_Strict):
    """The body: a mesh of hexahedra, or one of blocks."""

    mesh: Path | None = None
    """gmsh file of hexahedra."""
    unit: Literal["m", "mm", "um", "nm"] = "m"
    """Of the mesh's coordinates."""
    merge_nodes: Flag = False
    """Join nodes of the mesh that are at one place."""
    blocks: tuple[Count, Count, Count] | None = None
    """A box of so many blocks along x, y, z."""
    box: tuple[Length, Length, Length] | None = None
    """A box of these lengths, to the nearest number of blocks."""
    sheet: tuple[Length, Length] | None = None
    """The same, one block thick."""
    spheroid: Annotated[Number, Field(gt=0)] | None = None
    """All blocks whose centre is within so many block edges of the centre."""
    refine: Annotated[int, Strict(), Field(ge=1, le=8)] = 1
    """Elements along each edge of a block; not of a mesh."""
    graded: Flag | None = None
    """Outer blocks of a box are halved beside clamps; in sheets alone if nothing is said."""

    @model_validator(mode="after")
    def _check(self) -> Body:
        _one_of(dict(self), "mesh blocks box sheet spheroid")
        if self.mesh is None and (self.unit != "m" or self.merge_nodes):
            raise ValueError("expected unit and merge_nodes beside mesh alone, got none")
        if self.mesh is not None and self.refine != 1:
            raise ValueError(f"expected refine of bodies made of blocks, got {self.refine} of a mesh")
        if self.graded and (self.mesh or self.spheroid):
            raise ValueError("expected graded beside blocks, box or sheet, got another body")
        return self


class Profile(_Strict):
    """A bar force that varies over the body, cell by cell.

    exponential: f_max exp(-decay r/R); linear: f_max (1 - (1 - exp(-decay)) r/R), r from the centre; or that of a file.
    """

    profile: Literal["exponential", "linear"] | None = None
    f_max: Force | None = None
    decay: Annotated[Number, Field(ge=0, le=100)] = 2.0
    centre: tuple[Length, Length, Length] | None = None
    """The middle of the body's extent if not given."""
    radius: Annotated[Length, Field(gt=0)] | None = None
    """R; half the largest extent of the body if not given."""
    file: Path | None = None
    """CSV with columns x, y, z in m and bar_force in N; the nearest row counts."""

    @model_validator(mode="after")
    def _check(self) -> Profile:
        _one_of(dict(self), "profile file")
        if (self.profile is None) != (self.f_max is None):
            raise ValueError("expected f_max beside profile, got one of them")
        return self


class CellModel(_Strict):
    """Shape, size and members of a cell."""

    E_bar: Pressure | None = None
    E_tendon: Pressure | None = None
    half_diagonal: Number | None = None
    d_bar: Length | None = None
    d_tendon: Length | None = None
    height: Length | None = None


class TissueModel(_Strict):
    """What a region of the body, or all of it, is made of."""

    region: str | None = None
    """A named physical volume of the mesh; all that no other tissue takes if none."""
    bar_force: Force | Profile | None = None
    cell: CellModel = CellModel()
    file: Path | None = None
    """Tissue file (TOML), as calibrate --save-tissue writes it; what is said beside it wins."""
    kind: Literal["bulk", "sheet"] | None = None
    data: Path | None = None
    """Material data (HDF5) of this tissue."""


class Support(_Strict):
    """What is held: components of the displacement of a side, an edge or point where sides meet, or part of one."""

    side: str | tuple[str, ...] | None = None
    fix: tuple[Axis, ...] | Literal["normal"] = ("x", "y", "z")
    """Components, or "normal": a flat side is a plane of symmetry."""
    within: dict[Axis, Range] = {}
    """The part of the side between these coordinates."""
    mean: Flag = False
    """Hold what rigid motions are left in the mean of the body."""

    @model_validator(mode="after")
    def _check(self) -> Support:
        if self.mean == (self.side is not None):
            raise ValueError("expected side, or mean = true, got " + ("both" if self.mean else "none"))
        if self.side is not None and (not self.fix or not self.side):
            raise ValueError("expected some components to fix, and a side, got none")
        return self


class Along(_Strict):
    """Three numbers that go linearly from place to place along an axis."""

    along: Axis
    at: tuple[Length, ...]
    value: tuple[tuple[Pressure, Pressure, Pressure], ...]

    @model_validator(mode="after")
    def _check(self) -> Along:
        if len(self.at) != len(self.value) or len(self.at) < 2 or list(self.at) != sorted(set(self.at)):
            raise ValueError("expected at least two rising places in at, and a value for each, got others")
        return self


class Load(_Strict):
    """What pulls or moves: one of displacement, traction, pressure on a side, or a body force."""

    side: str | tuple[str, ...] | None = None
    within: dict[Axis, Range] = {}
    displacement: tuple[Length, Length, Length] | dict[Axis, Length] | None = None
    """All components, or those that are named."""
    traction: tuple[Pressure, Pressure, Pressure] | Along | None = None
    """Dead, per area at rest."""
    pressure: Pressure | None = None
    """From outside; dead in small strain, in finite strain it follows the body."""
    body_force: tuple[BodyForceDensity, BodyForceDensity, BodyForceDensity] | None = None
    region: str | None = None
    """Of the body force; all of the body if none."""

    @model_validator(mode="after")
    def _check(self) -> Load:
        _one_of(dict(self), "displacement traction pressure body_force")
        if (self.side is None) != (self.body_force is not None):
            raise ValueError("expected a side, but for a body force, got " + ("none" if self.side is None else "one"))
        if self.region is not None and self.body_force is None:
            raise ValueError("expected a region beside body_force alone, got one")
        if self.within and self.displacement is None:
            raise ValueError("expected within beside displacement alone, got it with another load")
        if self.displacement == {} or self.side == ():
            raise ValueError("expected some components and sides, got none")
        if self.displacement is None and self.side is not None and not isinstance(self.side, str):
            raise ValueError("expected one side of a traction or pressure, got several")
        return self


class Solve(_Strict):
    """How it is solved."""

    method: str = "adaptive"
    """One of dd_macro.METHODS; "points" and "tangents" are data as points and as tangent spaces."""
    kinematics: Literal["small", "finite"] = "small"
    steps: Steps = 1
    """Number of equal parts of the load, or the part of it at every step."""
    element: Literal["enhanced", "trilinear"] | None = None
    degree: Literal[1, 2] = 1
    edges: Flag | None = None
    """Outer blocks of flat sides are a tissue of their own; in sheets alone if nothing is said."""
    metric: str = "auto"
    budget: Annotated[int, Strict(), Field(ge=1, le=10**7)] | None = None
    """RVEs of an adaptive run at most."""
    tolerance: Annotated[Number, Field(gt=0, lt=1)] | None = None
    """Estimated error that ends an adaptive run."""
    max_iterations: Annotated[int, Strict(), Field(ge=1, le=10**6)] | None = None

    @property
    def factors(self) -> tuple[float, ...]:
        """The part of the load at every step."""
        if isinstance(self.steps, int):
            return tuple((k + 1) / self.steps for k in range(self.steps))
        return self.steps


class SceneModel(_Strict):
    """A scene file."""

    body: Body
    tissue: Annotated[dict[str, TissueModel], Field(min_length=1)]
    support: tuple[Support, ...] = ()
    load: Annotated[tuple[Load, ...], Field(min_length=1)]
    solve: Solve = Solve()

    @property
    def held(self) -> set[str]:
        """Sides that are held or moved as a whole, in all components."""
        supports = {s.side for s in self.support if set(s.fix) == set("xyz") and not s.within}
        moved = {s.side for s in self.load if s.displacement is not None and len(s.displacement) == 3 and not s.within}
        return {side for side in supports | moved if isinstance(side, str)}

    @property
    def supported(self) -> set[str]:
        """Sides with a support or a displacement, whole or in part."""
        sides = [s.side for s in self.support] + [s.side for s in self.load if s.displacement is not None]
        return {side for side in sides if isinstance(side, str)}
