"""Checks of plain values that come from a file: names that are known, numbers that are numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from tsg_micro.data.errors import InputError

__all__ = ["check_names", "numbers"]


def check_names(where: str, values: Any, known: Iterable[str]) -> None:
    """Raise InputError where ``values``, named ``where``, are no mapping of some of the ``known`` names."""
    known = list(known)
    unknown = [name for name in values if name not in known] if isinstance(values, Mapping) else [repr(values)]
    if unknown or not isinstance(values, Mapping):
        raise InputError(f"{where}: expected some of {', '.join(known)}, got {', '.join(map(str, unknown))}")


def numbers(where: str, values: Mapping[str, Any]) -> dict[str, float]:
    """The values as floats.

    Raises:
        InputError: one is no number, or too large to be one.
    """
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{where}, {name}: expected a number, got {value!r}")
        if isinstance(value, int) and abs(value) >= 10**300:
            raise InputError(f"{where}, {name}: expected a number below 1e300, got one of {len(str(value))} digits")
    return {name: float(value) for name, value in values.items()}
