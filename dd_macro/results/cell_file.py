"""HDF5 files with a row for every cell of a mesh, in the order in which it was read or built; ranks take turns."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dd_macro.parallel import atomic_path_of_all, in_turn
from dd_macro.scene.mesh import TaggedMesh
from tsg_micro.data.hdf5 import seal

__all__ = ["rows_of", "write_by_cell"]

_WINDOW = 16_384
"""Cells that are read and written at once, which bounds the memory of a rank."""
_OVERHEAD = 2**16
"""Bytes that HDF5 adds to the arrays, generously."""


def rows_of(domain: TaggedMesh) -> NDArray[np.int64]:
    """Row of every owned cell (cells,), the same on any number of ranks."""
    return np.asarray(domain.mesh.topology.original_cell_index[: domain.owned_cells], dtype=np.int64)


def write_by_cell(
    path: str | Path,
    domain: TaggedMesh,
    fields: Mapping[str, NDArray[Any]],
    *,
    units: Mapping[str, str],
    attributes: Mapping[str, Any],
) -> None:
    """Write ``fields`` (cells, ...) of owned cells to the file ``path``, whole or not at all, sealed; collective.

    Raises:
        InputError: the folder cannot be written, the disk is full, or a rank fails to write its part; on all ranks.
    """
    rows = rows_of(domain)
    order = np.argsort(rows)
    rows, count = rows[order], domain.global_cells

    def write_part() -> None:
        with h5py.File(temporary, "a") as file:
            if "format" not in file.attrs:
                for name, value in attributes.items():
                    file.attrs[name] = value
                for name, values in fields.items():
                    file.create_dataset(name, (count, *values.shape[1:]), values.dtype).attrs["unit"] = units[name]
            for begin in range(0, count, _WINDOW):
                end = min(begin + _WINDOW, count)
                first, last = np.searchsorted(rows, [begin, end])
                if first == last:
                    continue
                for name, values in fields.items():
                    window = file[name][begin:end]
                    window[rows[first:last] - begin] = values[order[first:last]]
                    file[name][begin:end] = window

    size = domain.comm.allreduce(sum(values.nbytes for values in fields.values()))
    with atomic_path_of_all(domain.comm, path, size=size + _OVERHEAD, finish=seal) as temporary:
        in_turn(domain.comm, write_part)
