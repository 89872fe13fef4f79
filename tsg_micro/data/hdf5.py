"""HDF5 files written whole and sealed with a digest, and read from strangers without trust.

A file is made in memory and written as plain bytes, so that a full disk is an error of Python's and none inside HDF5.
The seal is 79 bytes behind its end, where HDF5 does not look: a mark and the SHA-256 of all before. A sealed file is
read as it was written or not at all. One without (made elsewhere, or changed since) is first read by a process of its
own.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tsg_micro.data import hdf5_inspect
from tsg_micro.data.errors import InputError, OutputError
from tsg_micro.data.files import atomic_path

__all__ = ["open_hdf5", "read_array", "seal", "text", "write_hdf5"]

_MARK = b"\ntsgdd sha256 "
_SEAL = len(_MARK) + 64 + 2
_PATIENCE = 60.0
"""s; for a disk that does not answer. A file that keeps the processor busy is given up after half a second."""


def write_hdf5(path: str | Path, fill: Callable[[h5py.File], None]) -> None:
    """Write the HDF5 file ``path``, whole or not at all, with what ``fill`` puts into it.

    Raises:
        InputError: the folder does not exist or cannot be written.
        OutputError: the disk is full or fails; the old file is as it was.
    """
    with atomic_path(path) as temporary:
        with h5py.File(temporary.name, "w", driver="core", backing_store=False) as file:
            fill(file)
            file.flush()
            image = file.id.get_file_image()
        temporary.write_bytes(image)
        seal(temporary)


def seal(path: Path) -> None:
    """Put the seal behind the closed HDF5 file ``path``, and read it back.

    Raises:
        OutputError: it is not there as it was written.
    """
    digest = _digest(path, path.stat().st_size)
    with path.open("ab") as file:
        file.write(_MARK + digest + b"\n\n")
    if not _sealed(path):
        raise OutputError(f"output {path}: cannot be read back as it was written")


@contextlib.contextmanager
def open_hdf5(path: str | Path, what: str, names: Sequence[str]) -> Iterator[h5py.File]:
    """Open the file ``path`` to read the arrays ``names``; ``what`` it is begins every message.

    Raises:
        InputError: it is missing, no HDF5 file, locked by another program, damaged, or holds what would take more
            memory than its size tells; so are errors of h5py, NumPy and JSON within the block.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{what} {path}: no such file")
    try:
        if not _sealed(path):
            _look(path, what, names)
        file = h5py.File(path, "r")
    except InputError as error:
        raise error if str(error).startswith(what) else InputError(f"{what} {path}: {error}") from None
    except BlockingIOError:
        raise _locked(path, what) from None
    except OSError as error:
        if error.errno == 13:
            raise InputError(f"{what} {path}: cannot be read ({os.strerror(13)})") from None
        raise InputError(f"{what} {path}: expected an HDF5 file, but it cannot be read as one") from None
    with file:
        try:
            hdf5_inspect.check_attributes(file)
            yield file
        except InputError as error:
            raise InputError(f"{what} {path}: {error}") from None
        except (KeyError, OSError, TypeError, ValueError, RuntimeError, RecursionError, AttributeError) as error:
            raise InputError(f"{what} {path}: damaged ({' '.join(str(error).split())})") from None


def read_array(file: h5py.File, name: str, unit: str) -> NDArray[Any]:
    """The array ``name``, whose attribute ``unit`` must say so, in this machine's order of bytes.

    Raises:
        InputError: it is no array of numbers, in another unit, or not wholly in the file.
    """
    hdf5_inspect.check_link(file, name)
    stored = file[name]
    if not (isinstance(stored, h5py.Dataset) and stored.ndim > 0 and np.issubdtype(stored.dtype, np.number)):
        raise InputError(f"{name}: expected an array of numbers, got {stored!r}")
    hdf5_inspect.check_array(stored, name, os.path.getsize(file.filename))
    found = text(stored.attrs.get("unit"))
    if found != unit:
        raise InputError(f"{name}: expected the unit {unit!r}, got {found!r}")
    values = stored[()]
    return np.asarray(values, dtype=values.dtype.newbyteorder("="))


def text(value: Any) -> Any:
    """The text of an attribute, however it is stored: of fixed or variable length, padded, or in an array of one."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    if isinstance(value, np.ndarray) and value.dtype.kind == "S" and value.dtype.itemsize == 1:
        value = value.tobytes()  # a text as an array of letters
    if isinstance(value, bytes):
        value = value.split(b"\0")[0].decode("utf-8", "replace").rstrip()
    return str(value).rstrip() if isinstance(value, str) else value


def _sealed(path: Path) -> bool:
    """Whether the file has a seal; InputError where that does not fit."""
    size = path.stat().st_size
    with path.open("rb") as file:
        _check_lock(file.fileno())
        head = file.read(48)
        file.seek(max(size - _SEAL, 0))
        tail = file.read(_SEAL)
    if tail.startswith(_MARK):
        if tail != _MARK + _digest(path, size - _SEAL) + b"\n\n":
            raise InputError("damaged (its digest is not that of its content)")
        return True
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        end = head[40:48] if head[8] < 2 else head[28:36]
        if int.from_bytes(end, "little") + _SEAL == size:
            raise InputError("damaged (its digest cannot be read)")
    return False


def _check_lock(descriptor: int) -> None:
    """Raise BlockingIOError where another program has the file open to write, as HDF5 marks it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # a file system without locks
        return


def _digest(path: Path, size: int) -> bytes:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while size > 0 and (part := file.read(min(size, 2**22))):
            digest.update(part)
            size -= len(part)
    return digest.hexdigest().encode()


def _look(path: Path, what: str, names: Sequence[str]) -> None:
    """Read the file in a process of its own; InputError where that does not end well."""
    with path.open("rb") as file:
        heads = {file.read(8)}
        for place in (512, 1024, 2048):  # behind a user block, as MATLAB has it
            file.seek(place)
            heads.add(file.read(8))
    if b"\x89HDF\r\n\x1a\n" not in heads:
        raise InputError("expected an HDF5 file, but it cannot be read as one")
    command = [sys.executable, "-P", hdf5_inspect.__file__, str(path.resolve()), *names]
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_PATIENCE,
            check=False,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "HDF5_PLUGIN_PATH": "::"},
        )
    except subprocess.TimeoutExpired:
        raise InputError("damaged (reading it does not end)") from None
    if done.returncode == 4:
        raise _locked(path, what)
    if done.returncode == 3 and "truncated file" in done.stdout:
        raise InputError(f"expected an HDF5 file, but it cannot be read as one ({done.stdout.strip()})")
    if done.returncode:
        raise InputError(f"damaged ({done.stdout.strip() or 'reading it does not end, or ends the reader'})")


def _locked(path: Path, what: str) -> InputError:
    return InputError(f"{what} {path}: is locked by another program that has it open; close it there")
