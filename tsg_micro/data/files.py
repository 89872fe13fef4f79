"""Results reach the disk whole: written beside their final name, then renamed over it."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tsg_micro.data.errors import InputError

__all__ = ["atomic_path", "output_file", "output_folder"]


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path in the same folder, and rename it to ``path`` when the block ends well.

    A run that is killed inside the block leaves the old file, or none; never half a file.
    The suffix is kept, since writers choose their format by it.

    Raises:
        InputError: the folder does not exist or cannot be written.
    """
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise InputError(f"output {path}: its folder cannot be written ({error.strerror})") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def output_folder(path: str | Path) -> Path:
    """Make the folder ``path`` if need be, and check that a file can be written into it.

    Raises:
        InputError: it cannot be made, is a file, or cannot be written.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise InputError(f"output folder {path}: cannot be written ({error.strerror})") from None
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
