"""Data that know their bar force: the rate of the stress by it, against two RVEs, and along a path of strains."""

from __future__ import annotations

import numpy as np
import pytest

import tsg_micro as tsg
from tsg_micro.continuum.graded_source import GradedSource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.errors import InputError

STRAIN = np.array([0.02, -0.01, 0.015, 0.004, -0.003, 0.01])


@pytest.mark.parametrize("kind", ["sheet", "bulk"])
def test_the_rate_is_the_derivative_of_the_stress(kind):
    source = GradedSource(RVESpec.of_kind(kind, tsg.Tissue()))
    f, h = 2e-8, 1e-3
    strains = np.tile(STRAIN, (3, 1))
    found = source.states(strains, 0 * strains, f * np.array([1.0, 1 - h, 1 + h]))
    assert found is not None
    assert found.bar_force_rate is not None
    difference = (found.stress[2] - found.stress[1]) / (2 * h * f)
    np.testing.assert_allclose(found.bar_force_rate[0], difference, rtol=0, atol=2e-5 * np.abs(difference).max())
    assert np.abs(difference).max() * f > 1e-3 * np.abs(found.stress[0]).max()  # it matters


def test_the_unstrained_state_is_free_of_stress_at_every_bar_force():
    found = GradedSource(RVESpec.of_kind("bulk", tsg.Tissue())).states(
        np.zeros((2, 6)), np.zeros((2, 6)), np.array([1e-9, 1e-7])
    )
    assert found is not None
    np.testing.assert_allclose(found.stress, 0, atol=1e-6)
    assert found.bar_force_rate is not None
    np.testing.assert_allclose(found.bar_force_rate, 0, atol=1e3)  # of 1e10 Pa/N and more at 1 % of strain
    assert found.tangent is not None
    assert found.tangent[1, 0, 0] > 20 * found.tangent[0, 0, 0]


def test_a_data_set_keeps_its_bar_forces(tmp_path):
    source = GradedSource(RVESpec.of_kind("bulk", tsg.Tissue()))
    found = source.states(STRAIN[None], 0 * STRAIN[None], np.array([3e-9]))
    assert found is not None
    tsg.write_dataset(tmp_path / "data.h5", found)
    again = tsg.read_dataset(tmp_path / "data.h5")
    np.testing.assert_array_equal(again.bar_force, [3e-9])
    np.testing.assert_array_equal(again.bar_force_rate, found.bar_force_rate)
    rate = tsg.convert_dataset(again, "cauchy").bar_force_rate
    assert rate is not None
    assert rate.shape == (1, 6)


def test_one_bar_force_or_many():
    with pytest.raises(InputError, match="bar_forces: expected one for every strain, got none"):
        GradedSource(RVESpec()).states(np.zeros((1, 6)), np.zeros((1, 6)))
