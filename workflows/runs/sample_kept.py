"""Sampled paths kept on disk while a run goes on, so that the same command goes on from there after a kill.

One HDF5 file a rank beside the output, hidden, named by the run's fingerprint: all paths that are done. It is written
anew every few seconds, less often where that takes long, and removed at the end.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tsg_micro.continuum.sampling import PathData
from tsg_micro.data.errors import InputError
from tsg_micro.data.hdf5 import open_hdf5, text, write_hdf5

__all__ = ["KeptPaths"]

_EVERY, _SHARE = 2.0, 0.02
"""s between two writes at least, and the part of the time that they may take."""
_ARRAYS = ("F", "first_piola", "energy", "tangent", "support", "support_tangent")


class KeptPaths:
    """The paths of one run, of this rank: those ``done`` are there from an earlier part of it, or come by :meth:`add`.

    ``comm`` is that of the ranks that share the work, None where there is one; making it is collective.
    """

    def __init__(self, out: Path, run: str, comm: Any = None) -> None:
        self._comm, self._rank = comm, 0 if comm is None else comm.rank
        self._pattern = f".{out.stem}-*.paths.h5"
        self._own = f".{out.stem}-{run[:16]}"
        self._folder, self._run = out.parent, run
        self._path = self._folder / f"{self._own}-{self._rank}.paths.h5"
        self.done: list[PathData] = []
        self._next = 0.0
        if self._rank == 0:
            self.done = self._found()
        self._numbers = {data.path for data in self.done}
        if comm is not None:
            self._numbers = comm.bcast(self._numbers)
        self._next = time.monotonic() + _EVERY

    def _found(self) -> list[PathData]:
        """What all ranks of an earlier part have kept, in this rank's file from now on."""
        files = sorted(self._folder.glob(f"{self._own}-*.paths.h5"))
        known: dict[int, PathData] = {}
        for file in files:
            with contextlib.suppress(InputError):  # of another version, or damaged
                known |= {data.path: data for data in _read(file, self._run)}
        if known:
            _write(self._path, self._run, list(known.values()))
        for file in files:
            if file != self._path:
                file.unlink(missing_ok=True)
        return list(known.values())

    def left(self, paths: int) -> list[int]:
        """Numbers below ``paths`` of those that no rank has done."""
        return [path for path in range(paths) if path not in self._numbers]

    def add(self, data: Sequence[PathData]) -> None:
        """Paths that are done; written when it is time."""
        self.done += data
        if time.monotonic() > self._next:
            self.write()

    def write(self) -> None:
        """Write all that is done."""
        begin = time.monotonic()
        if self.done:
            _write(self._path, self._run, self.done)
        end = time.monotonic()
        self._next = end + max(_EVERY, (end - begin) / _SHARE)

    def remove(self, *, others: bool) -> None:
        """The data are in the file now: remove what was kept of them, and of ``others`` that were to make the file."""
        for file in self._folder.glob(self._pattern if others else f"{self._own}-*.paths.h5"):
            file.unlink(missing_ok=True)


def _write(path: Path, run: str, done: Sequence[PathData]) -> None:
    def fill(file: h5py.File) -> None:
        file.attrs["run"] = run
        told = [[data.path, len(data.F), data.negative_pivots, data.failure, data.free] for data in done]
        file.create_dataset("paths", data=np.frombuffer(json.dumps(told).encode(), dtype=np.uint8))
        for name in _ARRAYS:
            parts = [getattr(data, name) for data in done]
            if parts[0] is not None:
                file.create_dataset(name, data=np.concatenate(parts))

    write_hdf5(path, fill)


def _read(path: Path, run: str) -> list[PathData]:
    """The paths of a file; raises InputError where it is another run's or damaged."""
    with open_hdf5(path, "sampled paths", ("paths", *_ARRAYS)) as file:
        if text(file.attrs.get("run")) != run:
            raise InputError("is of another run")
        told = json.loads(file["paths"][()].tobytes())
        ends = np.cumsum([count for _, count, *_ in told])[:-1]
        arrays = {name: np.split(file[name][()], ends) for name in _ARRAYS if name in file}
        done = []
        for k, (number, _, negative, failure, free) in enumerate(told):
            own: dict[str, Any] = {name: parts[k] for name, parts in arrays.items()}
            done.append(PathData(number, negative_pivots=negative, failure=failure, free=tuple(free), **own))
        return done
