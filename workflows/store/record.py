"""What every workflow leaves behind: summary.json with parameters, versions and figures with their units."""

from __future__ import annotations

import contextlib
import csv
import importlib.metadata
import json
import math
import os
import platform
import resource
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path, check_regular
from tsg_micro.data.version import VERSION

__all__ = [
    "drop_summary",
    "machine",
    "number",
    "peak_memory",
    "read_summary",
    "summary_path",
    "versions",
    "write_summary",
    "write_table",
]

_PACKAGES = ("numpy", "scipy", "h5py", "fenics-dolfinx", "dolfinx-solver-real", "pypardiso", "mpi4py")


def versions() -> dict[str, str]:
    """Versions of this software, of Python and of the packages that decide the numbers."""
    found = {"tsgdd": VERSION, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def machine() -> dict[str, Any]:
    """The processor and how many of its cores this process may use."""
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    named = [line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")]
    return {"processor": named[0] if named else platform.machine(), "cores": len(os.sched_getaffinity(0))}


def peak_memory() -> int:
    """Largest resident memory of this process so far, bytes."""
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024  # a child counts its parent's from before exec


def summary_path(out: Path) -> Path:
    """Where the summary of output ``out`` goes: into a folder, or beside a file as NAME.summary.json."""
    return out / "summary.json" if out.is_dir() else out.with_name(f"{out.stem}.summary.json")


def drop_summary(out: Path, comm: Any = None) -> None:
    """Remove the summary of output ``out`` before its files are written anew, so that none stands beside other files.

    Every rank of ``comm`` comes back after the first has done so.
    """
    if comm is None or comm.rank == 0:
        summary_path(out).unlink(missing_ok=True)
    if comm is not None:
        comm.Barrier()


class _Summary(dict[str, Any]):
    """A summary as it was read, in which a name that is missing is an error of the input."""

    def __init__(self, values: Mapping[str, Any], path: Path) -> None:
        super().__init__(values)
        self.path = path

    def __missing__(self, name: str) -> Any:
        raise InputError(f"{self.path}: damaged (expected {name!r}, it is missing)")


def write_summary(
    out: Path, *, command: str, parameters: Mapping[str, Any], figures: Mapping[str, tuple[Any, str]]
) -> dict[str, Any]:
    """Write and return the summary: ``figures`` maps a name to its value (SI) and unit ("" for none)."""
    summary = {
        "command": command,
        "parameters": dict(parameters),
        "versions": versions(),
        "machine": machine(),
        "units": {name: unit for name, (_, unit) in figures.items() if unit},
        **{name: value for name, (value, _) in figures.items()},
    }
    with atomic_path(summary_path(out)) as temporary:
        temporary.write_text(json.dumps(summary, indent=2, default=_plain, allow_nan=False) + "\n")
    return summary


def write_table(path: Path, rows: Sequence[Mapping[str, Any]], title: str | None = None) -> None:
    """Write rows of equal names as CSV, after a line ``# title`` if there is one; whole or not at all."""
    with atomic_path(path) as temporary, temporary.open("w", newline="") as stream:
        if title is not None:
            stream.write(f"# {title}\n")
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _plain(value: object) -> object:
    """Paths and NumPy values as JSON knows them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value)


def read_summary(folder: Path, *commands: str) -> dict[str, Any]:
    """The summary that one of ``commands``, any if none is named, wrote into ``folder``, or beside it if it is a file.

    ``folder`` may be the summary itself.

    Raises:
        InputError: it is not there, is no summary, or another command's.
    """
    path = summary_path(folder) if folder.is_file() else folder / "summary.json"
    if folder.is_file() and folder.name.endswith("summary.json"):
        path = folder
    kind = "file" if folder.is_file() else "folder"
    expected = f"expected a {kind} made by {' or '.join(f"'tsgdd {command}'" for command in commands) or 'tsgdd'}"
    try:
        check_regular(path)
        summary = json.loads(path.read_text(), parse_int=_whole)
    except OSError:
        raise InputError(f"{folder}: {expected}, it has no {path.name}") from None
    except (ValueError, OverflowError, RecursionError):  # not JSON, not even text, or no number that a figure has
        raise InputError(f"{path}: expected JSON, it cannot be read as such") from None
    command = summary.get("command") if isinstance(summary, dict) else None
    ours = isinstance(command, str) and (not commands or command in commands)
    if not ours or not isinstance(summary.get("parameters"), dict):
        raise InputError(f"{folder}: {expected}, its {path.name} is another's")
    summary["parameters"] = _Summary(summary["parameters"], path)
    return _Summary(summary, path)


def _whole(digits: str) -> int:
    float(int(digits))  # OverflowError where there are too many
    return int(digits)


def number(summary: Mapping[str, Any], name: str) -> float:
    """The figure ``name`` of a summary that was read.

    Raises:
        InputError: it is missing, or no finite number.
    """
    value = summary[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"summary.json: damaged (expected a number for {name}, got {value!r})")
    return value
