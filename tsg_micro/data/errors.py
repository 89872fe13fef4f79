"""The kinds of failure that a user meets: bad input, a full disk, and a solver that did not converge."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["ConvergenceError", "InputError", "OutputError"]


class InputError(ValueError):
    """An argument or a file is not what is needed: the text names it, what was expected and what came."""


class OutputError(InputError, OSError):
    """A file could not be written, as the disk is full or fails; what was there before is there still."""


class ConvergenceError(RuntimeError):
    """A solver stopped without a solution; ``history`` holds one record per iteration."""

    def __init__(self, message: str, history: Sequence[object] = ()) -> None:
        super().__init__(message)
        self.history = list(history)
