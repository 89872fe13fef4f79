"""Where a run along load steps stands, kept on disk after every step, so that a killed run goes on from there.

One HDF5 file, written whole or not at all. It holds the displacement, which with the parameters decides all else,
and a row of figures for every step that is done. A fingerprint of the parameters says which run it belongs to, a
checksum whether it is as it was written.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import h5py
import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.hdf5 import open_hdf5, write_hdf5
from workflows.store.record import versions

__all__ = [
    "Checkpoint",
    "LoadStep",
    "fingerprint",
    "latest_checkpoint",
    "read_checkpoint",
    "remove_checkpoint",
    "write_checkpoint",
]

Array = NDArray[np.float64]


class LoadStep(NamedTuple):
    """A recorded load step: how it ended, and what it took."""

    answer: float
    """What the run is about: the nominal stress of a sheet, Pa, or the stored energy of a body, J."""
    residual: float
    """Largest out-of-balance force over the mean member force."""
    iterations: int
    factorisations: int
    load_steps: int
    """Parts that the step was taken in."""
    negative_pivots: int
    """Of the tangent at its end."""
    most_negative_pivots: int
    """On the way."""
    seconds: float
    peak_memory: int
    """Of the process so far, bytes."""


_ROW = np.dtype([(name, "f8" if kind is float else "i8") for name, kind in get_type_hints(LoadStep).items()])


@dataclass(frozen=True)
class Checkpoint:
    """A run after the load steps ``done``."""

    displacement: Array
    """Of all nodes (n, 3), m."""
    done: tuple[LoadStep, ...] = ()


def fingerprint(parameters: Mapping[str, Any]) -> str:
    """Hash of all ``parameters`` that decide an answer, and of the version of this software."""
    decisive = {"tsgdd": versions()["tsgdd"], "parameters": dict(parameters)}
    text = json.dumps(
        decisive, sort_keys=True, allow_nan=False, default=lambda value: value.tolist()
    )  # NumPy's numbers
    return hashlib.sha256(text.encode()).hexdigest()


def _checksum(displacement: Array, rows: NDArray[np.void]) -> str:
    return hashlib.sha256(displacement.tobytes() + rows.tobytes()).hexdigest()


def write_checkpoint(path: Path, checkpoint: Checkpoint, run: str) -> None:
    """Write ``checkpoint`` of the run with fingerprint ``run``, over the one before."""
    rows = np.array(list(checkpoint.done), dtype=_ROW)

    def fill(file: h5py.File) -> None:
        file.attrs["fingerprint"] = run
        file.attrs["steps_done"] = len(rows)
        file.attrs["checksum"] = _checksum(checkpoint.displacement, rows)
        file["displacement"] = checkpoint.displacement
        file["displacement"].attrs["unit"] = "m"
        file["steps"] = rows

    write_hdf5(path, fill)


def read_checkpoint(path: Path, run: str, shape: tuple[int, ...]) -> Checkpoint:
    """The checkpoint of the run with fingerprint ``run``, whose displacement has this ``shape``.

    Raises:
        InputError: it is another run's, or damaged.
    """
    try:
        with open_hdf5(path, "checkpoint", ("displacement",)) as file:
            found, expected = str(file.attrs["fingerprint"]), str(file.attrs["checksum"])
            displacement, rows = file["displacement"][()], file["steps"][()]
            sound = displacement.shape == shape and rows.dtype == _ROW and _checksum(displacement, rows) == expected
    except (OSError, LookupError, ValueError, TypeError, AttributeError, RuntimeError):  # h5py raises any of these
        raise InputError(f"{path.name} is damaged") from None
    if found != run:
        raise InputError(f"{path.name} is of a run with other parameters or of another version")
    if not sound:
        raise InputError(f"{path.name} is damaged")
    return Checkpoint(displacement, tuple(LoadStep(*row) for row in rows.tolist()))


def latest_checkpoint(path: Path, run: str, shape: tuple[int, ...], say: Callable[[str], None]) -> Checkpoint:
    """Where the run with fingerprint ``run`` begins: at its checkpoint, or at rest where there is none of it."""
    if path.exists():
        try:
            return read_checkpoint(path, run, shape)
        except InputError as error:
            say(f"{error}: starting from the beginning")
    return Checkpoint(np.zeros(shape))


def remove_checkpoint(path: Path) -> None:
    """Remove the checkpoint, and what kills in the middle of a write have left beside it."""
    for file in (path, *path.parent.glob(f".{path.stem}-*{path.suffix}")):
        file.unlink(missing_ok=True)
