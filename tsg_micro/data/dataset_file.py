"""The file of a data set: written whole, read with its units and format checked, added to in turns.

One HDF5 schema (version 1). Root attributes: ``format`` = "tsgdd-dataset", ``schema``, ``stress_measure``,
``seed``, ``parameters`` and ``versions`` (JSON). Arrays as :class:`Dataset` has them, each with an attribute ``unit``.
The attribute ``silent`` (JSON, none if it is not there) names strain components that the data say nothing about.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.dataset import REQUIRED, UNITS, Dataset, join_datasets
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import locked
from tsg_micro.data.hdf5 import open_hdf5, read_array, text, write_hdf5

__all__ = ["append_dataset", "read_dataset", "write_dataset"]

FORMAT, SCHEMA = "tsgdd-dataset", 1
_WHOLE = ("path", "step", "source")


def write_dataset(path: str | Path, dataset: Dataset) -> None:
    """Write ``dataset`` to the HDF5 file ``path``, whole or not at all, with a digest of its content.

    Raises:
        InputError: the folder does not exist or cannot be written; an OutputError, one of these, if the disk is full.

    Example:
        >>> strain = 0.01 * np.eye(6)
        >>> number = np.arange(6)
        >>> tsg.write_dataset("data.h5", tsg.Dataset(strain, 1e3 * strain, "cauchy", path=number, step=0 * number))
        >>> tsg.read_dataset("data.h5").stress_measure
        'cauchy'
    """

    def fill(file: h5py.File) -> None:
        file.attrs["format"] = FORMAT
        file.attrs["schema"] = SCHEMA
        file.attrs["stress_measure"] = dataset.stress_measure
        file.attrs["parameters"] = json.dumps(dataset.parameters)
        file.attrs["versions"] = json.dumps(dataset.versions)
        if dataset.silent:
            file.attrs["silent"] = json.dumps(dataset.silent)
        if dataset.seed is not None:
            file.attrs["seed"] = dataset.seed
        for name, array in dataset.arrays().items():
            file.create_dataset(name, data=array).attrs["unit"] = UNITS[name]

    write_hdf5(path, fill)


def read_dataset(path: str | Path) -> Dataset:
    """Read and validate a data set.

    Raises:
        InputError: the file is missing, not HDF5, locked, damaged, of another format or schema, in other units, or
            incomplete.
    """
    with open_hdf5(path, "data set", list(UNITS)) as file:
        return _parse(file)


def _parse(file: h5py.File) -> Dataset:
    """The data set in an open file; any error of h5py, NumPy or JSON means that it is damaged."""
    attributes = {name: text(value) for name, value in file.attrs.items()}
    if attributes.get("format") != FORMAT:
        raise InputError(f"expected the HDF5 attribute format={FORMAT!r}, got {attributes.get('format')!r}")
    if attributes.get("schema") != SCHEMA:
        raise InputError(f"expected schema {SCHEMA}, got {attributes.get('schema')}")
    missing = [name for name in REQUIRED if name not in file]
    if missing:
        raise InputError(f"expected the arrays {', '.join(REQUIRED)}, {missing[0]} is missing")
    arrays = {name: read_array(file, name, unit) for name, unit in UNITS.items() if name in file}
    for name in (name for name in _WHOLE if name in arrays):
        arrays[name] = _counts(name, arrays[name])
    seed = attributes.get("seed")
    return Dataset(
        **arrays,
        stress_measure=str(attributes.get("stress_measure")),
        parameters=json.loads(attributes.get("parameters", "{}")),
        versions=json.loads(attributes.get("versions", "{}")),
        silent=tuple(json.loads(attributes.get("silent", "[]"))),
        seed=None if seed is None else int(seed),
    )


def _counts(name: str, values: NDArray[Any]) -> NDArray[np.int64]:
    """Whole numbers, which other programs store as floating-point ones."""
    if values.dtype.kind in "iu":
        return values
    if values.dtype.kind != "f" or not (np.abs(values) < 2**53).all() or (values != np.floor(values)).any():
        raise InputError(f"{name}: expected whole numbers, got {values.dtype} with others")
    return values.astype(np.int64)


def append_dataset(path: str | Path, dataset: Dataset) -> Dataset:
    """Add ``dataset`` to the file ``path``, or make it, and return all it holds now; it changes whole or not at all.

    Processes that append to one file take turns (tsg_micro.data.files.locked).

    Raises:
        InputError: as :func:`read_dataset` and :func:`write_dataset`, or the file holds another stress measure.
    """
    path = Path(path)
    with locked(path):
        stored = join_datasets(read_dataset(path), dataset) if path.exists() else dataset
        write_dataset(path, stored)
    return stored
