"""Groups of options that go together, declared once and spread into the commands that take them.

A group is a frozen dataclass whose fields are options. A command that is decorated with :func:`grouped` has a parameter
of that type and gets all its options.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from workflows.runs.options import (
    BarForce,
    Clamp,
    ClampName,
    Degree,
    Edges,
    Element,
    Flat,
    Graded,
    HowLoaded,
    KindName,
    Kinematics,
    KinematicsName,
    Load,
    MergeNodes,
    MeshUnit,
    Strain,
)

if TYPE_CHECKING:
    from tsg_micro.cells.tissue import Tissue
    from tsg_micro.data.table import Layout
    from workflows.runs.scene import Scene

__all__ = ["CellOptions", "Group", "SceneOptions", "TableOptions", "TissueOptions", "WantedTissueOptions", "grouped"]


@dataclass(frozen=True)
class Group:
    """Options that go together; ``given`` names those that were on the command line."""

    given: frozenset[str] = field(default=frozenset(), kw_only=True)


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """``command`` with every parameter that is a :class:`Group` spread into the options of the group.

    Names, help and defaults are those of the group's fields; a default of the parameter, itself a group, has its own.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, type[Group]] = {}
    spread: dict[str, inspect.Parameter] = {}
    for name, parameter in inspect.signature(command).parameters.items():
        kind = hints[name]
        if not (isinstance(kind, type) and issubclass(kind, Group)):
            spread[name] = parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kind)
            continue
        groups[name] = kind
        types = get_type_hints(kind, include_extras=True)
        default = kind if parameter.default is inspect.Parameter.empty else parameter.default
        for option in _options(kind):
            spread[option] = inspect.Parameter(
                option,
                inspect.Parameter.KEYWORD_ONLY,
                default=getattr(default, option, inspect.Parameter.empty),
                annotation=types[option],
            )

    def run(context: typer.Context, **values: Any) -> None:
        given = {name for name in values if getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"}
        made = {}
        for name, kind in groups.items():
            options = {option: values.pop(option) for option in _options(kind)}
            made[name] = kind(**options, given=frozenset(given & options.keys()))
        command(**values, **made)

    run.__doc__, run.__name__, run.__module__ = command.__doc__, command.__name__, command.__module__
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    run.__signature__ = inspect.Signature([context, *spread.values()])  # type: ignore[attr-defined]
    run.__annotations__ = {"context": typer.Context, **{name: one.annotation for name, one in spread.items()}}
    return run


def _options(group: type[Group]) -> list[str]:
    return [one.name for one in fields(group) if one.name != "given"]


TISSUE_HELP = "Tissue file, TOML, as calibrate --save-tissue writes it; options of the cell that are given win over it."


@dataclass(frozen=True)
class _BarForceOption(Group):
    bar_force: BarForce = 1e-8


@dataclass(frozen=True)
class CellOptions(Group):
    """Shape, size and members of a cell, and the file that can say all of it."""

    e_bar: Annotated[float, typer.Option("--e-bar", help="Young's modulus of the bars, Pa.")] = 1.2e9
    e_tendon: Annotated[float, typer.Option("--e-tendon", help="Young's modulus of the tendons, Pa.")] = 10e6
    half_diagonal: Annotated[float, typer.Option(help="Half-diagonal r of a square face, in (0, 1).")] = 0.5
    d_bar: Annotated[float, typer.Option("--d-bar", help="Diameter of the bars, m.")] = 0.1e-6
    d_tendon: Annotated[float, typer.Option("--d-tendon", help="Diameter of the tendons, m.")] = 1e-6
    height: Annotated[float, typer.Option(help="Height of a cell, m; a block is two of them wide.")] = 10e-6
    tissue: Annotated[Path | None, typer.Option(help=TISSUE_HELP)] = None

    def make(self) -> Tissue:
        """The tissue of the file, or the default one, with the options that were given.

        Raises:
            InputError: the file or a value is not valid.
        """
        from tsg_micro.cells.tissue import Tissue
        from tsg_micro.cells.tissue_file import read_tissue

        base = Tissue() if self.tissue is None else read_tissue(self.tissue)
        cell = {name.replace("e_", "E_"): getattr(self, name) for name in self.given - {"tissue"}}
        force = {name: cell.pop(name) for name in ("bar_force",) if name in cell}
        return replace(base, cell=replace(base.cell, **cell), **force)


@dataclass(frozen=True)
class TissueOptions(CellOptions, _BarForceOption):
    """A cell and the compression of its bars."""


@dataclass(frozen=True)
class WantedTissueOptions(CellOptions):
    """A tissue that need not be said: data know theirs."""

    bar_force: Annotated[float | None, typer.Option(help="With --adapt: f_b in N, if the data do not say it.")] = None

    def make_if_given(self, *, adapt: bool) -> Tissue | None:
        """The tissue; None where no option was given.

        Raises:
            InputError: as :meth:`make`, the cell is given without file or bar force, or nothing asks for it.
        """
        from tsg_micro.data.errors import InputError

        names = ", ".join(sorted(self.given - {"bar_force"}))
        if names and not adapt:
            raise InputError(f"{names}: expected --adapt with them, got none")
        if self.given and not self.given & {"bar_force", "tissue"}:
            raise InputError(f"bar_force: expected a force in N, or --tissue, beside {names}, got neither")
        return self.make() if self.given else None


@dataclass(frozen=True)
class SceneOptions(Group):
    """What is loaded on the macroscopic scale, and how."""

    elements: Annotated[tuple[int, int, int] | None, typer.Option(help="Elements along x, y, z; a block each.")] = None
    mesh: Annotated[Path | None, typer.Option(help="Hexahedral gmsh mesh, sides named bottom and top.")] = None
    mesh_unit: MeshUnit = "m"
    merge_nodes: MergeNodes = False
    load: HowLoaded = Load.stretch
    strain: Strain = 0.05
    kinematics: Kinematics = KinematicsName.small
    clamp: Clamp = ClampName.full
    degree: Degree = 1
    element: Element = None
    flat: Flat = False
    edges: Edges = None
    graded: Graded = None
    kind: Annotated[
        KindName | None, typer.Option(help="Tissue, sheet or bulk; that of the data, else a sheet, if not given.")
    ] = None

    def make(self) -> Scene:
        """The scene.

        Raises:
            InputError: a value is not valid.
        """
        from workflows.runs.scene import Scene

        values: dict[str, Any] = {}
        for name in _options(type(self)):
            value = getattr(self, name)
            values[name] = value.value if isinstance(value, StrEnum) else value
        return Scene(**values)


@dataclass(frozen=True)
class TableOptions(Group):
    """How the numbers of a CSV file are written, as far as it cannot be seen."""

    delimiter: Annotated[
        str | None, typer.Option(help="What parts the cells: comma, semicolon, tab or blank; seen if not given.")
    ] = None
    decimal: Annotated[str, typer.Option(help="Decimal sign of the numbers, . or a comma.")] = "."
    comment: Annotated[str, typer.Option(help="Lines that begin with it do not count.")] = "#"
    skip: Annotated[int, typer.Option(help="Lines above the headers that do not count.")] = 0

    def make(self) -> Layout:
        """The layout.

        Raises:
            InputError: a value is not valid.
        """
        from tsg_micro.data.table import Layout

        return Layout(self.delimiter, self.decimal, self.comment, self.skip)
