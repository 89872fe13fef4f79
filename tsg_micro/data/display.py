"""What an object says of itself at a prompt and in a notebook: a title and a few rows."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.mandel import COMPONENTS, from_mandel

__all__ = ["Displayed", "printable", "ranges"]

_LONG = 300
"""Letters of a row at most."""


class Displayed:
    """A class that gives ``_display`` gets its ``repr`` and its table for notebooks from it.

    What it says may come from a file: it cannot steer a terminal, nor a browser.
    """

    def _display(self) -> tuple[str, Mapping[str, object]]:
        """A title, and rows by their names; it must not be collective, as one rank alone may print."""
        raise NotImplementedError

    def __repr__(self) -> str:
        title, rows = self._display()
        width = max(map(len, rows), default=0)
        lines = [title, *(f"  {name:{width}}  {value}" for name, value in rows.items() if f"{value}")]
        return "\n".join(printable(line)[:_LONG] for line in lines)

    def _repr_html_(self) -> str:
        title, rows = self._display()
        cells = "".join(
            f"<tr><th style='text-align:left'>{escape(printable(name))}</th>"
            f"<td style='text-align:left'>{escape(printable(f'{value}')[:_LONG])}</td></tr>"
            for name, value in rows.items()
            if f"{value}"
        )
        return f"<table><caption>{escape(printable(title)[:_LONG])}</caption>{cells}</table>"


def ranges(mandel: NDArray[np.float64]) -> str:
    """From where to where every tensor component of Mandel vectors (n, 6) goes that is not zero."""
    ends = from_mandel([mandel.min(axis=0), mandel.max(axis=0)])
    places = ((name, "xyz".index(name[0]), "xyz".index(name[1])) for name in COMPONENTS)
    return ", ".join(f"{n} {ends[0, i, j]:.3g} to {ends[1, i, j]:.3g}" for n, i, j in places if ends[:, i, j].any())


def printable(text: str) -> str:
    """``text`` with a question mark for what would steer a terminal, as colours or line ends."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
