"""What an HDF5 file may hold, and a look at a whole file in a process of its own, which a damaged one may hang or end.

Run as a program: ``python hdf5_inspect.py FILE NAME ...`` reads the root's attributes and the arrays of these names,
and prints what is wrong (exit code 3). It imports nothing of this package, so that it starts fast.
"""

from __future__ import annotations

import math
import os
import resource
import signal
import sys

import h5py
import numpy as np

__all__ = ["LARGEST_ATTRIBUTE", "check_array", "check_attributes", "check_link"]

LARGEST_ATTRIBUTE = 2**24
"""Bytes."""
_FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32", 4: "szip", 5: "nbit", 6: "scaleoffset", 32000: "lzf"}
_MOST_RATIO = 1100
"""Of size to stored size; that of gzip is 1032 at most."""
_CHUNK = 2**26


def check_link(file: h5py.File, name: str) -> None:
    """Raise ValueError where ``name`` is a link to somewhere else: to another file, or to a path."""
    link = file.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise ValueError(f"{name}: expected an array in the file itself, got a link to elsewhere")


def check_array(stored: h5py.Dataset, name: str, size: int) -> None:
    """Raise ValueError where the array is not wholly in its file of ``size`` bytes, or takes more memory than that."""
    plan = stored.id.get_create_plist()
    if stored.is_virtual or plan.get_external_count():
        raise ValueError(f"{name}: expected an array in the file itself, got one that is stored in other files")
    used = [plan.get_filter(i)[0] for i in range(plan.get_nfilters())]
    unknown = [code for code in used if code not in _FILTERS]
    if unknown:
        raise ValueError(f"{name}: expected filters among {', '.join(_FILTERS.values())}, got number {unknown[0]}")
    wanted, there = math.prod(stored.shape) * stored.dtype.itemsize, stored.id.get_storage_size()
    if wanted > (_MOST_RATIO if set(used) & {1, 4, 5, 6, 32000} else 1) * max(there, 0) or there > size:
        raise ValueError(f"{name}: {wanted} bytes are expected, {there} are stored in a file of {size}")
    if stored.chunks is not None:
        if math.prod(stored.chunks) * stored.dtype.itemsize > max(_CHUNK, wanted):
            raise ValueError(f"{name}: expected chunks no larger than the array, got {stored.chunks}")
        chunks = math.prod(-(-n // c) for n, c in zip(stored.shape, stored.chunks, strict=True))
        if stored.id.get_num_chunks() < chunks:
            raise ValueError(f"{name}: {stored.id.get_num_chunks()} of {chunks} chunks are stored")


def check_attributes(owner: h5py.File | h5py.Dataset) -> None:
    """Raise ValueError where an attribute is larger than any of ours."""
    for name in owner.attrs:
        if owner.attrs.get_id(name).get_storage_size() > LARGEST_ATTRIBUTE:
            raise ValueError(f"attribute {name}: expected less than {LARGEST_ATTRIBUTE} bytes")


def _inspect(path: str, names: list[str]) -> None:
    size = os.path.getsize(path)
    with h5py.File(path, "r") as file:
        check_attributes(file)
        dict(file.attrs)
        for name in names:
            if name not in file:
                continue
            check_link(file, name)
            stored = file[name]
            if isinstance(stored, h5py.Dataset) and stored.ndim > 0 and np.issubdtype(stored.dtype, np.number):
                check_array(stored, name, size)
                check_attributes(stored)
                dict(stored.attrs)
                _allow(stored.nbytes)
                stored[()]


def _allow(size: int) -> None:
    """Half a second of the processor from now on, more for many bytes; then a signal ends the process in any C code."""
    signal.setitimer(signal.ITIMER_PROF, 0.5 + size / 5e7)


def _main() -> int:
    path, *names = sys.argv[1:]
    size = os.path.getsize(path)
    resource.setrlimit(resource.RLIMIT_AS, (2**32 + 4 * size, 2**32 + 4 * size))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _allow(size)
    try:
        _inspect(path, names)
    except BlockingIOError:
        return 4
    except (Exception, RecursionError, MemoryError) as error:
        sys.stdout.write(" ".join(str(error).split())[:300] or type(error).__name__)
        return 3
    return 0


if __name__ == "__main__":
    code = _main()
    sys.stdout.flush()
    os._exit(code)  # nothing of a damaged file is closed
