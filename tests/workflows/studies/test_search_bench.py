"""Data between RVEs are states of a sheet with free faces, and every number of them has its row."""

from __future__ import annotations

import numpy as np
import pytest

from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.errors import InputError
from workflows.studies.bench_search import _NEAR, bench_search, between


def test_data_between_rves_follow_their_law():
    """To second order in the strain between, and no stress on the free faces."""
    source, rng = RVESource(RVESpec()), np.random.default_rng(3)
    strain = np.zeros((3, 6))
    strain[:, [0, 1, 5]] = rng.uniform(-0.03, 0.03, (3, 3))
    sampled = source.states(strain, strain)
    for _ in range(4):  # until the thickness is without stress
        assert sampled is not None
        assert sampled.tangent is not None
        strain[:, 2] -= sampled.stress[:, 2] / sampled.tangent[:, 2, 2]
        sampled = source.states(strain, strain)
    assert sampled is not None
    assert sampled.tangent is not None
    found = between(sampled, 6, rng)
    assert (len(found), found.tangent) == (6, None)
    true = source.states(found.strain, found.strain)
    assert true is not None
    assert np.abs(true.stress - found.stress).max() < 10.0 * np.abs(sampled.tangent).max() * _NEAR**2
    assert not found.stress[:, 2:5].any()


def test_every_number_of_data_has_a_row(tmp_path, is_png):
    rows = bench_search(tmp_path, counts=(2000, 200), elements=(4, 2), paths=4)["rows"]
    assert [row["data"] for row in rows] == [200, 2000]
    assert rows[1]["normalised_distance"] < rows[0]["normalised_distance"]
    assert all(row["processor_seconds"] > row["seconds_search"] > 0 for row in rows)
    assert is_png(tmp_path / "search.png")
    assert not (tmp_path / "data.h5").exists()


def test_bad_numbers_are_told(tmp_path):
    with pytest.raises(InputError, match="count: expected at least 1, got 0"):
        bench_search(tmp_path, counts=(0,))
