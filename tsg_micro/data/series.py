"""A time series for ParaView: a collection (.pvd) that names one file per recorded load step."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path

__all__ = ["write_pvd"]


def write_pvd(path: str | Path, steps: Sequence[tuple[float, str | Path]]) -> None:
    """Write the collection ``path`` (.pvd) of ``steps``: times, rising, and files as seen from its folder.

    Raises:
        InputError: another suffix, no steps, times that do not rise, or a folder that cannot be written.
    """
    path = Path(path)
    if path.suffix != ".pvd":
        raise InputError(f"path: expected a file name that ends in .pvd, got {path}")
    times = [time for time, _ in steps]
    rising = all(a < b for a, b in itertools.pairwise(times))
    if not steps or not rising or not all(math.isfinite(time) for time in times):
        raise InputError(f"steps: expected at least one, with finite times that rise, got {times}")
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="Collection" version="0.1">',
        "  <Collection>",
        *(f'    <DataSet timestep="{float(time)!r}" file={quoteattr(Path(file).as_posix())}/>' for time, file in steps),
        "  </Collection>",
        "</VTKFile>",
    ]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
