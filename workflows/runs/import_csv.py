"""Measured data as a data set: ``tsgdd import-csv DATA.csv --column eps_yy=strain:% ... --out data.h5``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tsg_micro.data.dataset_file import write_dataset
from tsg_micro.data.files import output_file
from tsg_micro.data.mandel import pressure, von_mises
from tsg_micro.data.measured import parse_columns, read_csv
from tsg_micro.data.table import Layout
from workflows.store.record import summary_path, versions, write_summary

__all__ = ["import_csv"]


def import_csv(
    csv: Path,
    *,
    column: list[str],
    zero: list[str],
    silent: Sequence[str] = (),
    stress_measure: str,
    layout: Layout | None = None,
    out: Path,
) -> None:
    """Write the CSV file's points to the data set ``out`` with its summary, and print what came in.

    ``zero`` and ``silent`` take names one by one or parted by commas; ``layout`` is how the numbers are written.

    Raises:
        InputError: as tsg_micro.data.measured.read_csv, or ``out`` cannot be written.
    """
    zeros, quiet = (
        [name.strip() for text in texts for name in text.split(",") if name.strip()] for texts in (zero, silent)
    )
    columns = parse_columns(column)
    output_file(out)
    data = read_csv(
        csv,
        columns=columns,
        zero=zeros,
        silent=quiet,
        stress_measure=stress_measure,
        layout=layout,
        versions=versions(),
    )
    summary_path(out).unlink(missing_ok=True)
    write_dataset(out, data)
    p, q = pressure(data.stress), von_mises(data.stress)
    write_summary(
        out,
        command="import-csv",
        parameters={"csv": csv, "column": column, "zero": zeros, "silent": quiet, "stress_measure": stress_measure},
        figures={
            "points": (len(data), ""),
            "paths": (len(np.unique(data.path)), ""),
            "pressure_range": ([p.min(), p.max()], "Pa"),
            "largest_effective_stress": (q.max(), "Pa"),
        },
    )
    print(f"{len(data)} points from {csv} to {out}")
    print(f"  {stress_measure} stress: p {p.min():.4g} to {p.max():.4g} Pa, q up to {q.max():.4g} Pa")
    print(f"  largest strain (Mandel norm): {np.linalg.norm(data.strain, axis=1).max():.4g}")
