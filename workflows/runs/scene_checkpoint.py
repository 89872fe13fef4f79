"""Where a run along the steps of a scene stands: state, data and rows of the last step, on disk after every one."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dd_macro as dd
from dd_macro.methods.projection import MechanicalState
from dd_macro.parallel import together
from dd_macro.results.state_file import read_state, write_state
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import read_dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path, check_regular

__all__ = ["Standing", "read_standing", "remove_standing", "write_standing"]

_NAME = "checkpoint"


@dataclass(frozen=True)
class Standing:
    """The ``rows`` of all steps that are done, the ``state`` after the last, and the data of an adaptive run."""

    rows: list[dict[str, Any]]
    state: MechanicalState
    data: tuple[Dataset, ...] = ()


def write_standing(out: Path, problem: dd.Problem, standing: Standing, run: str) -> None:
    """Write checkpoint-N.h5, its data, and last of all checkpoint.json, which names them; collective.

    Raises:
        InputError: the folder cannot be written, or the disk is full; on all ranks.
    """
    comm, number = problem.operator.comm, len(standing.rows)
    write_state(out / f"{_NAME}-{number}.h5", problem, standing.state, run)

    def rest() -> None:
        if comm.rank > 0:
            return
        for k, data in enumerate(standing.data):
            write_dataset(out / f"{_NAME}-{number}-data-{k}.h5", data)
        content = {"run": run, "rows": standing.rows, "data": len(standing.data)}
        with atomic_path(out / f"{_NAME}.json") as temporary:
            temporary.write_text(json.dumps(content, allow_nan=False))
        _remove(out, f"{_NAME}-{number - 1}*.h5")

    together(comm, rest)


def read_standing(out: Path, problem: dd.Problem, run: str) -> Standing | None:
    """Where the run with the fingerprint ``run`` stands; None where there is nothing of it; collective.

    Raises:
        InputError: it is another run's, or damaged; on all ranks.
    """
    comm = problem.operator.comm
    content = comm.bcast(_content(out) if comm.rank == 0 else None)
    if content is None:
        return None
    number, sound = len(content.get("rows", ())), isinstance(content.get("data"), int)
    if content.get("run") != run or not sound or number == 0:
        raise InputError(f"{_NAME}.json is of a run with other parameters, or damaged")
    state = read_state(out / f"{_NAME}-{number}.h5", problem, run)
    paths = [out / f"{_NAME}-{number}-data-{k}.h5" for k in range(content["data"])]
    data = together(comm, lambda: tuple(read_dataset(path) for path in paths))
    return Standing(content["rows"], state, data)


def _content(out: Path) -> dict[str, Any] | None:
    path = out / f"{_NAME}.json"
    if not path.exists():
        return None
    try:
        check_regular(path)
        found = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError):
        found = {}
    return found if isinstance(found, dict) else {}


def remove_standing(out: Path) -> None:
    """Remove all of it."""
    (out / f"{_NAME}.json").unlink(missing_ok=True)
    _remove(out, f"{_NAME}-*.h5")


def _remove(out: Path, pattern: str) -> None:
    for path in out.glob(pattern):
        path.unlink(missing_ok=True)
