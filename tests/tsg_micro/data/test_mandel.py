"""Mandel vectors, p and q, and the maps between stress measures and their tangents."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import BASIS, COMPONENTS, from_mandel, pressure, to_mandel, von_mises
from tsg_micro.data.stress import MEASURES, check_measure, convert_stress, convert_tangent

NUMBERS = st.floats(-1e3, 1e3)
VECTORS = arrays(float, (4, 6), elements=NUMBERS)
TENSORS = arrays(float, (3, 3), elements=NUMBERS)
PAIRS = [(a, b) for a in MEASURES for b in MEASURES]


@given(v=VECTORS)
def test_round_trip_from_vectors(v):
    tensor = from_mandel(v)
    np.testing.assert_array_equal(tensor, np.swapaxes(tensor, -1, -2))
    np.testing.assert_allclose(to_mandel(tensor), v, rtol=1e-15, atol=1e-300)


@given(t=TENSORS)
def test_round_trip_from_tensors_keeps_the_symmetric_part(t):
    np.testing.assert_allclose(from_mandel(to_mandel(t)), 0.5 * (t + t.T), rtol=1e-15, atol=1e-300)


@given(a=TENSORS, b=TENSORS)
def test_dot_product_is_the_double_contraction(a, b):
    a = a + a.T  # one of them symmetric is enough
    assert to_mandel(a) @ to_mandel(b) == pytest.approx(np.sum(a * b), rel=1e-12, abs=1e-6)


def test_order_and_basis():
    assert COMPONENTS == ("xx", "yy", "zz", "yz", "xz", "xy")
    t = np.array([[1.0, 6, 5], [6, 2, 4], [5, 4, 3]])
    np.testing.assert_allclose(to_mandel(t), [1, 2, 3, 4 * np.sqrt(2), 5 * np.sqrt(2), 6 * np.sqrt(2)])
    np.testing.assert_allclose(np.einsum("iab,jab->ij", BASIS, BASIS), np.eye(6), atol=1e-15)
    np.testing.assert_allclose(np.einsum("i,iab->ab", to_mandel(t), BASIS), t)
    with pytest.raises(ValueError, match="read-only"):
        BASIS[0, 0, 0] = 2.0


@given(s=NUMBERS)
def test_p_and_q_of_simple_states(s):
    hydrostatic, uniaxial, shear = to_mandel(s * np.eye(3)), to_mandel(np.diag([0.0, s, 0.0])), np.zeros((3, 3))
    shear[0, 1] = shear[1, 0] = s
    assert pressure(hydrostatic) == pytest.approx(-s)
    assert von_mises(hydrostatic) == pytest.approx(0.0, abs=1e-12)
    assert pressure(uniaxial) == pytest.approx(-s / 3.0)
    assert von_mises(uniaxial) == pytest.approx(abs(s))
    assert pressure(to_mandel(shear)) == 0.0
    assert von_mises(to_mandel(shear)) == pytest.approx(np.sqrt(3.0) * abs(s))


@given(v=VECTORS, turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_p_and_q_do_not_see_a_rotation(v, turn):
    R = Rotation.from_rotvec(turn).as_matrix()
    turned = to_mandel(R @ from_mandel(v) @ R.T)
    np.testing.assert_allclose(pressure(turned), pressure(v), atol=1e-10)
    np.testing.assert_allclose(von_mises(turned), von_mises(v), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), np.linalg.norm(v, axis=1), rtol=1e-12)
    assert pressure(v).shape == von_mises(v).shape == (4,)


@pytest.fixture
def states(rng):
    """Kirchhoff stress tensors and deformation gradients that are not symmetric."""
    t = rng.normal(size=(7, 3, 3)) * 100.0
    return t + np.swapaxes(t, 1, 2), np.eye(3) + 0.15 * rng.normal(size=(7, 3, 3))


def test_measures_by_their_definitions(states):
    tau, F = states
    v, inverse = to_mandel(tau), np.linalg.inv(F)
    P = tau @ np.swapaxes(inverse, 1, 2)
    J = np.linalg.det(F)[:, None, None]
    for measure, tensor in (("cauchy", tau / J), ("first_piola", P), ("second_piola", inverse @ P)):
        np.testing.assert_allclose(
            convert_stress(v, F, "kirchhoff", measure), to_mandel(tensor), rtol=1e-11, atol=1e-10
        )


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_stress_round_trip(states, source, target):
    v, F = to_mandel(states[0]), states[1]
    there = convert_stress(v, F, source, target)
    np.testing.assert_allclose(convert_stress(there, F, target, source), v, rtol=1e-9, atol=1e-9)
    if source != target:
        assert np.abs(there - v).max() > 1.0
    else:
        assert there is not v


def law(strain):
    """A nonlinear Kirchhoff stress (6,) with H symmetric, for the tangents."""
    E = from_mandel(strain)
    F = np.eye(3) + E
    return to_mandel(F @ (500.0 * E + 200.0 * E @ E + 300.0 * np.trace(E) * np.eye(3)) @ F.T) + 50.0 * np.sin(strain)


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_tangent_against_differences(source, target, rng):
    strains = 0.1 * rng.normal(size=(3, 6))

    def stress(strain, measure):
        return convert_stress(law(strain)[None], (np.eye(3) + from_mandel(strain))[None], "kirchhoff", measure)[0]

    def tangent(measure):
        steps = 1e-5 * np.eye(6)
        return np.array(
            [np.transpose([(stress(e + h, measure) - stress(e - h, measure)) / 2e-5 for h in steps]) for e in strains]
        )

    given_stress = np.array([stress(e, source) for e in strains])
    F = np.eye(3) + from_mandel(strains)
    found = convert_tangent(tangent(source), given_stress, F, source, target)
    expected = tangent(target)
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_unknown_measure(states):
    assert check_measure("cauchy") == "cauchy"
    for arguments in (("cauchy", "nominal"), ("PK2", "cauchy")):
        with pytest.raises(InputError, match="stress measure: expected one of cauchy, kirchhoff, first_piola"):
            convert_stress(to_mandel(states[0]), states[1], *arguments)
        with pytest.raises(InputError, match="stress measure"):
            convert_tangent(np.zeros((7, 6, 6)), to_mandel(states[0]), states[1], *arguments)
