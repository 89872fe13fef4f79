"""Summaries of runs that are done, as people read them: one as a table, many as rows of a CSV file."""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from tsg_micro.data.display import printable
from tsg_micro.data.errors import InputError
from workflows.store.record import read_summary, write_table

__all__ = ["rows_of", "show", "table"]

_APART = ("command", "parameters", "versions", "machine", "units")
_FEW = 6
"""Entries of a list that are all shown."""
_WIDTH = 120
"""Columns where the output is no terminal."""

Plain = dict[str, Any]


def show(run: Path) -> None:
    """Print the summary of a run: what was asked, what came out with units, and where it ran.

    Args:
        run: the folder of a run, or the file that it wrote.

    Raises:
        InputError: no summary is there, or it cannot be read.
    """
    summary = read_summary(run)
    console = Console(width=None if sys.stdout.isatty() else _WIDTH, highlight=False)
    console.print(Text(printable(f"tsgdd {summary['command']}, {run}"), style="bold"))
    units = _mapping(summary, "units")
    figures = {name: value for name, value in summary.items() if name not in _APART}
    about = {"version": _mapping(summary, "versions").get("tsgdd"), **_mapping(summary, "machine")}
    for title, values, unit_of in (("asked", summary["parameters"], {}), ("found", figures, units), ("on", about, {})):
        grid = Table(title, "value", "unit", box=None, header_style="bold", padding=(0, 2, 0, 0), expand=False)
        for name, value in _flat(values).items():
            if value is None:
                continue
            unit = str(unit_of.get(name.split(".")[0], ""))
            shown, unit = _shown(value, "" if unit == "1" else unit)
            grid.add_row(*(Text(printable(text)) for text in (name, shown, unit)))
        console.print(grid)


def table(runs: Sequence[Path], out: Path | None = None) -> None:
    """Write runs as CSV, a row each, to the file ``out`` or the standard output; columns as of :func:`rows_of`.

    Raises:
        InputError: no runs, a summary cannot be read, or the file is none that can be written.
    """
    if out is not None and out.suffix != ".csv":
        raise InputError(f"out: expected a file name that ends in .csv, got {out}")
    rows = rows_of(runs)
    if out is not None:
        write_table(out, rows)
        return
    writer = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)


def rows_of(runs: Sequence[Path]) -> list[Plain]:
    """The runs in the order given: folder, command, the parameters that differ, and all figures that are one value.

    A column of a figure is named "name / unit"; what a run does not have is empty. Text cannot steer a terminal.

    Raises:
        InputError: no runs, or a summary is not there or cannot be read.
    """
    if not runs:
        raise InputError("runs: expected at least one folder of a run, got none")
    summaries = [read_summary(run) for run in runs]
    asked = [{name: _joined(value) for name, value in _flat(one["parameters"]).items()} for one in summaries]
    differing = [name for name in _names(asked) if len({str(one.get(name)) for one in asked}) > 1]
    found = []
    for one in summaries:
        units = _mapping(one, "units")
        figures = _flat({name: value for name, value in one.items() if name not in _APART})
        found.append({_column(name, units): value for name, value in figures.items() if not isinstance(value, list)})
    columns = _names(found)
    return [
        {"run": _safe(str(run)), "command": _safe(one["command"])}
        | {_safe(name): _safe(values.get(name)) for name in differing}
        | {_safe(name): _safe(figures.get(name)) for name in columns}
        for run, one, values, figures in zip(runs, summaries, asked, found, strict=True)
    ]


def _safe(value: Any) -> Any:
    return printable(value) if isinstance(value, str) else value


def _names(rows: Sequence[Plain]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row))


def _column(name: str, units: Mapping[str, Any]) -> str:
    unit = units.get(name.split(".")[0], "1")
    return name if unit == "1" else f"{name} / {unit}"


def _mapping(summary: Mapping[str, Any], name: str) -> Plain:
    """The part ``name`` of a summary; InputError where it is none."""
    part = summary[name]
    if not isinstance(part, dict):
        raise InputError(f"summary.json: damaged (expected names and values in {name!r}, got {part!r})")
    return part


def _flat(values: Mapping[str, Any], before: str = "") -> Plain:
    """Values by their path, as error_p_mech.l2 or scene.load.1.side; lists of values stay."""
    found: Plain = {}
    for name, value in values.items():
        inner = dict(enumerate(value, start=1)) if _is_rows(value) and len(value) <= _FEW else value
        if isinstance(inner, dict):
            found |= _flat({str(key): one for key, one in inner.items()}, f"{before}{name}.")
        else:
            found[f"{before}{name}"] = value
    return found


def _is_rows(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(one, dict) for one in value)


def _joined(value: Any) -> Any:
    return " ".join(map(str, value)) if isinstance(value, list) else value


def _shown(value: Any, unit: str) -> tuple[str, str]:
    """A value and its unit for people."""
    if isinstance(value, list):
        numbers = [one for one in value if isinstance(one, int | float)]
        if any(isinstance(one, list | dict) for one in value):
            return f"{len(value)} rows", unit
        if len(value) > _FEW and len(numbers) == len(value):
            return f"{len(value)} values, {min(numbers):.4g} to {max(numbers):.4g}", unit
        more = f" ... ({len(value)} values)" if len(value) > _FEW else ""
        return " ".join(_shown(one, "")[0] for one in value[:_FEW]) + more, unit
    if unit == "B" and isinstance(value, int | float):
        return f"{value / 1e6:.4g}", "MB"
    return (f"{value:.5g}" if isinstance(value, float) else "-" if value is None else str(value)), unit
