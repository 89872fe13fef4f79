"""Finite strain: energy against stress against tangent, objectivity, closed forms, and the way to small strain."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI
from scipy.spatial.transform import Rotation

from dd_macro import (
    Displacement,
    FiniteProjection,
    FiniteState,
    GradientOperator,
    LinearLaw,
    MaterialSearch,
    Projection,
    StrainOperator,
    TangentSearch,
    Traction,
    biot_dataset,
    box,
    in_space,
    isotropic,
    read_quadrature,
    solve,
    solve_law,
    solve_second_order,
    write_quadrature,
)
from dd_macro.parallel import total
from dd_macro.scene.kinematics import FiniteStrain, second_piola
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import from_mandel, to_mandel
from tsg_micro.data.stress import convert_stress

pytestmark = pytest.mark.mpi

METRIC = isotropic(young=1e3, poisson=0.3)
LINEAR = LinearLaw(METRIC.C, np.zeros(6))
ALL_SIDES = ("bottom", "top", "left", "right", "back", "front")


class Quartic:
    """A convex energy W of the Biot strain that knows no symmetry: 1/2 e.C.e + (a.e)^4 + (b.e)^4."""

    a, b = 9 * np.array([1.0, -0.5, 0.3, 0.7, 0.2, -0.4]), 9 * np.array([0.2, 0.9, -0.3, 0.1, 0.5, 0.6])

    def energy(self, e):
        return 0.5 * np.einsum("ni,ij,nj->n", e, METRIC.C, e) + (e @ self.a) ** 4 + (e @ self.b) ** 4

    def stress_and_tangent(self, e):
        x, y = e @ self.a, e @ self.b
        stress = e @ METRIC.C + 4 * x[:, None] ** 3 * self.a + 4 * y[:, None] ** 3 * self.b
        second = 12 * x[:, None, None] ** 2 * np.outer(self.a, self.a) + 12 * y[:, None, None] ** 2 * np.outer(
            self.b, self.b
        )
        return stress, METRIC.C + second


def turned(Q, gradient):
    """The gradient (n, 9) of Q F."""
    return (Q @ (np.eye(3) + gradient.reshape(-1, 3, 3)) - np.eye(3)).reshape(-1, 9)


def test_stress_and_tangent_are_derivatives_of_the_energy(rng):
    law, H, h = Quartic(), 0.15 * rng.normal(size=(8, 9)), 1e-6
    found = FiniteStrain(H)
    stress, tangent = law.stress_and_tangent(found.strain)
    P, A = found.nominal_stress(stress), found.nominal_tangent(stress, tangent)
    np.testing.assert_allclose(A, A.swapaxes(1, 2), atol=1e-9 * np.abs(A).max())
    for j in range(9):
        sides = [FiniteStrain(H + sign * h * np.eye(9)[j]) for sign in (1, -1)]
        energy = [law.energy(side.strain) for side in sides]
        np.testing.assert_allclose((energy[0] - energy[1]) / (2 * h), P[:, j], rtol=1e-6, atol=1e-6 * np.abs(P).max())
        forces = [side.nominal_stress(law.stress_and_tangent(side.strain)[0]) for side in sides]
        np.testing.assert_allclose((forces[0] - forces[1]) / (2 * h), A[:, :, j], atol=1e-6 * np.abs(A).max())


@given(st.lists(st.floats(-0.25, 0.25), min_size=9, max_size=9), st.integers(0, 2**32 - 1))
def test_objective_and_in_balance_of_moments(gradient, seed):
    Q = Rotation.random(random_state=seed).as_matrix()
    H, law = np.array([gradient]), Quartic()
    here, there = FiniteStrain(H), FiniteStrain(turned(Q, H))
    np.testing.assert_allclose(there.strain, here.strain, atol=1e-12)
    np.testing.assert_allclose(there.R, Q @ here.R, atol=1e-12)
    stress, tangent = law.stress_and_tangent(here.strain)
    P = here.nominal_stress(stress).reshape(-1, 3, 3)
    size = max(np.abs(P).max(), 1.0)
    np.testing.assert_allclose(there.nominal_stress(stress).reshape(-1, 3, 3), Q @ P, atol=1e-11 * size)
    np.testing.assert_allclose(there.material_stress(there.nominal_stress(stress)), stress, atol=1e-11 * size)
    tau = P @ here.F.swapaxes(1, 2)
    np.testing.assert_allclose(tau, tau.swapaxes(1, 2), atol=1e-11 * size)
    turn = np.kron(Q, np.eye(3))
    A = here.nominal_tangent(stress, tangent)
    np.testing.assert_allclose(there.nominal_tangent(stress, tangent), turn @ A @ turn.T, atol=1e-10 * np.abs(A).max())


def test_isotropic_stress_in_closed_form(rng):
    """T and U have the same axes: P = R (lambda tr(U - I) I + 2 mu (U - I))."""
    found = FiniteStrain(0.2 * rng.normal(size=(6, 9)))
    young, poisson = 1e3, 0.3
    mu, lame = young / 2 / (1 + poisson), young * poisson / (1 + poisson) / (1 - 2 * poisson)
    E = found.U - np.eye(3)
    T = lame * np.trace(E, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 2 * mu * E
    P = found.nominal_stress(LINEAR.stress_and_tangent(found.strain)[0]).reshape(-1, 3, 3)
    np.testing.assert_allclose(P, found.R @ T, atol=1e-10)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_a_gradient_without_bounds_is_inside_out(bad):
    """It must not raise where it is found: other ranks may not have found one."""
    gradient = np.zeros((3, 9))
    gradient[1, 4] = bad
    found = FiniteStrain(gradient)
    assert found.inside_out
    stress = np.ones((3, 6))
    assert np.isfinite(found.strain).all()
    assert np.isfinite(found.nominal_stress(stress)).all()
    assert not FiniteStrain(gradient[[0, 2]]).inside_out


@pytest.fixture(scope="module")
def domain():
    return box(MPI.COMM_WORLD, elements=(4, 4, 1), size=(4e-5, 4e-5, 1e-5))


@pytest.fixture(scope="module")
def operator(domain):
    return GradientOperator(domain)


@pytest.fixture(scope="module")
def data():
    """Data of the quartic law at random strains of all components."""
    strain = np.random.default_rng(3).uniform(-0.08, 0.08, (400, 6))
    stress, tangent = Quartic().stress_and_tangent(strain)
    n = np.arange(len(strain))
    return Dataset(strain, stress, "first_piola", path=0 * n, step=n, tangent=tangent)


def pulled(size, Q=None):
    """Bottom held and top pulled and sheared; then the whole body turned by Q."""
    Q = np.eye(3) if Q is None else Q

    def turn(shift):
        return lambda x: (x + shift) @ Q.T - x

    return [Displacement("bottom", turn(np.zeros(3))), Displacement("top", turn(np.array([0.5, 1.0, 0.0]) * size))]


@pytest.mark.parametrize("angle", [0.0, 30.0, 150.0])
def test_patch_whatever_the_rotation(operator, data, angle):
    """A datum everywhere, and its affine motion on all sides: no distance, and the datum is found."""
    Q = Rotation.from_rotvec(np.deg2rad(angle) * np.array([0.6, 0.0, 0.8])).as_matrix()
    datum = 17
    U = np.eye(3) + from_mandel(data.strain[datum])
    affine = [Displacement(side, lambda x: x @ (Q @ U - np.eye(3)).T) for side in ALL_SIDES]
    scene = FiniteProjection(operator, METRIC, affine)
    result = solve(scene, MaterialSearch(data, METRIC))
    assert (result.index == datum).all()
    assert result.normalised_distance < 1e-7
    z = result.mechanical
    assert isinstance(z, FiniteState)
    np.testing.assert_allclose(z.F, np.broadcast_to(Q @ U, z.F.shape), atol=1e-8)
    P = Q @ U @ second_piola(U[None], data.stress[[datum]])[0]
    np.testing.assert_allclose(z.first_piola, np.broadcast_to(P, z.F.shape), atol=1e-6 * np.abs(P).max())


def test_second_order_is_objective(operator, data):
    """The body turned as a whole carries the same stretches and stresses, its displacement turned."""
    x = operator.node_coordinates()
    here = solve_second_order(FiniteProjection(operator, METRIC, pulled(2e-6)), TangentSearch(data, METRIC))
    Q = Rotation.from_rotvec([0.5, -0.3, 0.7]).as_matrix()
    scene = FiniteProjection(operator, METRIC, pulled(2e-6, Q))
    there = solve_second_order(scene, TangentSearch(data, METRIC), start=_turned_start(scene, here, Q, x))
    u = here.mechanical.u.reshape(-1, 3)
    np.testing.assert_allclose(there.mechanical.u.reshape(-1, 3), (x + u) @ Q.T - x, atol=1e-8 * 2e-6)
    np.testing.assert_array_equal(there.index, here.index)
    np.testing.assert_allclose(there.mechanical.stress, here.mechanical.stress, atol=1e-6 * METRIC.C[0, 0] * 0.05)


def _turned_start(scene, result, Q, x):
    z = result.mechanical
    u = ((x + z.u.reshape(-1, 3)) @ Q.T - x).reshape(-1)
    return dataclasses.replace(scene.elastic(), u=u, strain=z.strain, stress=z.stress)


def test_rotated_body_is_found_from_the_elastic_start(operator, data):
    """No start is given: Newton's method finds the turned solution from that of linear elasticity."""
    Q = Rotation.from_rotvec([0.0, 0.0, np.deg2rad(25)]).as_matrix()
    here, there = (
        solve_second_order(FiniteProjection(operator, METRIC, pulled(1e-6, turn)), TangentSearch(data, METRIC))
        for turn in (None, Q)
    )
    off = here.mechanical.strain - there.mechanical.strain  # the data picked may differ in few points
    sums = total(operator.comm, [(operator.weights @ e**2).sum() for e in (off, here.mechanical.strain)])
    assert np.sqrt(sums[0] / sums[1]) < 0.02


def test_second_order_is_newton_on_a_law_that_is_linear(operator):
    """One datum with its tangent is the law itself: two routes to one solution, loads and free sides included."""
    datum = Dataset(
        np.zeros((1, 6)), np.zeros((1, 6)), "first_piola", path=np.zeros(1, int), step=np.zeros(1, int),
        tangent=METRIC.C[None],
    )  # fmt: skip
    conditions, pull = pulled(4e-6), [Traction("right", (30.0, 0.0, 5.0))]
    scene = FiniteProjection(operator, METRIC, conditions, pull)
    a = solve_second_order(scene, TangentSearch(datum, METRIC))
    b = solve_law(operator, LINEAR, conditions, pull)
    np.testing.assert_allclose(a.mechanical.u, b.mechanical.u, atol=1e-9 * 4e-6)
    np.testing.assert_allclose(scene.reaction(a.mechanical, "top"), b.reactions["top"], rtol=1e-7, atol=1e-18)
    assert scene.residual(a.mechanical.nominal_stress) < 1e-9
    assert a.normalised_distance < 1e-9
    in_balance = scene.reaction(a.mechanical, "top") + scene.reaction(a.mechanical, "bottom")
    np.testing.assert_allclose(in_balance, -4e-5 * 1e-5 * np.array([30.0, 0, 5.0]), rtol=1e-8, atol=1e-16)


def test_small_strain_is_the_limit(domain, operator):
    """The two kinematics differ by the square of the load."""
    small = StrainOperator(domain)
    gaps = []
    for size in (4e-7, 2e-7, 1e-7):
        a = solve_law(operator, Quartic(), pulled(size)).mechanical.u
        b = solve_law(small, Quartic(), pulled(size)).mechanical.u
        gaps.append(np.sqrt(total(operator.comm, ((a - b) ** 2).sum())))
    rates = np.diff(np.log(gaps)) / np.diff(np.log([4e-7, 2e-7, 1e-7]))
    np.testing.assert_allclose(rates, 2.0, atol=0.1)


def test_classical_solve_nears_the_law(operator):
    """Points as data, ever denser: the error against Newton's method on their law falls."""
    exact = solve_law(operator, Quartic(), pulled(2e-6)).mechanical
    comm, domain = operator.comm, operator.domain
    cells = np.concatenate(comm.allgather(domain.mesh.topology.original_cell_index[: domain.owned_cells]))
    visited = np.concatenate(comm.allgather(exact.strain.reshape(-1, operator.points_per_cell, 6)))
    visited = visited[np.argsort(cells)].reshape(-1, 6)  # the same data on any number of ranks
    errors = []
    for n in (30, 3000):
        pick = np.random.default_rng(1).choice(len(visited), n)
        noise = np.random.default_rng(n).normal(size=(n, 6)) * 0.02 * (30 / n) ** 0.5
        strain = visited[pick] + noise
        k = np.arange(n)
        points = Dataset(strain, Quartic().stress_and_tangent(strain)[0], "first_piola", path=0 * k, step=k)
        result = solve(FiniteProjection(operator, METRIC, pulled(2e-6)), MaterialSearch(points, METRIC))
        off = ((result.mechanical.stress - exact.stress) ** 2).sum(axis=1)
        sums = total(operator.comm, [operator.weights @ off, operator.weights @ (exact.stress**2).sum(axis=1)])
        errors.append(np.sqrt(sums[0] / sums[1]))
    assert errors[1] < 0.4 * errors[0]
    assert errors[1] < 0.08


def test_shown_in_space(operator, data, folder):
    """Both states turned back: first Piola stress of the state, and the same point in another measure."""
    scene = FiniteProjection(operator, METRIC, pulled(2e-6))
    result = solve(scene, MaterialSearch(data, METRIC))
    shown, z = in_space(result), result.mechanical
    assert isinstance(z, FiniteState)
    np.testing.assert_allclose(shown.mechanical.stress, to_mandel(z.first_piola), atol=1e-9)
    np.testing.assert_allclose(shown.mechanical.strain, to_mandel(z.F - np.eye(3)), atol=1e-14)
    cauchy = in_space(result, "cauchy").mechanical.stress
    np.testing.assert_allclose(
        convert_stress(cauchy, z.F, "cauchy", "first_piola"), shown.mechanical.stress, atol=1e-9 * METRIC.C[0, 0]
    )
    found = FiniteStrain((z.F - np.eye(3)).reshape(-1, 9))
    U = np.eye(3) + from_mandel(result.material_strain)
    np.testing.assert_allclose(shown.material_strain, to_mandel(found.R @ U - np.eye(3)), atol=1e-12)
    write_quadrature(folder / "q.h5", operator, result, stress_measure="cauchy")
    written = read_quadrature(folder / "q.h5").mechanical_stress.reshape(-1, 6)
    squares = [
        total(operator.comm, operator.weights @ cauchy**2),
        written.T**2 @ np.tile(operator.weights[0], len(written)),
    ]
    np.testing.assert_allclose(squares[1], squares[0], rtol=1e-9)
    small = solve(Projection(StrainOperator(operator.domain), METRIC, pulled(2e-6)), MaterialSearch(data, METRIC))
    assert in_space(small) is small


def test_data_of_any_gradient_become_biot_data(data, rng):
    """Data with rotations, as block means have, are those of the same law."""
    R = Rotation.random(len(data), random_state=1).as_matrix()
    U = np.eye(3) + from_mandel(data.strain)
    F, S = R @ U, second_piola(U, data.stress)
    given = dataclasses.replace(
        data, strain=to_mandel(F - np.eye(3)), stress=to_mandel(F @ S @ F.swapaxes(1, 2)), stress_measure="kirchhoff",
        tangent=None, deformation_gradient=F,
    )  # fmt: skip
    found = biot_dataset(given)
    np.testing.assert_allclose(found.strain, data.strain, atol=1e-12)
    np.testing.assert_allclose(found.stress, data.stress, atol=1e-9 * np.abs(data.stress).max())
    assert biot_dataset(data) is data
    with pytest.raises(InputError, match="got the kirchhoff stress alone"):
        biot_dataset(dataclasses.replace(given, deformation_gradient=None))


def test_errors(operator, data):
    scene = FiniteProjection(operator, METRIC, pulled(1e-6))
    with pytest.raises(InputError, match="expected local-tangent in finite strain"):
        solve_second_order(scene, TangentSearch(data, METRIC), method="alternating")
    crushed = [Displacement("bottom"), Displacement("top", (0.0, -6e-5, 0.0))]
    with pytest.raises(ConvergenceError, match="det F > 0"):
        solve(FiniteProjection(operator, METRIC, crushed), MaterialSearch(data, METRIC))
    with pytest.raises(ConvergenceError, match="det F > 0"):
        solve_law(operator, LINEAR, crushed)
