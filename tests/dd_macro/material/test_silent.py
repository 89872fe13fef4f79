"""What the data are silent about does not count in the solve: closed forms, and the limit that it stands for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro.material.metric
from dd_macro import (
    Displacement,
    MaterialSearch,
    Metric,
    Problem,
    Projection,
    StrainOperator,
    TangentSearch,
    box,
    choose_metric,
    estimate_tangents,
    isotropic,
    metric_from_dataset,
    secant_modulus,
    solve,
    solve_second_order,
)
from dd_macro.parallel import total
from tsg_micro.data.mandel import to_mandel

pytestmark = pytest.mark.mpi

LAW = isotropic(young=1e3, poisson=0.3)
SHEET = [2, 3, 4]
H = np.array([[0.02, 0.01, 0.004], [-0.005, 0.03, 0.004], [0.006, -0.012, -0.02]])
"""Of a sheet that is sheared through its thickness too."""


@pytest.fixture(scope="module")
def operator():
    return StrainOperator(box(MPI.COMM_WORLD, elements=(6, 4, 1), size=(6e-5, 4e-5, 1e-5)))


@pytest.fixture
def sheet_data(make_dataset):
    """``n`` data of the law in plane stress, random in a box of in-plane strains; ``exact`` (6,) is one of them."""

    def make(n, exact=None):
        strain = np.zeros((n, 6))
        strain[:, [0, 1, 5]] = np.random.default_rng(3).uniform([-0.03, -0.02, -0.03], [0.03, 0.08, 0.03], (n, 3))
        if exact is not None:
            strain[0] = exact * [1, 1, 0, 0, 0, 1]
        strain[:, 2] = -LAW.C[2, 0] / LAW.C[2, 2] * (strain[:, 0] + strain[:, 1])
        stress = strain @ LAW.C
        stress[:, SHEET] = 0.0
        return make_dataset(strain, stress, silent=("yz", "xz"))

    return make


def test_patch_sheared_out_of_plane(operator, sheet_data):
    """The exact state is a datum but for the shear: that costs c/2 |strain|^2 a volume, and nothing else is off."""
    strain = to_mandel(H)
    strain[2] = -LAW.C[2, 0] / LAW.C[2, 2] * (strain[0] + strain[1])
    gradient = H.copy()
    gradient[2, 2] = strain[2]
    data = sheet_data(60, strain)
    sides = [Displacement(side, lambda x: x @ gradient.T) for side in operator.domain.names]
    distance = {}
    for silent in (data.silent, ()):
        metric = Metric(1.7 * LAW.C, "not the law").without(silent)
        result = solve(Projection(operator, metric, sides), MaterialSearch(data, metric))
        np.testing.assert_array_equal(result.index, 0)
        np.testing.assert_allclose(
            result.mechanical.strain, np.broadcast_to(strain, (len(result.index), 6)), atol=1e-12
        )
        np.testing.assert_allclose(result.mechanical.stress, result.material_stress, atol=1e-9)
        volume = total(operator.comm, operator.weights.sum())
        shear = metric.C[3, 3] * (strain[3:5] @ strain[3:5])
        assert result.distance == pytest.approx(np.sqrt(0.5 * shear * volume), rel=1e-9)
        distance[silent] = result.normalised_distance
    assert distance[()] > 0.15
    assert distance[data.silent] < 0.01


def test_weight_of_silent_components_does_not_matter(operator, monkeypatch):
    """All that counts has a limit that is approached like c, the stress of silent components goes to zero like c."""
    x, y, _ = operator.points.T / 1e-5
    strain = np.zeros((len(x), 6))
    strain[:, 1] = 0.03 + 0.01 * np.sin(x)
    strain[:, 2] = -0.02 * np.cos(x * y)  # thinner here and there: so it is sheared
    stress = strain @ LAW.C
    stress[:, SHEET] = 0.0
    states = []
    for c in (1e-3, 1e-4, 1e-5):
        monkeypatch.setattr(dd_macro.material.metric, "_SILENT", c)
        states.append(Projection(operator, LAW.without(("yz", "xz")), clamped()).project(strain, stress))
    counted = [0, 1, 2, 5]
    for quantity in ("strain", "stress"):
        first, second, third = (getattr(z, quantity)[:, counted] for z in states)
        size, change, next_change = (size_of(operator, a) for a in (third, first - second, second - third))
        assert change < 0.003 * size
        assert next_change < 0.12 * change
    shears = [size_of(operator, z.stress[:, 3:5]) for z in states]
    assert shears[0] < 1e-3 * size_of(operator, states[0].stress)
    np.testing.assert_allclose(shears[1:], [0.1 * shears[0], 0.01 * shears[0]], rtol=0.05)
    assert size_of(operator, states[2].strain[:, 3:5]) > 0.05 * size_of(operator, states[2].strain)


def clamped():
    return [Displacement("bottom"), Displacement("top", (0.0, 2e-6, 0.0))]


def size_of(operator, field):
    return np.sqrt(total(operator.comm, operator.weights @ (field**2).sum(axis=1)))


def test_clamped_sheet(operator, sheet_data):
    """Where the sheet thins beside its clamps the data say nothing: less distance, and it converges as before."""
    data = sheet_data(2000)
    results = {}
    for silent in (data.silent, ()):
        metric = secant_modulus(replace(data, silent=silent))
        scene = Projection(operator, metric, clamped())
        result = results[silent] = solve(scene, MaterialSearch(data, metric))
        plain = [h.distance for h in result.history if h.omega == 1]
        assert plain == sorted(plain, reverse=True)
        assert scene.residual(result.mechanical.stress) < 1e-10
    without, within = results[data.silent], results[()]
    assert without.normalised_distance < 0.95 * within.normalised_distance
    assert size_of(operator, without.mechanical.stress[:, 3:5]) < 0.02 * size_of(
        operator, within.mechanical.stress[:, 3:5]
    )
    assert without.iterations < 2 * within.iterations


def test_estimated_tangents_carry_no_silent_shear(operator, sheet_data):
    """Both second-order methods agree, and leave the shear free of stress; the plane stress of linear data is exact."""
    data = sheet_data(400)
    metric = secant_modulus(data)
    full = estimate_tangents(data)
    scene = Projection(operator, metric, clamped())
    a, b = (
        solve_second_order(scene, TangentSearch(full, metric), method=method).mechanical
        for method in ("local-tangent", "alternating")
    )
    np.testing.assert_allclose(a.stress, b.stress, atol=1e-4 * np.abs(a.stress).max())
    assert size_of(operator, a.stress[:, 3:5]) < 0.02 * size_of(operator, a.stress)
    expected = np.zeros((len(a.strain), 6))
    expected[:] = a.strain @ LAW.C
    expected -= np.outer(expected[:, 2], LAW.C[2]) / LAW.C[2, 2]  # the law with sigma_zz = 0
    keep = np.abs(a.strain[:, 2] + LAW.C[2, 0] / LAW.C[2, 2] * (a.strain[:, 0] + a.strain[:, 1])) < 1e-4
    np.testing.assert_allclose(
        a.stress[keep][:, [0, 1, 5]], expected[keep][:, [0, 1, 5]], atol=0.02 * np.abs(expected).max()
    )


def test_tangents_speak_for_silent_components(operator, sheet_data):
    """The metric of second-order data leaves nothing out, where these came with tangents of all strains."""
    data = sheet_data(50)
    tangent = np.broadcast_to(LAW.C, (50, 6, 6))
    problem = Problem(operator, clamped())
    both = [choose_metric("auto", problem, replace(data, tangent=tangent), order=order).C for order in (1, 2)]
    np.testing.assert_allclose(both[1], LAW.C, rtol=1e-12, atol=1e-12 * LAW.C.max())
    assert both[0][3, 3] < 0.01 * both[1][3, 3]
    made = choose_metric("auto", problem, data, order=2)
    np.testing.assert_array_equal(made.C, metric_from_dataset(data).C)
