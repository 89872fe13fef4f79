"""What is asked for against what a machine can do, before anything is computed."""

from __future__ import annotations

from tsg_micro.data.errors import InputError
from tsg_micro.data.memory import available_memory

__all__ = ["MOST_STEPS", "check_count", "check_memory"]

MOST_STEPS = 1_000_000
"""Recorded load steps; each is a solve and a row."""


def check_count(name: str, value: int, least: int = 1, most: int = MOST_STEPS) -> None:
    """Raise InputError where a count is not between ``least`` and ``most``."""
    if value < least:
        raise InputError(f"{name}: expected at least {least}, got {value}")
    if value > most:
        raise InputError(f"{name}: expected at most {most}, got {value}")


def check_memory(what: str, needed: float) -> None:
    """Raise InputError where ``needed`` bytes are more than is available, if that is known."""
    available = available_memory()
    if available is not None and needed > available:
        raise InputError(f"{what} need about {needed / 1e9:.3g} GB of memory, {available / 1e9:.1f} GB are available")
