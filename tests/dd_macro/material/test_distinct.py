"""Which rows are different, and in what."""

from __future__ import annotations

import numpy as np
import pytest

from dd_macro.material.distinct import first_of_equal, principal_axes


@pytest.mark.parametrize("one_key", [False, True])
def test_first_of_equal_rows(rng, monkeypatch, one_key):
    """Those that sorting of all rows finds, where keys fall together too; 0 and -0 are equal."""
    rows = rng.integers(-1, 2, (500, 4)) * rng.choice([1.0, 0.1, 2.0**-1000], (500, 1))
    rows[::2] = -rows[::2] * 1.0
    expected = np.sort(np.unique(rows + 0.0, axis=0, return_index=True)[1])
    if one_key:
        unique = np.unique
        monkeypatch.setattr(np, "unique", lambda a, **k: unique(a if a.ndim > 1 else np.zeros_like(a), **k))
    np.testing.assert_array_equal(first_of_equal(rows), expected)


@pytest.mark.parametrize("dimensions", [1, 3, 6])
def test_principal_axes_keep_distances_and_leave_out_what_is_the_same(rng, dimensions):
    rows = 7.0 + rng.normal(size=(300, dimensions)) @ rng.normal(size=(dimensions, 6))
    middle, axes = principal_axes(rows)
    assert axes.shape == (6, dimensions)
    np.testing.assert_allclose(axes.T @ axes, np.eye(dimensions), atol=1e-12)
    np.testing.assert_allclose((rows - middle) @ axes @ axes.T, rows - middle, atol=1e-10)
    extent = ((rows - middle) @ axes).std(axis=0)
    assert (np.diff(extent) <= 1e-12).all()


def test_equal_rows_have_one_axis():
    assert principal_axes(np.ones((4, 6)))[1].shape == (6, 1)
