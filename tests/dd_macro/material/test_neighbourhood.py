"""The neighbourhood of data: its own set of strains without holes, and nothing beside it."""

from __future__ import annotations

import numpy as np

from dd_macro.material.neighbourhood import Neighbourhood

FACTOR = np.linalg.cholesky(np.diag([1.0, 2.0, 3.0, 1.0, 1.0, 1.0]) + 0.1)


def test_a_box_is_inside_and_its_surroundings_are_outside(rng):
    near = Neighbourhood(rng.uniform(-0.05, 0.05, (4000, 6)), FACTOR)
    assert near.outside(rng.uniform(-0.03, 0.03, (500, 6))).mean() < 0.02
    beside = rng.uniform(-0.05, 0.05, (500, 6))
    beside[:, 0] += 0.15
    assert near.outside(beside).all()


def test_a_corner_of_the_bounding_box_is_outside(rng):
    """Data along a line: the box around them holds strains that they say nothing about."""
    t = rng.uniform(0.0, 1.0, (300, 1))
    near = Neighbourhood(t * [0.05, -0.05, 0.0, 0.0, 0.0, 0.0], np.eye(6))
    assert not near.outside(0.5 * np.array([[0.05, -0.05, 0.0, 0.0, 0.0, 0.0]])).any()
    assert near.outside(np.array([[0.04, -0.01, 0.0, 0.0, 0.0, 0.0], [0.025, -0.025, 0.005, 0.0, 0.0, 0.0]])).all()


def test_the_hole_at_rest_of_data_that_hold_no_small_strain(rng):
    strain = rng.normal(size=(400, 6))
    strain *= 0.05 / np.linalg.norm(strain, axis=1, keepdims=True)
    assert Neighbourhood(strain, np.eye(6)).outside(np.zeros((1, 6))).all()
    assert not Neighbourhood(np.vstack([strain, np.zeros(6)]), np.eye(6)).outside(np.full((1, 6), 1e-3)).any()


def test_the_gap_is_the_distance_to_the_sixth_neighbour():
    near = Neighbourhood(np.arange(9.0)[:, None] * np.eye(6)[0], 2.0 * np.eye(6))
    np.testing.assert_allclose(near.gap(np.array([0, 4])), [12.0, 6.0])


def test_a_single_datum_has_itself_alone():
    near = Neighbourhood(np.full((1, 6), 0.01), np.eye(6))
    np.testing.assert_array_equal(near.outside(np.full((3, 6), [[0.01], [0.0105], [0.012]])), [False, False, True])
