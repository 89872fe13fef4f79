"""Cost against size: every run is there, its parts are its time, and the exponents are those of the rows."""

from __future__ import annotations

import numpy as np
import pytest

from tsg_micro.data.errors import InputError
from workflows.studies.bench_scale import METHODS, PHASES, scale

SOME = ("adaptive", "full tensegrity", "sampling")  # one of every command


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    out = tmp_path_factory.mktemp("scale")
    return out, scale(out, sizes=(4, 2), ranks=(1,), methods=SOME, paths=20)


def test_every_method_and_size_has_a_row_that_adds_up(bench, is_png):
    out, summary = bench
    assert [(row["method"], row["elements"]) for row in summary["rows"]] == [(m, n) for m in SOME for n in (8, 32)]
    for row in summary["rows"]:
        assert sum(row[name] for name in PHASES) == pytest.approx(row["seconds"])
        if METHODS[row["method"]].command == "solve":
            assert row["seconds_setup"] > 0 < row["seconds_linear_solves"]
        assert row["cpu"] > 0.1
        assert row["method"] == "sampling" or row["peak_memory"] > 1e7
    table = (out / "scale.md").read_text()
    assert all(table.count(f"| {method} | 1 |") == 3 for method in SOME)
    assert len((out / "scale.csv").read_text().splitlines()) == 1 + len(summary["rows"])
    assert is_png(out / "scale.png")


def test_exponents_are_slopes(bench):
    rows = bench[1]["rows"]
    for k, fit in enumerate(bench[1]["exponents"]):
        few, many = rows[2 * k : 2 * k + 2]
        assert fit["seconds"] == pytest.approx(np.log(many["seconds"] / few["seconds"]) / np.log(4.0))


def test_bad_sizes_are_told(tmp_path):
    with pytest.raises(InputError, match="expected sizes from 2 and ranks from 1"):
        scale(tmp_path, sizes=(1,))
    with pytest.raises(InputError, match=r"method: expected some of points, .*, got guesses"):
        scale(tmp_path, methods=("points", "guesses"))
