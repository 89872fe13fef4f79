"""Numbers with units, as scene files write them: "20 um", "5 kPa"; a plain number is in SI."""

from __future__ import annotations

import math
import re
from functools import lru_cache
from typing import Annotated, Any

from pydantic import BeforeValidator

__all__ = ["BodyForceDensity", "Force", "Length", "Number", "Pressure", "quantity"]

_LONGEST = 60
"""Characters of a number with its unit."""
_SYMBOLS = "0123456789.+-eE*/ ()µ_"
_POWER = re.compile(r"(?<=[A-Za-z])(?:\*\*|\^)-?[1-9](?![\d.])")
"""Of a unit, as in N/m**3 or N/m^3; other powers could be of any size."""


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


def quantity(value: object, unit: str, what: str) -> float:
    """The number in the SI unit ``unit``, of a plain number or of one with its unit.

    Raises:
        ValueError: it is none, not finite, or of another dimension; the text says what was expected.
    """
    expected = f'expected {what} such as "{_EXAMPLES[unit]}", or a number in {unit}' if unit else f"expected {what}"
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"{expected}, got {value!r}")
    number = _parsed(value, unit, expected) if isinstance(value, str) else float(value)
    if not math.isfinite(number):
        raise ValueError(f"{expected}, got {value!r}")
    return number


def _parsed(text: str, unit: str, expected: str) -> float:
    import pint

    rest = _POWER.sub("", text[: _LONGEST + 1])
    plain = len(text) <= _LONGEST and "**" not in rest and all(c.isalpha() or c in _SYMBOLS for c in rest)
    if not plain or not 0 < sum(c.isdigit() for c in text) <= 20:
        raise ValueError(f"{expected}, got {text[:_LONGEST]!r}")
    try:
        found = _registry().Quantity(text)
        return float(f"{found.to(unit or 'dimensionless').magnitude:.15g}")  # 20 um are 2e-5 m
    except (pint.PintError, ValueError, TypeError, AttributeError, ZeroDivisionError, OverflowError, AssertionError):
        raise ValueError(f"{expected}, got {text!r}") from None


_EXAMPLES = {"m": "20 um", "N": "10 nN", "Pa": "5 kPa", "N/m^3": "10 kN/m**3"}


def _of(unit: str, what: str) -> BeforeValidator:
    return BeforeValidator(lambda value: quantity(value, unit, what))


Length = Annotated[float, _of("m", "a length")]
Force = Annotated[float, _of("N", "a force")]
Pressure = Annotated[float, _of("Pa", "a stress")]
BodyForceDensity = Annotated[float, _of("N/m^3", "a force per volume")]
Number = Annotated[float, _of("", "a number")]
