"""Points drawn to stand for all: their sums are right in the mean, exact where the chances are, on any ranks."""

from __future__ import annotations

import numpy as np
import pytest

from dd_macro import StrainOperator, box
from dd_macro.methods.check_points import draw, shares
from dd_macro.parallel import total

pytestmark = pytest.mark.mpi


@pytest.fixture(scope="module")
def operator():
    from mpi4py import MPI

    return StrainOperator(box(MPI.COMM_WORLD, elements=(6, 5, 4), size=(6e-5, 5e-5, 4e-5)))


def drawn(operator, share, count):
    x = operator.points
    n = len(x)
    return draw(operator, share, count, strain=np.hstack([x, x]), stress=np.ones((n, 6)), region=np.zeros(n, int))


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
