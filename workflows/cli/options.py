"""What the commands share: options with their help, and how figures are printed."""

from __future__ import annotations

import sys
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
    "Flat",
    "Images",
    "Kinematics",
    "KinematicsName",
    "Load",
    "Measure",
    "Out",
    "OutFile",
    "OutOrDefault",
    "Plots",
    "Strain",
    "report",
    "say",
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


class Images(StrEnum):
    """What members on opposite faces of an RVE become."""

    merged = "merged"
    duplicated = "duplicated"


Out = Annotated[Path, typer.Option("--out", help="Output folder.")]
OutOrDefault = Annotated[Path | None, typer.Option("--out", help="Output folder; one in results if not given.")]
OutFile = Annotated[Path, typer.Option("--out", help="Output file, .h5.")]
BarForce = Annotated[float, typer.Option(help="Compression of the bars at rest, f_b, in N.")]
Strain = Annotated[float, typer.Option(help="Displacement of the top side over the height of the sheet.")]
Kinematics = Annotated[KinematicsName, typer.Option(help="Strain of the macroscopic scene: small or finite.")]
Clamp = Annotated[ClampName, typer.Option(help="Bottom and top hold all of u, or its part in the plane of the sheet.")]
Degree = Annotated[int, typer.Option(help="Degree of the elements, 1 or 2.")]
Flat = Annotated[bool, typer.Option("--flat/--free", help="Hold the back side in its plane: the sheet cannot buckle.")]
Plots = Annotated[bool, typer.Option("--plots/--no-plots", help="Draw the figures and write the ParaView file.")]


def say(text: str) -> None:
    """Print on rank 0 only."""
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is None or mpi.COMM_WORLD.rank == 0:
        print(text, flush=True)


def report(summary: dict[str, Any], names: str, out: Path) -> None:
    """The figures that a person wants to see, and where the rest is."""
    units = summary["units"]
    for name in names.split():
        value = summary[name]
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        unit = units.get(name, "1")
        say(f"{name:24} {text} {'' if unit == '1' else unit}".rstrip())
    say(f"{'results':24} {out}")
