"""Columns of numbers from a text file as instruments and spreadsheets write it, every number with its line and column.

A line holds the headers, the lines below it the numbers. What can be seen is found out: what parts the cells (commas,
semicolons, tabs, else blanks), Excel's line ``sep=;`` at the top, comments that begin with #. What cannot be seen is
declared by a Layout.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError

__all__ = ["COUNTERS", "DELIMITERS", "Column", "Layout", "read_headers", "read_numbers"]

Array = NDArray[np.float64]

COUNTERS = ("path", "step")
"""Columns of whole numbers from 0."""
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " "}
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_LARGEST = 1e30
"""Instruments mark an overflow by 9.9e37, 1e38 or 3.4e38; no measured number is near that in any unit."""


@dataclass(frozen=True)
class Column:
    """Where a component stands in the file: the header of its column, and the unit of the numbers below."""

    header: str
    unit: str


@dataclass(frozen=True)
class Layout:
    """How the numbers are written.

    ``delimiter`` is one of DELIMITERS or None, to find it out; ``decimal`` a point or a comma; lines that begin with
    ``comment`` do not count (none do if it is empty), nor do the first ``skip`` lines.

    Raises:
        InputError: on construction, where one of them is another.
    """

    delimiter: str | None = None
    decimal: str = "."
    comment: str = "#"
    skip: int = 0

    def __post_init__(self) -> None:
        if self.delimiter is not None and self.delimiter not in DELIMITERS:
            raise InputError(f"delimiter: expected {', '.join(DELIMITERS)}, got {self.delimiter!r}")
        if self.decimal not in (".", ","):
            raise InputError(f"decimal: expected . or , got {self.decimal!r}")
        if self.delimiter == "comma" and self.decimal == ",":
            raise InputError("delimiter, decimal: expected different characters, got a comma for both")
        if self.skip < 0:
            raise InputError(f"skip: expected a number of lines from 0, got {self.skip}")


class _Lines:
    """The lines of a file that count, and the number of the last one."""

    def __init__(self, path: Path, layout: Layout) -> None:
        self.path, self.layout, self.number = path, layout, 0
        with path.open(encoding="utf-8-sig", newline="") as file:
            self.lines = file.readlines()
        self.numbers = range(layout.skip, len(self.lines))
        self.delimiter = DELIMITERS.get(layout.delimiter or "")
        self.headers = self._headers()

    def _is_comment(self, at: int) -> bool:
        return bool(self.layout.comment) and self.lines[at].lstrip().startswith(self.layout.comment)

    def _headers(self) -> list[str]:
        """Read up to the headers: the first line that is no comment, or the last comment if only numbers follow."""
        at, commented, separator = self.layout.skip, None, None
        if at < len(self.lines) and (declared := re.fullmatch(r'"?sep=(.)"?\s*', self.lines[at], re.IGNORECASE)):
            separator, at = declared[1], at + 1
        while at < len(self.lines) and (self._is_comment(at) or (commented is not None and not self.lines[at].strip())):
            commented = at if self.lines[at].strip() else commented
            at += 1
        line = self.lines[at] if at < len(self.lines) else ""
        self.number = at
        if commented is not None and (not line.strip() or self._all_numbers(line, separator)):
            text, below = self.lines[commented].lstrip(), line
            line = text[len(self.layout.comment) :] if text[len(self.layout.comment) :][:1].isspace() else text
        else:
            self.number, below = at + 1, self.lines[at + 1] if at + 1 < len(self.lines) else ""
        if not line.strip():
            raise InputError(f"CSV file {self.path}: expected column headers in line {at + 1}, got an empty line")
        self.delimiter = self.delimiter or separator or self._find_delimiter(line, below)
        headers = [cell.strip() for cell in self._cells(line)]
        if not any(headers):
            raise InputError(f"CSV file {self.path}: expected column headers in line {at + 1}, got an empty line")
        return headers

    def _all_numbers(self, line: str, separator: str | None) -> bool:
        parted = "".join({*" \t;", separator or ";", *({","} if self.layout.decimal == "." else ())})
        words = re.split(rf"[{re.escape(parted)}\r\n]+", line.strip())
        return all(_NUMBER.fullmatch(word.replace(self.layout.decimal, ".")) for word in words if word)

    def _find_delimiter(self, line: str, below: str) -> str:
        known = ";\t" if self.layout.decimal == "," else ",;\t"
        best = max(known, key=line.count)
        if line.count(best) or len(line.split()) < 2 or len(line.split()) != len(below.split()):
            return best
        return " "

    def _cells(self, line: str) -> list[str]:
        return next(self._reader(iter([line])), [])

    def _reader(self, lines: Iterator[str]) -> Iterator[list[str]]:
        if self.delimiter == " ":
            lines = (line.replace("\t", " ").strip() for line in lines)
        return csv.reader(lines, delimiter=self.delimiter or ",", skipinitialspace=self.delimiter == " ")

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Number of the line and cells, below the headers; lines without any are left out."""

        def counted() -> Iterator[str]:
            while self.number < len(self.lines):
                self.number += 1
                if not self._is_comment(self.number - 1):
                    yield self.lines[self.number - 1]

        for row in self._reader(counted()):
            if any(cell.strip() for cell in row):
                yield self.number, row


def read_headers(path: Path, layout: Layout | None = None) -> list[str]:
    """Headers of a table.

    Raises:
        InputError: the file is missing, is no text, or its first line is empty.
    """
    return _open(path, layout or Layout()).headers


def read_numbers(path: Path, columns: Mapping[str, Column], layout: Layout | None = None) -> dict[str, Array]:
    """The declared columns as they stand in the file, and the number of each point's ``line``.

    Raises:
        InputError: the file is missing or empty, a column is not there, or a cell is no finite number, or one that no
            instrument measures.
    """
    layout = layout or Layout()
    lines = _open(path, layout)
    headers = lines.headers
    place = {name: _place(path, headers, column.header) for name, column in columns.items()}
    values: dict[str, list[float]] = {name: [] for name in (*columns, "line", *COUNTERS)}
    try:
        for line, row in lines.rows():
            if len(row) != len(headers):
                raise InputError(f"CSV file {path}, line {line}: expected {len(headers)} cells, got {len(row)}")
            for name, at in place.items():
                where = f"CSV file {path}, line {line}, column {headers[at]!r}"
                values[name].append(_number(row[at], where, layout, whole=name in COUNTERS))
            values["line"].append(line)
    except csv.Error as error:
        raise _unreadable(path, error) from None
    if not values["line"]:
        raise InputError(f"CSV file {path}: expected lines of numbers below the headers, got none")
    return {name: np.array(numbers) for name, numbers in values.items()}


def _open(path: Path, layout: Layout) -> _Lines:
    if not path.is_file():
        raise InputError(f"CSV file {path}: no such file")
    try:
        return _Lines(path, layout)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> InputError:
    return InputError(f"CSV file {path}: expected a text file in UTF-8, but it cannot be read ({error})")


def _place(path: Path, headers: list[str], header: str) -> int:
    """Which column of the file has ``header``."""
    count = headers.count(header)
    if count != 1:
        found = "no such column" if count == 0 else f"{count} of them"
        raise InputError(f"CSV file {path}: expected a column {header!r}, got {found} among {', '.join(headers)}")
    return headers.index(header)


def _number(cell: str, where: str, layout: Layout, *, whole: bool) -> float:
    expected = "a whole number from 0" if whole else "a finite number"
    text = cell.strip()
    plain = text if layout.decimal == "." else text.replace(".", "x").replace(",", ".")
    if not _NUMBER.fullmatch(plain):
        hint = "; is its decimal sign a comma? (--decimal ,)" if _NUMBER.fullmatch(text.replace(",", ".")) else ""
        raise InputError(f"{where}: expected {expected}, got {text!r}{hint if layout.decimal == '.' else ''}")
    value = float(plain)
    if whole and not (0 <= value < 2**53 and value == int(value)):
        raise InputError(f"{where}: expected {expected}, got {text!r}")
    if abs(value) >= _LARGEST:
        raise InputError(f"{where}: expected {expected}, got {text}: is it an instrument's mark of an overflow?")
    return value
