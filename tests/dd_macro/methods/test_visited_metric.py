"""The metric from the tangents of the data that a scene visits."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from dd_macro import Displacement, StrainOperator, box, mean_tangent, secant_modulus, visited_tangent
from tsg_micro.data.mandel import to_mandel

pytestmark = pytest.mark.mpi

H = np.array([[0.02, 0.01, 0.0], [-0.005, 0.03, 0.004], [0.0, 0.002, -0.01]])


def spd(seed):
    A = np.random.default_rng(seed).normal(size=(6, 6))
    return 1e3 * (A @ A.T + 3.0 * np.eye(6))


def test_homogeneous_scene_has_the_tangent_of_its_one_datum(rng, make_dataset):
    """Every quadrature point ends on the exact datum, whatever the tangents of the others are."""
    operator = StrainOperator(box(MPI.COMM_WORLD, elements=(3, 3, 1), size=(3e-5, 3e-5, 1e-5)))
    sides = [Displacement(side, lambda x: x @ H.T) for side in operator.domain.names]
    strain = to_mandel(H) + 0.05 * rng.normal(size=(40, 6))
    strain[11] = to_mandel(H)
    stress = strain @ spd(0)
    tangent = np.stack([spd(seed) for seed in range(40)])
    metric = visited_tangent(operator, make_dataset(strain, stress, tangent=tangent), sides)
    np.testing.assert_allclose(metric.C, tangent[11], rtol=1e-12)
    assert "the 1 of 40 data" in metric.reason


def test_equal_tangents_give_the_mean_tangent_and_none_the_secant(rng, make_dataset):
    operator = StrainOperator(box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(2e-5, 2e-5, 1e-5)))
    sides = [Displacement("bottom"), Displacement("top", (0.0, 1e-6, 0.0))]
    strain = 0.05 * rng.normal(size=(50, 6))
    data = make_dataset(strain, strain @ spd(1), tangent=np.broadcast_to(spd(1), (50, 6, 6)))
    np.testing.assert_allclose(visited_tangent(operator, data, sides).C, mean_tangent(data).C, rtol=1e-12)
    bare = make_dataset(strain, strain @ spd(1))
    np.testing.assert_array_equal(visited_tangent(operator, bare, sides).C, secant_modulus(bare).C)
