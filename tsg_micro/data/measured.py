"""Measured strain and stress from a CSV file, with every column and its unit declared by the reader.

A component is named by its tensor entry: ``eps_xx`` .. ``eps_xy`` (tensor strain), ``gamma_yz`` .. ``gamma_xy``
(engineering shear, gamma = 2 eps) and ``sigma_xx`` .. ``sigma_xy``, in the order of the Mandel vector. The first line
of the file holds the headers; how the table may be written says tsg_micro.data.table.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import COMPONENTS, to_mandel
from tsg_micro.data.stress import check_measure
from tsg_micro.data.table import COUNTERS, Column, Layout, read_numbers

__all__ = ["STRAIN_UNITS", "STRESS_UNITS", "Column", "parse_columns", "read_csv"]

Array = NDArray[np.float64]

STRAIN_UNITS = {"1": 1.0, "%": 1e-2, "mm/m": 1e-3, "um/m": 1e-6}
"""Factors to 1."""
STRESS_UNITS = {
    "Pa": 1.0,
    "kPa": 1e3,
    "MPa": 1e6,
    "GPa": 1e9,
    "N/mm^2": 1e6,
    "uN/mm^2": 1.0,
    "nN/um^2": 1e3,
    "pN/um^2": 1.0,
    "dyn/cm^2": 0.1,
}
"""Factors to Pa."""

_LARGEST_STRESS = 1e13  # Pa, some times the modulus of diamond
_ENTRIES = [f"{quantity}_{ij}" for quantity in ("eps", "sigma") for ij in COMPONENTS]
_GAMMA = {f"gamma_{ij}": f"eps_{ij}" for ij in COMPONENTS[3:]}


def read_csv(
    path: str | Path,
    *,
    columns: Mapping[str, Column],
    zero: Collection[str] = (),
    silent: Collection[str] = (),
    stress_measure: str,
    layout: Layout | None = None,
    versions: Mapping[str, str] | None = None,
) -> Dataset:
    """Read measured data; each line of the file is one point.

    All six strains and six stresses must be accounted for: nothing is taken as 0 that is not declared so.

    Args:
        path: of the CSV file, UTF-8.
        columns: component name -> column. ``path`` and ``step`` (whole numbers, unit "1") are optional; without
            them all points are of path 0, and the step counts the lines.
        zero: components that are 0 at all points, as three stresses in plane stress.
        silent: names among xx .. xy whose strain and stress are 0 because nothing drove them (tsg_micro.data.dataset);
            what has no column needs no declaration as zero beside it.
        stress_measure: what the stresses are, one of tsg_micro.data.stress.MEASURES. For first_piola, whose tensor is
            not symmetric, a shear is the mean of its two entries.
        layout: how the numbers are written, as far as it cannot be seen.
        versions: of the software, to be recorded.

    Raises:
        InputError: a name or unit is unknown, a component is declared twice or not at all, the file is missing or
            empty, a column is not there, a cell is no finite number, a strain is beyond 1 or a stress beyond any
            material's, or a silent component is not zero.
    """
    path = Path(path)
    check_measure(stress_measure)
    _check_declared(columns, zero, silent)
    values = read_numbers(path, columns, layout)
    count = len(values["line"])

    tensors = {"eps": np.zeros((count, 3, 3)), "sigma": np.zeros((count, 3, 3))}
    for name, column in columns.items():
        if name in COUNTERS:
            continue
        quantity, ij = _GAMMA.get(name, name).split("_")
        factor = (STRESS_UNITS if quantity == "sigma" else STRAIN_UNITS)[column.unit]
        entry = values[name] * (0.5 * factor if name in _GAMMA else factor)
        if quantity == "eps":
            _check_strain(path, column, entry, values[name], values["line"])
        else:
            _check_stress(path, column, entry, values[name], values["line"])
        i, j = ("xyz".index(letter) for letter in ij)
        tensors[quantity][:, i, j] = tensors[quantity][:, j, i] = entry
    return Dataset(
        strain=to_mandel(tensors["eps"]),
        stress=to_mandel(tensors["sigma"]),
        stress_measure=stress_measure,
        path=values["path"].astype(np.int64) if "path" in columns else np.zeros(count, dtype=np.int64),
        step=values["step"].astype(np.int64) if "step" in columns else np.arange(count),
        silent=tuple(silent),
        parameters={
            "measured": path.name,
            "columns": {name: asdict(column) for name, column in columns.items()},
            "zero": sorted(zero),
        },
        versions=dict(versions or {}),
    )


def _check_declared(columns: Mapping[str, Column], zero: Collection[str], silent: Collection[str]) -> None:
    """Every strain and stress once, under a known name and in a known unit."""
    known = [*_ENTRIES, *_GAMMA]
    for name in columns:
        if name not in known and name not in COUNTERS:
            raise InputError(f"columns: expected names among {', '.join([*known, *COUNTERS])}, got {name!r}")
    for name in zero:
        if name not in known:
            raise InputError(f"zero: expected names among {', '.join(known)}, got {name!r}")
    for name in silent:
        if name not in COMPONENTS:
            raise InputError(f"silent: expected names among {', '.join(COMPONENTS)}, got {name!r}")
    for name, column in columns.items():
        units = {"1": 1.0} if name in COUNTERS else STRESS_UNITS if name.startswith("sigma") else STRAIN_UNITS
        if column.unit not in units:
            raise InputError(f"unit of {name}: expected one of {', '.join(units)}, got {column.unit!r}")
    declared: dict[str, str] = {}
    for name in [*columns, *zero]:
        entry = _GAMMA.get(name, name)
        if entry in declared:
            raise InputError(f"component {entry}: expected one declaration, got {declared[entry]} and {name}")
        declared[entry] = name
    missing = [entry for entry in _ENTRIES if entry not in declared and entry.split("_")[1] not in silent]
    if missing:
        raise InputError(f"components {', '.join(missing)}: expected a column, or a declaration as zero, got neither")


def parse_columns(column: list[str]) -> dict[str, Column]:
    """Columns by component from texts NAME=HEADER:UNIT; the last colon ends the header.

    Raises:
        InputError: a text of another form, or a name that comes twice.
    """
    columns: dict[str, Column] = {}
    for text in column:
        name, equals, rest = text.partition("=")
        header, colon, unit = rest.rpartition(":")
        parts = [part.strip() for part in (name, header, unit)]
        if not (equals and colon and all(parts)):
            raise InputError(f"column: expected NAME=HEADER:UNIT, as eps_xx=strain:%, got {text!r}")
        if parts[0] in columns:
            raise InputError(f"column: expected each name once, got {parts[0]} twice")
        columns[parts[0]] = Column(header=parts[1], unit=parts[2])
    return columns


def _check_strain(path: Path, column: Column, strain: Array, given: Array, line: Array) -> None:
    """Strains beyond 1 are no small strains: most often percents that were declared as plain numbers."""
    at = int(np.abs(strain).argmax())
    if abs(strain[at]) > 1.0:
        hint = "; the unit is probably '%'" if column.unit == "1" else ""
        raise InputError(
            f"CSV file {path}, line {line[at]:.0f}, column {column.header!r}: expected strains within -1 and 1, "
            f"got {given[at]:g} in the unit {column.unit!r}{hint}"
        )


def _check_stress(path: Path, column: Column, stress: Array, given: Array, line: Array) -> None:
    """Stresses that no material bears are marks of an instrument, or in another unit."""
    at = int(np.abs(stress).argmax())
    if abs(stress[at]) > _LARGEST_STRESS:
        raise InputError(
            f"CSV file {path}, line {line[at]:.0f}, column {column.header!r}: expected a stress below "
            f"{_LARGEST_STRESS:.0e} Pa, got {given[at]:g} in the unit {column.unit!r}"
        )
