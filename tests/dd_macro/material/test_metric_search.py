"""The metric against the paper's formula, moduli from data, and the search against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dd_macro import MaterialSearch, Metric, isotropic, mean_tangent, metric_from_dataset, secant_modulus
from dd_macro.material import metric as metric_module
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import COMPONENTS

vectors = arrays(np.float64, 6, elements=st.floats(-1, 1, allow_nan=False))


def spd(seed, scale=1e3):
    A = np.random.default_rng(seed).normal(size=(6, 6))
    return scale * (A @ A.T + 0.5 * np.eye(6))


@settings(deadline=None, max_examples=60, derandomize=True)
@given(vectors, vectors, vectors, vectors, st.integers(0, 1000))
def test_whitened_distance_is_that_of_the_paper(e1, e2, s1, s2, seed):
    metric = Metric(spd(seed), "test")
    s1, s2 = 1e3 * s1, 1e3 * s2
    de, ds = e1 - e2, s1 - s2
    expected = np.sqrt(0.5 * de @ metric.C @ de + 0.5 * ds @ np.linalg.inv(metric.C) @ ds)
    found = np.linalg.norm(metric.whiten(e1, s1) - metric.whiten(e2, s2))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_squares_of_many_points_are_those_of_their_lengths(monkeypatch):
    monkeypatch.setattr(metric_module, "_CHUNK", 7)
    rng = np.random.default_rng(0)
    strain, stress = rng.normal(size=(23, 6)), 1e3 * rng.normal(size=(23, 6))
    metric = Metric(spd(3), "test")
    energies = 0.5 * np.einsum("ni,ij,nj->n", strain, metric.C, strain)
    energies += 0.5 * np.einsum("ni,ij,nj->n", stress, np.linalg.inv(metric.C), stress)
    np.testing.assert_allclose(metric.squares(strain, stress), energies, rtol=1e-9)


def test_isotropic_metric_has_the_elastic_constants():
    S = np.linalg.inv(isotropic(young=2e3, poisson=0.25).C)
    np.testing.assert_allclose(S[0, :3], [1 / 2e3, -0.25 / 2e3, -0.25 / 2e3], rtol=1e-12)
    assert S[5, 5] == pytest.approx(1 / (2 * 800.0), rel=1e-12)  # 1 / (2 G), G = E / (2 (1 + nu))


@pytest.mark.parametrize(
    ("C", "message"),
    [
        (-np.eye(6), "expected a positive definite matrix, got the eigenvalue -1 Pa"),
        (np.diag([1.0, 1, 1, 1, 1, 0]), "positive definite"),
        (np.eye(6) + np.triu(np.ones((6, 6)), 1), "expected a symmetric matrix"),
        (np.full((6, 6), np.nan), "or NaN or infinity"),
        (np.eye(3), r"got shape \(3, 3\)"),
    ],
)
def test_bad_metric(C, message):
    with pytest.raises(InputError, match=message):
        Metric(C, "test")


def test_bad_elastic_constants():
    with pytest.raises(InputError, match="young > 0"):
        isotropic(young=-1.0, poisson=0.3)


def test_secant_modulus_recovers_a_linear_law(rng, make_dataset):
    C = spd(3)
    strain = rng.normal(size=(50, 6))
    metric = secant_modulus(make_dataset(strain, strain @ C))
    np.testing.assert_allclose(metric.C, C, rtol=1e-9, atol=1e-9 * C.max())


def test_secant_modulus_of_in_plane_data(rng, make_dataset):
    """Only the spanned block is fitted, the rest gets its mean modulus; the reason says so."""
    C = spd(4)
    strain = np.zeros((40, 6))
    strain[:, [0, 1, 5]] = rng.normal(size=(40, 3))
    metric = metric_from_dataset(make_dataset(strain, strain @ C))
    block = np.ix_([0, 1, 5], [0, 1, 5])
    np.testing.assert_allclose(metric.C[block], C[block], rtol=1e-9, atol=1e-9 * C.max())
    np.testing.assert_allclose(metric.C[2, 2], np.trace(C[block]) / 3, rtol=1e-9)
    assert "3 strain directions not in the data" in metric.reason


def test_mean_tangent_is_symmetric_and_clipped(rng, make_dataset):
    C = np.diag([100.0, 80.0, 60.0, 40.0, 1e-3, -5.0])
    tangent = np.broadcast_to(C, (10, 6, 6)).copy()
    tangent[:, 0, 1] += np.linspace(-1, 1, 10)  # unsymmetric, of mean zero
    strain = rng.normal(size=(10, 6))
    metric = metric_from_dataset(make_dataset(strain, strain @ C, tangent=tangent))
    np.testing.assert_allclose(np.diag(metric.C), [100, 80, 60, 40, 1, 1], rtol=1e-12)
    assert "mean tangent of 10 data, 2 eigenvalues raised" in metric.reason
    with pytest.raises(InputError, match="expected tangents"):
        mean_tangent(make_dataset(strain, strain))


def test_metric_of_unusable_data(make_dataset, rng):
    with pytest.raises(InputError, match="other than zero"):
        metric_from_dataset(make_dataset(np.zeros((3, 6)), np.zeros((3, 6))))
    strain = rng.normal(size=(20, 6))
    with pytest.raises(InputError, match="are the signs of stress right"):
        metric_from_dataset(make_dataset(strain, -strain))


@settings(deadline=None, max_examples=40, derandomize=True)
@given(vectors, vectors, st.sets(st.sampled_from(COMPONENTS), min_size=1, max_size=5), st.integers(0, 1000))
def test_distance_without_silent_components(strain, stress, silent, seed):
    """It is that of C_aa and its inverse, and c |strain|^2 / 2 + |stress|^2 / (2 c) of the silent ones."""
    C = spd(seed)
    counted = np.array([name not in silent for name in COMPONENTS])
    A = C[np.ix_(counted, counted)]
    c = 1e-3 * np.trace(A) / len(A)
    e, s, f, t = strain[counted], stress[counted], strain[~counted], stress[~counted]
    metric = Metric(C, "test").without(silent)
    expected = e @ A @ e + s @ np.linalg.solve(A, s) + c * f @ f + t @ t / c
    assert (metric.whiten(strain, stress) ** 2).sum() == pytest.approx(0.5 * expected, rel=1e-9, abs=1e-9)
    assert "silent" in metric.reason
    assert metric.without(()) is metric


@pytest.mark.parametrize("silent", [("zx",), COMPONENTS])
def test_components_that_cannot_be_silent(silent):
    with pytest.raises(InputError, match="silent: expected some of xx, yy, zz, yz, xz, xy, got"):
        Metric(np.eye(6), "test").without(silent)


def test_metric_of_data_does_not_know_what_is_silent(rng, make_dataset):
    """Neither the modulus of silent components nor their coupling is in it, from tangents and from stresses."""
    strain = rng.normal(size=(40, 6)) * [1, 1, 1, 0, 0, 1]
    A = spd(4)
    rest = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])
    metrics = []
    for seed, size in ((5, 1.0), (6, 1e3)):
        B = size * spd(seed)
        B[rest] = A[rest]
        given = np.broadcast_to(B, (40, 6, 6))
        metrics.append(
            metric_from_dataset(
                make_dataset(strain, strain @ A * strain.any(axis=0), tangent=given, silent=("yz", "xz"))
            )
        )
    np.testing.assert_array_equal(metrics[0].C, metrics[1].C)
    assert metrics[0].reason == "mean tangent of 40 data, yz and xz silent"
    secant = secant_modulus(make_dataset(strain, strain @ A * strain.any(axis=0), silent=("yz", "xz")))
    np.testing.assert_allclose(secant.C, metrics[0].C, rtol=1e-9, atol=1e-9 * A.max())
    assert secant.reason == "least-squares secant of 40 data, yz and xz silent"  # nothing had to be filled


def brute_force(data, z):
    distance = np.linalg.norm(z[:, None] - data[None], axis=2)
    return distance.argmin(axis=1), distance.min(axis=1)


@pytest.mark.parametrize("spanned", [6, 2])
def test_search_is_exact_with_and_without_skips(rng, make_dataset, spanned):
    """Points drift by small steps; skipped answers must be those of brute force as well, beside the data too."""
    strain = rng.normal(size=(200, spanned)) @ rng.normal(size=(spanned, 6))
    metric = Metric(spd(5, scale=1.0), "test")
    dataset = make_dataset(strain, strain @ spd(6, scale=1.0))
    search = MaterialSearch(dataset, metric)
    data = metric.whiten(dataset.strain, dataset.stress)
    z = data[rng.integers(0, 200, 300)] + 0.3 * rng.normal(size=(300, 12))
    for step in (0.3, 0.05, 0.02, 0.01, 0.2, 0.01):
        z = z + step * rng.normal(size=z.shape)
        index, distance = search.nearest(z)
        expected, length = brute_force(data, z)
        np.testing.assert_array_equal(index, expected)
        np.testing.assert_allclose(distance, length, rtol=1e-12)
    assert search.queries == 1800
    assert 200 < search.skips < 1800
    assert search._data.shape == (200, spanned)


def test_equal_data_count_once_and_a_single_datum_is_enough(rng, make_dataset):
    metric = Metric(np.eye(6), "test")
    strain = np.repeat(rng.normal(size=(2, 6)), 3, axis=0)
    search = MaterialSearch(make_dataset(strain, strain), metric)
    index, distance = search.nearest(metric.whiten(strain, strain))
    np.testing.assert_array_equal(index, [0, 0, 0, 3, 3, 3])
    np.testing.assert_allclose(distance, 0, atol=1e-12)
    single = MaterialSearch(make_dataset(strain[:1], strain[:1]), metric)
    z = rng.normal(size=(5, 12))
    for _ in range(2):
        np.testing.assert_array_equal(single.nearest(z)[0], 0)
    assert single.skips == 5
    assert [len(found) for found in single.nearest(z[:0])] == [0, 0]


def test_search_refuses_nan(make_dataset):
    search = MaterialSearch(make_dataset(np.eye(6), np.eye(6)), Metric(np.eye(6), "test"))
    with pytest.raises(InputError, match=r"expected finite numbers \(n, 12\)"):
        search.nearest(np.full((2, 12), np.nan))
