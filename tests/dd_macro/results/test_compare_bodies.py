"""Blocks of any body: means over the elements in them, which are inside, errors that are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dd_macro.results.compare import BlockStress, compare_blocks, interior_blocks
from dd_macro.results.compare_bodies import block_means, body_errors, inner_blocks
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import pressure, von_mises

EDGE = 2e-5


def box(*count):
    return EDGE * (np.argwhere(np.ones(count, dtype=bool)) + 0.5)


def test_means_are_those_of_the_volume(rng):
    """Each block in two unequal layers, in any order; a linear field is met exactly at the middle of its block."""
    blocks = box(3, 2, 2)[[0, 1, 3, 4, 7, 9, 11]] + [3e-5, 0.0, -1e-4]
    thick = np.array([0.25, 0.75])
    middle = np.array([-0.375, 0.125])
    element = (blocks[:, None] + EDGE * middle[None, :, None] * [0.0, 0.0, 1.0]).reshape(-1, 3)
    volume = np.tile(thick * EDGE**3, len(blocks))
    order = rng.permutation(len(element))
    gradient, values = rng.normal(size=(3, 6)), np.array([1.0, -2.0, 0.5, 3.0, 0.0, 4.0])
    found = block_means(element[order], volume[order], (values + element @ gradient)[order], blocks, EDGE)
    np.testing.assert_allclose(found, values + blocks @ gradient, rtol=1e-12)
    with pytest.raises(InputError, match=r"one around \(.*\) m that is in none \(1 of 13\)"):
        block_means(element[1:] + np.eye(13, 1) * EDGE * 9, volume[1:], element[1:], blocks, EDGE)
    with pytest.raises(InputError, match=r"to fill it, got 6e-15 m\^3 of 8e-15 m\^3 in that around .* \(1 of 7\)"):
        block_means(element[1:], volume[1:], element[1:], blocks, EDGE)


def test_inner_blocks_have_no_outer_face():
    assert inner_blocks(box(3, 3, 3), EDGE).nonzero()[0].tolist() == [13]
    assert not inner_blocks(box(2, 2, 2), EDGE).any()
    ball = box(6, 6, 6)
    ball = ball[((ball - ball.mean(axis=0)) ** 2).sum(axis=1) <= (3 * EDGE) ** 2]
    inside = inner_blocks(ball, EDGE)
    assert (len(ball), int(inside.sum())) == (136, 56)
    assert inside[np.linalg.norm(ball - ball.mean(axis=0), axis=1) < 1.8 * EDGE].all()
    for count in ((6, 5, 1), (6, 1, 5), (1, 6, 5)):
        assert inner_blocks(box(*count), EDGE).sum() == 4 * 3


def test_a_sheet_has_the_errors_it_always_had(rng):
    midpoint = box(6, 5, 1)
    a, b = (BlockStress(midpoint, rng.normal(size=(30, 6)) + 3.0, "cauchy") for _ in range(2))
    old, inner = compare_blocks(a, a, b), inner_blocks(midpoint, EDGE)
    np.testing.assert_array_equal(inner, interior_blocks(midpoint))
    for symbol in ("p", "q"):
        whole, inside = (getattr(body_errors(a.stress[on], b.stress[on]), symbol) for on in (slice(None), inner))
        assert (*inside, *whole) == pytest.approx(dataclasses.astuple(getattr(old, f"error_{symbol}_mech")), rel=1e-12)


def test_errors_that_are_known(rng):
    reference = rng.normal(size=(40, 6))
    found = body_errors(1.2 * reference, reference)
    for error in (found.p, found.q, found.stress):
        assert error == pytest.approx((0.2, 0.2))
    assert sum(e**2 for e in found.components.values()) == pytest.approx(0.2**2)
    one = reference.copy()
    one[:, 3] += 2.0  # yz
    found = body_errors(one, reference)
    assert found.p == pytest.approx((0.0, 0.0), abs=1e-15)
    expected = 2.0 * np.sqrt(40) / np.linalg.norm(reference)
    assert found.components == pytest.approx(dict.fromkeys(("xx", "yy", "zz", "xz", "xy"), 0.0) | {"yz": expected})
    assert found.stress is not None
    assert found.stress[0] == pytest.approx(expected)
    q = von_mises(reference)
    assert found.q is not None
    assert found.q[0] == pytest.approx(np.linalg.norm(von_mises(one) - q) / np.linalg.norm(q))
    still = np.broadcast_to([1.0, -1.0, 0.0, 0.0, 0.0, 0.0], (4, 6))
    assert body_errors(still + 0.1, still).p is None  # nothing to relate it to
    assert np.abs(pressure(still)).max() == 0.0
    assert body_errors(reference[:0], reference[:0]).as_dict()["stress"] is None
