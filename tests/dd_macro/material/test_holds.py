"""Tangents of data with holds: many points at one strain, whose stress creeps or is noisy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dd_macro import estimate_tangents
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.measured import read_csv
from tsg_micro.data.table import Column

CASES = Path(__file__).parents[2] / "data" / "cases" / "csv"
ZERO = [f"{q}_{ij}" for q in ("eps", "sigma") for ij in ("xx", "zz", "yz", "xz", "xy")]


def uniaxial(strain, stress):
    count = np.arange(len(strain))
    six = np.zeros((2, len(strain), 6))
    six[0, :, 1], six[1, :, 1] = strain, stress
    return Dataset(six[0], six[1], "cauchy", path=0 * count, step=count)


def moduli(data):
    tangent = estimate_tangents(data).tangent
    assert tangent is not None
    return tangent[:, 1, 1]


def test_the_hold_of_the_cases():
    columns = {"eps_yy": Column("strain", "%"), "sigma_yy": Column("stress", "kPa")}
    data = read_csv(CASES / "hold_20_lines.csv", columns=columns, zero=ZERO, stress_measure="cauchy")
    modulus = moduli(data)
    slopes = np.diff(data.stress[20:, 1]) / np.diff(data.strain[20:, 1])
    assert (modulus[:20] > slopes.min()).all()  # 86 kPa at first, 194 kPa at last
    assert (modulus[:20] < 1.5 * slopes.min()).all()


@pytest.mark.parametrize("tremble", [0.0, 1e-9, 1e-7])
@pytest.mark.parametrize("at", [0.0, 0.02, 0.05])
def test_a_hold_anywhere_takes_the_slope_around_it(tremble, at):
    rng = np.random.default_rng(0)
    ramp = np.linspace(0, 0.05, 26)
    hold = at + tremble * rng.standard_normal(25)
    strain = np.concatenate([ramp, hold])
    stress = 1e5 * strain + np.concatenate([np.zeros(26), 30 * rng.standard_normal(25)])
    modulus = moduli(uniaxial(strain, stress))
    np.testing.assert_allclose(modulus[26:], 1e5, rtol=0.05)
    np.testing.assert_allclose(modulus, 1e5, rtol=0.4)  # beside the hold its noise is 15 % of a step of the ramp


def test_one_other_strain_is_enough_and_none_is_not():
    strain = np.r_[np.zeros(20), 0.01]
    stress = np.r_[np.tile([1.0, -1.0], 10), 1000.0]
    np.testing.assert_allclose(moduli(uniaxial(strain, stress))[:20], 1e5, rtol=1e-3)
    with pytest.raises(InputError, match="expected different strains"):
        estimate_tangents(uniaxial(np.full(20, 0.01), 1000 + np.arange(20.0)))
