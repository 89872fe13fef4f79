"""Points drawn to stand for all: their sums are right in the mean, exact where the chances are, on any ranks."""

from __future__ import annotations

import numpy as np
import pytest

from dd_macro import StrainOperator, box
from dd_macro.methods.check_points import Points, draw, shares
from dd_macro.parallel import total

pytestmark = pytest.mark.mpi


@pytest.fixture(scope="module")
def operator():
    from mpi4py import MPI

    return StrainOperator(box(MPI.COMM_WORLD, elements=(6, 5, 4), size=(6e-5, 5e-5, 4e-5)))


def drawn(operator, share, count, groups=None):
    x = operator.points
    n = len(x)
    group = np.zeros(n, int) if groups is None else groups
    ones = np.ones((n, 6))
    points = Points(np.hstack([x, x]), ones, ones, np.zeros(n, int), np.zeros(n), group, 20)
    return draw(operator, points, share, count)


def test_the_sum_is_exact_where_the_chances_go_with_what_is_summed(operator):
    f = 1.0 + 1e5 * operator.points[:, 0]
    found = drawn(operator, operator.weights * f, 40)
    assert len(found.weight) == 40
    sums = found.weight @ (1.0 + 1e5 * found.strain[:, 0])
    assert sums == pytest.approx(float(total(operator.comm, operator.weights @ f)), rel=1e-12)


def test_the_sum_is_right_in_the_mean(operator):
    """Five standard deviations of the mean of independent draws; without replacement it varies less."""
    x = operator.points * 1e5

    def f(x):
        return 1.0 + x[:, 1] ** 2 + 2.0 * np.sin(9.0 * x[:, 2]) ** 2

    exact = float(total(operator.comm, operator.weights @ f(x)))
    share = shares(operator.comm, operator.weights, x[:, 0] ** 4)
    count = 240
    found = drawn(operator, share, count)
    each = found.weight * f(1e5 * found.strain)
    assert abs(each.sum() - exact) < 5.0 * each.std() * np.sqrt(count)
    assert each.std() * np.sqrt(count) < 0.1 * exact


def test_half_of_the_chances_is_volume(operator):
    share = shares(operator.comm, operator.weights, np.where(operator.points[:, 0] > 5e-5, 1.0, 0.0))
    beyond = drawn(operator, share, 200).strain[:, 0] > 5e-5
    assert 0.4 < beyond.mean() < 0.75  # a sixth of the volume
    even = shares(operator.comm, operator.weights, np.zeros(len(operator.weights)))
    np.testing.assert_allclose(even, operator.weights / total(operator.comm, operator.weights.sum()))


def test_more_than_there_are_takes_all(operator):
    found = drawn(operator, operator.weights, 10**6)
    assert len(found.weight) == 6 * 5 * 4 * 8
    assert found.weight.sum() == pytest.approx(float(total(operator.comm, operator.weights.sum())), rel=1e-12)


def test_points_that_are_certain_stand_for_themselves(operator):
    x = operator.points
    corner = (x > [5.5e-5, 4.5e-5, 3.5e-5]).all(axis=1)
    found = drawn(operator, np.where(corner, 1e6, 1.0) * operator.weights, 20)
    there = (found.strain[:, :3] > [5.5e-5, 4.5e-5, 3.5e-5]).all(axis=1)
    assert there.sum() == total(operator.comm, corner.sum())
    np.testing.assert_allclose(found.weight[there], 1e-15 / 8, rtol=1e-9)


def test_every_group_that_is_large_enough_is_seen(operator):
    """Groups along x of a sixth of the volume each: two of twelve points in every one; or half of a point."""
    group = (operator.points[:, 0] / 1e-5).astype(int)
    found = drawn(operator, operator.weights, 12, group)
    np.testing.assert_array_equal(np.bincount((found.strain[:, 0] / 1e-5).astype(int)), np.full(6, 2))
    few = drawn(operator, operator.weights, 3, group)
    assert len(few.weight) == 3
    assert np.bincount((few.strain[:, 0] / 1e-5).astype(int), minlength=6).max() == 1
    assert few.weight.sum() == pytest.approx(6 * 5 * 4 * 1e-15, rel=1e-9)


def test_groups_do_not_change_the_mean(operator):
    """Right in the mean over many ways to group, with chances that differ within the groups."""
    x = operator.points * 1e5
    f, rng = 1.0 + x[:, 1] ** 2, np.random.default_rng(0)
    exact = float(total(operator.comm, operator.weights @ f))
    share = operator.weights * (1.0 + x[:, 0])
    cells = operator.domain.mesh.topology.original_cell_index[: operator.domain.owned_cells]
    sums = []
    for _ in range(60):
        group = np.repeat(rng.integers(0, 20, 120)[cells], 8)
        found = drawn(operator, share, 12, group)
        assert len(found.weight) == 12
        sums.append(found.weight @ (1.0 + (1e5 * found.strain[:, 1]) ** 2))
    assert np.mean(sums) == pytest.approx(exact, rel=0.25)
