"""Lengths as a person writes them: "20 um", or a plain number in m."""

from __future__ import annotations

import functools
import math
import re
from typing import Any

from tsg_micro.data.errors import InputError

__all__ = ["length", "three_lengths"]

_FORM = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-zµμ]*)")


def length(name: str, text: str) -> float:
    """The positive length in m that ``text`` says.

    Raises:
        InputError: not one number with a unit of length or none, or not positive.
    """
    form = _FORM.fullmatch(text.strip())
    if form is None:
        raise InputError(f"{name}: expected a length, as 20um, or 2e-5 in m, got {text!r}")
    import pint

    try:
        value = float(_registry().Quantity(float(form[1]), form[2] or "m").m_as("m"))
    except pint.PintError as error:
        why = " ".join(str(error).split())
        raise InputError(f"{name}: expected a length, as 20um, or 2e-5 in m, got {text!r} ({why})") from None
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{name}: expected a positive length, got {text!r}")
    return value


@functools.cache
def _registry() -> Any:
    """Units by name; it takes a second to make."""
    import pint

    return pint.UnitRegistry()


def three_lengths(name: str, texts: tuple[str, str, str]) -> tuple[float, float, float]:
    """Lengths in m along x, y, z; raises as :func:`length`."""
    x, y, z = (length(name, text) for text in texts)
    return x, y, z
