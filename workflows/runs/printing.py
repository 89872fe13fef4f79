"""How commands print what they found, with units: once, however many ranks there are."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

__all__ = ["report", "report_sides", "say"]

_ROUND_OFF = 1e-9


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


def report_sides(summary: dict[str, Any]) -> None:
    """Forces and mean displacements of the sides of a body, a line each; round-off beside the largest is 0."""
    for name, title, unit in (("reactions", "force on", "N"), ("displacements", "displacement of", "m")):
        sides = summary.get(name, {})
        largest = max((abs(x) for value in sides.values() for x in value), default=0.0)
        for side, value in sides.items():
            shown = " ".join(f"{x:.4g}" if abs(x) > _ROUND_OFF * largest else "0" for x in value)
            say(f"{f'{title} {side}':24} {shown} {unit}")
