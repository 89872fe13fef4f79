"""Options that commands share, with their help, and the words that they take."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

__all__ = [
    "BarForce",
    "Box",
    "Clamp",
    "ClampName",
    "Degree",
    "Edges",
    "Element",
    "ElementName",
    "Flat",
    "Graded",
    "HowLoaded",
    "Images",
    "Kind",
    "KindName",
    "Kinematics",
    "KinematicsName",
    "Load",
    "Measure",
    "MergeNodes",
    "MeshUnit",
    "Out",
    "OutFile",
    "OutOrDefault",
    "Plots",
    "SceneFile",
    "Strain",
    "out_option",
]


class Load(StrEnum):
    """Macroscopic loads."""

    stretch = "stretch"
    shear = "shear"


class Box(StrEnum):
    """Strain boxes to sample."""

    stretch = "stretch"
    shear = "shear"
    inplane = "inplane"
    full = "full"


class Measure(StrEnum):
    """Stress measures."""

    first_piola = "first_piola"
    second_piola = "second_piola"
    kirchhoff = "kirchhoff"
    cauchy = "cauchy"


class KinematicsName(StrEnum):
    """Kinematics of the macroscopic scene."""

    small = "small"
    finite = "finite"


class ClampName(StrEnum):
    """What bottom and top hold."""

    full = "full"
    inplane = "inplane"


class ElementName(StrEnum):
    """Hexahedra of degree 1."""

    trilinear = "trilinear"
    enhanced = "enhanced"


class KindName(StrEnum):
    """Kinds of tissue."""

    sheet = "sheet"
    bulk = "bulk"


class Images(StrEnum):
    """What members on opposite faces of an RVE become."""

    merged = "merged"
    duplicated = "duplicated"


def _path(text: str | Path) -> Path:
    """A path that names something; an empty one, as of a variable that is not set, would be the present folder."""
    if not str(text).strip():
        raise typer.BadParameter("expected a path, got an empty one")
    return Path(text)


SceneFile = Annotated[Path | None, typer.Argument(help="Scene file, TOML; all of the scene is in it then.")]


def out_option(help: str) -> Any:  # noqa: A002
    """The option --out, where results go."""
    return typer.Option("--out", parser=_path, metavar="<path>", help=help)


Out = Annotated[Path, out_option("Output folder.")]
OutOrDefault = Annotated[Path | None, out_option("Output folder; one in results if not given.")]
OutFile = Annotated[Path, out_option("Output file, .h5.")]
BarForce = Annotated[float, typer.Option(help="Compression of the bars at rest, f_b, in N.")]
HowLoaded = Annotated[Load, typer.Option(help="How the top side moves.")]
Strain = Annotated[float, typer.Option(help="Displacement of the top side over the height of the sheet.")]
Kinematics = Annotated[KinematicsName, typer.Option(help="Strain of the macroscopic scene: small or finite.")]
Clamp = Annotated[ClampName, typer.Option(help="Bottom and top hold all of u, or its part in the plane of the sheet.")]
Degree = Annotated[int, typer.Option(help="Degree of the elements, 1 or 2.")]
Element = Annotated[
    ElementName | None,
    typer.Option(help="Of degree 1: enhanced, or trilinear, stiff in bending; enhanced if not given."),
]
Kind = Annotated[KindName, typer.Option(help="Tissue: a sheet with free faces, or bulk, periodic in x, y, z.")]
Flat = Annotated[bool, typer.Option("--flat/--free", help="Hold the back side in its plane: the sheet cannot buckle.")]
MeshUnit = Annotated[str, typer.Option(help="Unit of the mesh's coordinates: m, mm, um or nm.")]
Edges = Annotated[
    bool | None,
    typer.Option("--edges/--no-edges", help="Outer blocks are a tissue of their own, where there are RVEs; in sheets."),
]
Graded = Annotated[
    bool | None,
    typer.Option("--graded/--no-graded", help="The two outer rows of blocks of a box are halved; in sheets."),
]
MergeNodes = Annotated[bool, typer.Option("--merge-nodes", help="Join nodes of the mesh that are at one place.")]
Plots = Annotated[bool, typer.Option("--plots/--no-plots", help="Draw the figures and write the ParaView file.")]
