"""A measured curve, two columns of a CSV file with their units declared: by --column, or in the headers themselves."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.measured import STRAIN_UNITS, STRESS_UNITS, parse_columns
from tsg_micro.data.table import Column, Layout, read_headers, read_numbers

__all__ = ["CURVES", "read_curve"]

Array = NDArray[np.float64]

_FORCE_UNITS = {"N": 1.0, "mN": 1e-3, "uN": 1e-6, "nN": 1e-9, "pN": 1e-12}
_LENGTH_UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
CURVES: dict[str, dict[str, Mapping[str, float]]] = {
    "cell": {"force": _FORCE_UNITS, "displacement": _LENGTH_UNITS},
    "monolayer": {"strain": STRAIN_UNITS, "stress": STRESS_UNITS},
}
"""Scene to its two quantities, the given one first, with their units."""


def read_curve(path: Path, scene: str, column: Sequence[str] = (), layout: Layout | None = None) -> tuple[Array, Array]:
    """Load and answer (n,) of a scene in SI units: force and displacement, or strain and nominal stress.

    Without ``column`` (texts QUANTITY=HEADER:UNIT) the headers must say quantity and unit: ``force_nN``,
    ``force (nN)``, ``force [nN]`` or ``force / nN``. A unit is never guessed. ``layout`` is how numbers are written.

    Raises:
        InputError: a column or unit is missing, unknown or declared twice, the file cannot be read, a load is negative
            or all of them are zero.
    """
    quantities = CURVES[scene]
    columns = parse_columns(list(column)) if column else _from_headers(path, quantities, layout)
    if set(columns) != set(quantities):
        raise InputError(f"column: expected {' and '.join(quantities)} for the scene {scene}, got {', '.join(columns)}")
    for name, chosen in columns.items():
        if _unit(chosen.unit) not in quantities[name]:
            raise InputError(f"unit of {name}: expected one of {', '.join(quantities[name])}, got {chosen.unit!r}")
    numbers = read_numbers(path, columns, layout)
    load, answer = (numbers[name] * quantities[name][_unit(columns[name].unit)] for name in quantities)
    given = next(iter(quantities))
    if (load < 0.0).any() or not (load > 0.0).any():
        raise InputError(
            f"CSV file {path}, {given}: expected numbers from 0 upwards (a push counts positive), some above 0, "
            f"got {load.min():g} to {load.max():g} in SI units"
        )
    if scene == "monolayer" and load.max() >= 1.0:
        raise InputError(f"CSV file {path}, strain: expected numbers below 1, got {load.max():g}; is its unit %?")
    if not np.abs(answer).max() > 0.0:
        raise InputError(f"CSV file {path}, {list(quantities)[1]}: expected numbers other than 0, got none")
    return load, answer


def _unit(text: str) -> str:
    """The unit as the tables write it."""
    return {"-": "1", "µm": "um", "μm": "um", "µN": "uN", "μN": "uN"}.get(text, text)


def _from_headers(
    path: Path, quantities: Mapping[str, Mapping[str, float]], layout: Layout | None
) -> dict[str, Column]:
    """Columns whose headers tell quantity and unit."""
    headers = read_headers(path, layout)
    columns = {}
    for name in quantities:
        pattern = re.compile(rf"{name}\s*(?:_|\(|\[|/|,|\s)\s*(?P<unit>[^\s)\]]+)\s*[)\]]?", re.IGNORECASE)
        found = [(header, match["unit"]) for header in headers if (match := pattern.fullmatch(header))]
        if len(found) != 1:
            example = f"{name}_{list(quantities[name])[-1]}"
            raise InputError(
                f"CSV file {path}: expected one header with the unit of {name}, as {example}, or --column "
                f"{name}=HEADER:UNIT, got {', '.join(headers)}"
            )
        columns[name] = Column(*found[0])
    return columns
