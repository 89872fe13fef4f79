"""States a second: both ways are timed on the same states, and are equal."""

from __future__ import annotations

import pytest

from tsg_micro.data.errors import InputError
from workflows.studies.bench_rves import RVES, rves


def test_both_ways_are_timed_and_equal(tmp_path):
    summary = rves(tmp_path, paths=2, steps=4, processes=1)
    assert [row["rve"] for row in summary["rows"]] == list(RVES)
    for row in summary["rows"]:
        assert row["states"] == 8
        assert min(row[f"{way}_{what}"] for way in ("alone", "batch") for what in ("cpu", "per_second")) > 0
        assert max(row["stress_difference"], row["tangent_difference"]) < 1e-9
    assert len((tmp_path / "rves.csv").read_text().splitlines()) == 1 + len(RVES)


def test_bad_numbers_are_told(tmp_path):
    with pytest.raises(InputError, match="steps: expected at least 1, got 0"):
        rves(tmp_path, paths=1, steps=0, processes=1)
    with pytest.raises(InputError, match="processes: 64, 20 and 1000000 need about"):
        rves(tmp_path, paths=64, steps=20, processes=1_000_000)
