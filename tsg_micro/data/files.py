"""Results reach the disk whole: written beside their final name, then renamed over it."""

from __future__ import annotations

import contextlib
import errno
import os
import platform
import re
import stat
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path

from tsg_micro.data.errors import InputError, OutputError

__all__ = ["atomic_path", "check_regular", "locked", "output_file", "output_folder", "remove_leftovers", "reserve"]

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_HOST = f"{zlib.crc32(platform.node().encode()):08x}"
_OWNER = f"{_HOST}-{os.getpid()}"
_TEMPORARY = re.compile(r"^\..*-([0-9a-f]{8})-(\d+)-[a-z0-9_]{8}(\.\w+)?$")
"""Temporary files by the machine and the process that writes them."""


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path in the same folder, and rename it to ``path`` when the block ends well.

    A run that is killed inside the block leaves the old file, or none; never half a file.
    The suffix is kept, since writers choose their format by it.

    Raises:
        InputError: the folder does not exist or cannot be written.
        OutputError: the disk is full or fails; ``path`` is as it was.
    """
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-{_OWNER}-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        kind = OutputError if error.errno in _FULL else InputError
        raise kind(f"output {path}: its folder cannot be written ({error.strerror})") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except InputError:
        raise
    except OSError as error:
        why = os.strerror(error.errno) if error.errno else " ".join(str(error).split())
        raise OutputError(f"output {path}: cannot be written ({why}); what was there is as before") from None
    finally:
        temporary.unlink(missing_ok=True)


def check_regular(path: str | Path) -> None:
    """Raise OSError where ``path`` is a pipe or a device, which may never end; a folder is for the reader to refuse."""
    mode = os.stat(path).st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EINVAL, "it is a pipe or a device", str(path))


def reserve(path: Path, size: int) -> None:
    """Make room for ``size`` bytes on the disk, so that what is written into the file later cannot want for it.

    Raises:
        OSError: there is no room.
    """
    if hasattr(os, "posix_fallocate") and size > 0:
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, size)


@contextlib.contextmanager
def locked(path: str | Path) -> Iterator[None]:
    """Keep other processes that lock the same ``path`` out of the block; they wait for its end."""
    from filelock import FileLock

    path = Path(path)
    with FileLock(path.with_name(f".{path.name}.lock"), is_singleton=True):
        yield


def remove_leftovers(folder: Path) -> None:
    """Remove what killed processes of this machine have left in the middle of a write."""
    for file in folder.glob(".*"):
        found = _TEMPORARY.match(file.name)
        if not found or found[1] != _HOST or found[2] == str(os.getpid()):
            continue
        with contextlib.suppress(ProcessLookupError, OSError):
            try:
                os.kill(int(found[2]), 0)
            except ProcessLookupError:
                file.unlink(missing_ok=True)


def output_folder(path: str | Path) -> Path:
    """Make the folder ``path`` if need be, check that a file can be written into it, and tidy up after killed runs.

    Raises:
        InputError: it cannot be made, is a file, or cannot be written.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        kind = OutputError if error.errno in _FULL else InputError
        raise kind(f"output folder {path}: cannot be written ({error.strerror})") from None
    remove_leftovers(path)
    return path


def output_file(path: str | Path) -> Path:
    """Check that the HDF5 file ``path`` can be written, and make its folder if need be.

    Raises:
        InputError: the name does not end in .h5, it is a folder, or its folder cannot be written.
    """
    path = Path(path)
    if path.suffix not in (".h5", ".hdf5"):
        raise InputError(f"out: expected a file name that ends in .h5, got {path}")
    if path.is_dir():
        raise InputError(f"out: expected a file, got the folder {path}")
    output_folder(path.parent)
    return path
