"""A tissue as a TOML file that people write and read: bar_force, unit, and the tables [cell] and [law]."""

from __future__ import annotations

import tomllib
from pathlib import Path

import tomli_w

from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path, check_regular

__all__ = ["read_tissue", "write_tissue"]

_LARGEST = 100_000


def read_tissue(path: str | Path) -> Tissue:
    """The tissue in a TOML file; what it does not say is at its default.

    Raises:
        InputError: the file cannot be read, is no TOML, has an unknown key, or a value that is not valid.
    """
    try:
        check_regular(path)
        with Path(path).open("rb") as file:
            content = file.read(_LARGEST + 1)
        if len(content) > _LARGEST:
            raise ValueError(f"of at most {_LARGEST} bytes, got more")
        values = tomllib.loads(content.decode())
    except OSError as error:
        raise InputError(f"tissue {path}: expected a TOML file, it cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"tissue {path}: expected a TOML file, {error}") from None
    try:
        return Tissue.from_dict(values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def write_tissue(path: str | Path, tissue: Tissue) -> None:
    """Write ``tissue`` so that :func:`read_tissue` gives it back, to the bit.

    Raises:
        InputError: its law has no name, or the folder cannot be written.

    Example:
        >>> tsg.write_tissue("tissue.toml", tsg.Tissue(bar_force=2e-8))
        >>> tsg.read_tissue("tissue.toml").bar_force
        2e-08
    """
    text = tomli_w.dumps(tissue.as_dict())
    with atomic_path(path) as temporary:
        temporary.write_text("# tsgdd tissue, SI units\n" + text)
