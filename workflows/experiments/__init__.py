"""Numbers that public sources print, one CSV file a source; none is read off a figure.

Lines that begin with # name the source, where the numbers stand in it, and which of its curves are left out because
they are printed as figures only. The columns are quantity, low, high (SI; empty where the source gives one end only)
and unit, then what the source says in its own units.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from importlib.resources import files

from tsg_micro.data.errors import InputError

__all__ = ["Published", "published", "sources"]


@dataclass(frozen=True)
class Published:
    """One printed figure: a value (low = high), a range, or a bound (the other end is infinite)."""

    label: str
    """Authors and year, for legends."""
    low: float
    high: float
    unit: str
    printed: str
    """What the source says."""


def sources() -> list[str]:
    """Names of the sources that are there."""
    return sorted(entry.name.removesuffix(".csv") for entry in files(__name__).iterdir() if entry.name.endswith(".csv"))


def published(source: str) -> dict[str, Published]:
    """The figures of one source by quantity.

    Raises:
        InputError: there is no such source.
    """
    if source not in sources():
        raise InputError(f"source: expected one of {', '.join(sources())}, got {source!r}")
    text = (files(__name__) / f"{source}.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    author, year = source.rsplit("_", 1)
    return {
        row["quantity"]: Published(
            label=f"{author.capitalize()} et al. {year}",
            low=float(row["low"] or "-inf"),
            high=float(row["high"] or "inf"),
            unit=row["unit"],
            printed=row["printed"],
        )
        for row in rows
    }
