"""The version of this software, that of the package as it is installed."""

from __future__ import annotations

from importlib import metadata

__all__ = ["VERSION"]


def _installed() -> str:
    try:
        return metadata.version("tsgdd")
    except metadata.PackageNotFoundError:  # a source tree on the path
        return "unknown"


VERSION = _installed()
