"""Fitted laws and Newton's method: exact recovery, derivatives, patch tests, closed forms, quadratic convergence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.optimize
from mpi4py import MPI
from petsc4py import PETSc

from dd_macro import (
    Displacement,
    LinearLaw,
    Metric,
    NewtonIteration,
    PolynomialEnergy,
    Projection,
    ReferenceOptions,
    StrainOperator,
    TangentMatrix,
    Traction,
    box,
    fit_linear,
    fit_polynomial,
    isotropic,
    mirrors_of,
    solve_law,
)
from dd_macro.parallel import total
from tsg_micro.data.errors import ConvergenceError, InputError

pytestmark = pytest.mark.mpi

C = isotropic(young=1e3, poisson=0.3).C
SCALE = np.full(6, 0.05)


def convex_energy(degree, seed=0):
    """A convex energy with all mirrors: 1/2 epsilon : C : epsilon, and a quartic with random weights."""
    rng = np.random.default_rng(seed)
    terms: dict[tuple[int, ...], float] = {}

    def add(exponent, value):
        terms[tuple(exponent)] = terms.get(tuple(exponent), 0.0) + value

    unit = np.eye(6, dtype=int)
    for i in range(6):
        for j in range(6):
            add(unit[i] + unit[j], 0.5 * C[i, j] * SCALE[i] * SCALE[j])
    if degree == 4:
        for i in range(6):
            for j in range(6):  # (x^T A x)^2 with A diagonal and positive
                add(2 * unit[i] + 2 * unit[j], 2.0 * np.prod(rng.uniform(0.5, 1.5, 2)))
        add(3 * unit[0], 0.1)
    add(unit[1], 0.3)
    exponents = np.array(list(terms))
    coefficients = np.array(list(terms.values()))
    keep = coefficients != 0.0
    return PolynomialEnergy(exponents[keep], coefficients[keep], SCALE)


@pytest.fixture
def data_of(make_dataset):
    def make(law, strain, tangents=True):
        stress, tangent = law.stress_and_tangent(strain)
        return make_dataset(strain, stress, **({"tangent": np.array(tangent)} if tangents else {}))

    return make


def random_strain(n, seed=1):
    return np.random.default_rng(seed).uniform(-0.05, 0.05, (n, 6))


@pytest.mark.parametrize("tangents", [True, False])
@pytest.mark.parametrize("degree", [2, 4])
def test_fit_recovers_a_polynomial_energy(data_of, degree, tangents):
    law = convex_energy(degree)
    fit = fit_polynomial(data_of(law, random_strain(200), tangents), degree=degree, mirrors="xyz")
    stress, tangent = law.stress_and_tangent(random_strain(50, seed=2))
    found, found_tangent = fit.stress_and_tangent(random_strain(50, seed=2))
    np.testing.assert_allclose(found, stress, rtol=0, atol=1e-9 * np.abs(stress).max())
    np.testing.assert_allclose(found_tangent, tangent, rtol=0, atol=1e-9 * np.abs(tangent).max())
    assert fit.report is not None
    assert fit.report.stress_error < 1e-11
    assert fit.report.held_out_error is not None
    assert fit.report.held_out_error < 1e-10
    assert fit.report.rank == fit.report.coefficients == {2: 12, 4: 74}[degree]


def test_fit_of_all_monomials_recovers_an_energy_without_mirrors(data_of):
    rng = np.random.default_rng(3)
    exponents = np.array([[1, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 1], [0, 2, 0, 1, 0, 0], [0, 0, 1, 1, 1, 1]])
    law = PolynomialEnergy(exponents, rng.normal(size=4), SCALE)  # not convex
    data = data_of(law, random_strain(300))
    assert mirrors_of(data) == ""
    fit = fit_polynomial(data, convex=False)
    stress, _ = law.stress_and_tangent(random_strain(50, seed=2))
    np.testing.assert_allclose(
        fit.stress_and_tangent(random_strain(50, seed=2))[0], stress, atol=1e-9 * abs(stress).max()
    )
    assert fit.report is not None
    assert fit.report.coefficients == 209


def test_stress_and_tangent_are_derivatives_of_the_energy(rng):
    law = PolynomialEnergy(rng.integers(0, 3, (30, 6)), rng.normal(size=30), rng.uniform(0.02, 0.1, 6))
    strain, h = random_strain(20), 1e-6
    stress, tangent = law.stress_and_tangent(strain)
    for k, e in enumerate(h * np.eye(6)):
        slope = (law.energy(strain + e) - law.energy(strain - e)) / (2 * h)
        np.testing.assert_allclose(slope, stress[:, k], atol=1e-6 * np.abs(stress).max())
        rate = (law.stress_and_tangent(strain + e)[0] - law.stress_and_tangent(strain - e)[0]) / (2 * h)
        np.testing.assert_allclose(rate, tangent[:, k], atol=1e-6 * np.abs(tangent).max())


def test_mirrors_that_the_data_show(data_of):
    strain = random_strain(40)
    strain[:, 3:5] = 0.0
    data = data_of(convex_energy(4), strain)
    assert mirrors_of(data) == "z"  # xy is never zero, so nothing tells about x and y
    strain[0, 5] = 0.0
    data = data_of(convex_energy(4), strain)
    assert mirrors_of(data) == "xyz"
    broken = data.tangent.copy()
    broken[0, 0, 5] = broken[0, 5, 0] = 1e-3 * np.abs(broken).max()
    assert mirrors_of(dataclasses.replace(data, tangent=broken)) == "z"


def test_linear_fit_of_linear_data_is_exact_and_fills_what_is_not_spanned(data_of):
    law = LinearLaw(C, np.array([3.0, 1.0, 0.0, 0.0, 0.0, -2.0]))
    strain = random_strain(30)
    for tangents in (True, False):
        fit = fit_linear(data_of(law, strain, tangents))
        np.testing.assert_allclose(fit.C, C, atol=1e-8 * C.max())
        np.testing.assert_allclose(fit.initial_stress, law.initial_stress, atol=1e-8 * C.max())
    strain[:, 2:] = 0.0
    fit = fit_linear(data_of(law, strain, tangents=False))
    np.testing.assert_allclose(fit.C[:2, :2], C[:2, :2], atol=1e-8 * C.max())
    np.testing.assert_allclose(fit.C[2:, 2:], C[:2, :2].trace() / 2 * np.eye(4), atol=1e-8 * C.max())
    assert fit.report is not None
    assert "4 strain directions not in the data" in fit.report.reason
    # what the tangents say about directions without strain counts: nothing is filled
    np.testing.assert_allclose(fit_linear(data_of(law, strain)).C, C, atol=1e-8 * C.max())
    polynomial = fit_polynomial(data_of(law, strain, tangents=False))
    np.testing.assert_allclose(
        polynomial.stress_and_tangent(strain)[1][:, 2:, 2:] - fit.C[2:, 2:], 0.0, atol=0.01 * C.max()
    )


def test_linear_fit_minimises_what_is_documented(data_of, rng):
    """The gradient of the sum of squares by C and sigma_0 vanishes (finite differences)."""
    data = data_of(convex_energy(4), random_strain(60))
    fit = fit_linear(data)
    rms2 = (data.strain**2).sum(axis=1).mean()

    def squares(modulus, initial):
        s = ((initial + data.strain @ modulus - data.stress) ** 2).sum()
        return s + ((modulus - data.tangent) ** 2).sum() * rms2 / 6

    for _ in range(5):
        dC, ds = rng.normal(size=(6, 6)), rng.normal(size=6)
        dC = 1e-3 * fit.C.max() * (dC + dC.T)
        ds = 1e-3 * np.abs(data.stress).max() * ds
        up, down = squares(fit.C + dC, fit.initial_stress + ds), squares(fit.C - dC, fit.initial_stress - ds)
        assert abs(up - down) < 1e-9 * squares(fit.C, fit.initial_stress)


def test_convex_fit_of_data_that_polynomials_wiggle_through(make_dataset):
    """sigma = tanh(epsilon / 0.01) in each component is convex; a quartic through it is not, the constrained one is."""
    strain = random_strain(300)
    data = make_dataset(strain, np.tanh(strain / 0.01))
    around = strain + np.random.default_rng(5).uniform(-0.003, 0.003, strain.shape)
    softest = [
        np.linalg.eigvalsh(fit_polynomial(data, mirrors="xyz", convex=c).stress_and_tangent(around)[1])[:, 0].min()
        for c in (False, True)
    ]
    assert softest[0] < 0.0 < softest[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"degree": 1}, "degree: expected a whole number"), ({"mirrors": "w"}, "mirrors: expected some")],
)
def test_bad_arguments_of_the_fit(data_of, arguments, message):
    with pytest.raises(InputError, match=message):
        fit_polynomial(data_of(LinearLaw(C, np.zeros(6)), random_strain(5)), **arguments)


@pytest.fixture
def operator(comm):
    return StrainOperator(box(comm, elements=(4, 3, 2), size=(4e-5, 3e-5, 2e-5)))


SCENE = ([Displacement("bottom"), Displacement("top", (1e-6, 2e-6, 0.0))], [Traction("right", (0.0, 30.0, 10.0))])


def test_linear_law_gives_the_elastic_solution(operator):
    """Two routes: the projection's Cholesky solve with one C, and Newton with a C at every point; one step is exact."""
    projection = Projection(operator, Metric(C, ""), *SCENE)
    elastic = projection.elastic()
    result = solve_law(operator, LinearLaw(C, np.zeros(6)), *SCENE)
    assert result.iterations == 1
    assert result.residual < 1e-12
    np.testing.assert_allclose(result.mechanical.u, elastic.u, atol=1e-12 * 2e-6)
    np.testing.assert_allclose(result.mechanical.stress, elastic.stress, atol=1e-9)
    for side in ("top", "bottom"):
        pull = projection.reaction(elastic, side)
        np.testing.assert_allclose(result.reactions[side], pull, atol=1e-10 * np.abs(pull).max())


def test_stiffness_of_a_modulus_per_point_is_its_energy(operator):
    """u^T K u = sum w epsilon : C : epsilon for moduli that vary from point to point."""
    moduli = C * (1.0 + 0.5 * np.sin(1e5 * operator.points @ [1.0, 2.0, 3.0]))[:, None, None]
    K = TangentMatrix(operator).assemble(moduli)
    u, force = K.createVecs()
    x = operator.node_coordinates()
    u.array[:] = (x**2 @ np.array([[3.0, 1, 2], [0, 1, -1], [2, -2, 1]])).reshape(-1)
    K.mult(u, force)
    strain = operator.strain(u.array.copy())
    energy = operator.weights @ np.einsum("ni,nij,nj->n", strain, moduli, strain)
    assert u.dot(force) == pytest.approx(float(total(operator.comm, energy)), rel=1e-12)
    expected = operator.force(np.einsum("nij,nj->ni", moduli, strain))
    np.testing.assert_allclose(force.array, expected, atol=1e-11 * np.abs(expected).max())


def test_affine_displacement_gives_the_stress_of_the_law(operator):
    law = convex_energy(4)
    H = np.array([[0.02, 0.01, 0.0], [0.03, -0.02, 0.01], [0.0, 0.01, 0.03]])
    sides = operator.domain.names
    result = solve_law(operator, law, [Displacement(side, lambda x: x @ H.T) for side in sides])
    e = 0.5 * (H + H.T)
    r = np.sqrt(2.0)
    strain = np.array([[e[0, 0], e[1, 1], e[2, 2], r * e[1, 2], r * e[0, 2], r * e[0, 1]]])
    stress, _ = law.stress_and_tangent(strain)
    np.testing.assert_allclose(
        result.mechanical.strain, np.broadcast_to(strain, result.mechanical.strain.shape), atol=1e-12
    )
    np.testing.assert_allclose(
        result.mechanical.stress, np.broadcast_to(stress, result.mechanical.stress.shape), atol=1e-7
    )


FREE = [Displacement("left", (0.0,), (0,)), Displacement("bottom", (0.0,), (1,)), Displacement("back", (0.0,), (2,))]


@pytest.mark.parametrize("pulled", [True, False])
def test_uniaxial_stress_against_the_root_of_the_closed_form(operator, pulled):
    """A bar with free sides: sigma_yy = sigma_zz = 0 solved by scipy for one strain, by displacement and by load."""
    law = convex_energy(4)

    def stress_at(e):
        return law.stress_and_tangent(np.array([[*e, 0.0, 0.0, 0.0]]))[0][0, :3]

    sides = scipy.optimize.root(lambda e: stress_at([0.04, *e])[1:], [-0.01, -0.01], tol=1e-14).x
    sigma = stress_at([0.04, *sides])[0]
    if pulled:
        result = solve_law(operator, law, [*FREE, Displacement("right", (0.04 * 4e-5,), (0,))])
        np.testing.assert_allclose(result.reactions["right"], [sigma * 6e-10, 0.0, 0.0], atol=1e-8 * sigma * 6e-10)
    else:
        result = solve_law(operator, law, FREE, [Traction("right", (sigma, 0.0, 0.0))])
    expected = np.array([0.04, *sides, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(
        result.mechanical.strain, np.broadcast_to(expected, result.mechanical.strain.shape), atol=1e-9
    )


def test_newton_converges_quadratically(operator):
    stiff = [Displacement("bottom"), Displacement("top", (2e-6, 4e-6, 0.0))]
    result = solve_law(operator, convex_energy(4), stiff, options=ReferenceOptions(tolerance=1e-12))
    r = np.array([i.residual for i in result.history])
    assert result.load_steps == 1
    assert all(i.step == 1.0 and i.negative_pivots in (0, None) for i in result.history)
    last = [k for k in range(2, len(r)) if r[k] > 1e-13][-1]  # above round-off
    assert r[last - 1] < 1e-2
    assert np.log(r[last] / r[last - 1]) / np.log(r[last - 1] / r[last - 2]) > 1.8


def test_load_steps_lead_to_the_same_state(operator):
    law = convex_energy(4)
    one, four = solve_law(operator, law, *SCENE), solve_law(operator, law, *SCENE, steps=4)
    assert (one.load_steps, four.load_steps) == (1, 4)
    np.testing.assert_allclose(four.mechanical.u, one.mechanical.u, atol=1e-8 * 2e-6)


def test_initial_stress_relaxes_where_nothing_holds_it(operator):
    """No load at all: the strain is that of zero stress, -C^-1 sigma_0."""
    initial = np.array([3.0, 1.0, -2.0, 0.0, 0.0, 0.0])
    result = solve_law(operator, LinearLaw(C, initial), FREE)
    np.testing.assert_allclose(result.mechanical.strain - np.linalg.solve(C, -initial), 0.0, atol=1e-12)


@dataclasses.dataclass
class FailsBeyond:
    """Linear up to a strain, and beyond it an error, as of an RVE that finds no equilibrium."""

    strain: float
    failures: int = 0

    def stress_and_tangent(self, strain):
        if (np.abs(strain) > self.strain).any():
            self.failures += 1
            raise ConvergenceError("too much")
        return strain @ C, np.broadcast_to(C, (len(strain), 6, 6))


def test_a_law_that_fails_somewhere_is_one_error_on_all_ranks(operator):
    law = FailsBeyond(0.05)
    with pytest.raises(ConvergenceError, match=r"the law fails at load .*: too much") as caught:
        solve_law(operator, law, *SCENE, options=ReferenceOptions(max_cuts=3))
    last = caught.value.history[-1]  # of what went well before
    assert isinstance(last, NewtonIteration)
    assert 0 < last.load < 1
    assert total(operator.comm, law.failures) >= 4


def test_no_equilibrium_is_an_error_with_history(operator):
    """W = C - k |epsilon|^4 softens: the traction asked for is beyond the largest it can carry."""
    exponents = [[2, 0, 0, 0, 0, 0], [4, 0, 0, 0, 0, 0], *(2 * np.eye(6, dtype=int)[1:])]
    law = PolynomialEnergy(np.array(exponents), np.array([1.0, -0.5, 1.0, 1.0, 1.0, 1.0, 1.0]), SCALE)
    most = (2 * 3**-0.5 - 2 * 3**-1.5) / 0.05  # max of 2 x - 2 x^3 over the scale
    fine = solve_law(operator, law, FREE, [Traction("right", (0.9 * most, 0.0, 0.0))])
    assert fine.residual < 1e-9
    with pytest.raises(ConvergenceError, match=r"Newton's method, from load 0\.9") as caught:
        solve_law(operator, law, FREE, [Traction("right", (1.1 * most, 0.0, 0.0))])
    assert len(caught.value.history) > 10


def test_bad_options(operator):
    with pytest.raises(InputError, match="tolerance: expected a number between 0 and 1"):
        ReferenceOptions(tolerance=0.0)
    with pytest.raises(InputError, match="max_iterations: expected at least 1"):
        ReferenceOptions(max_iterations=0)
    with pytest.raises(InputError, match="steps: expected at least 1"):
        solve_law(operator, LinearLaw(C, np.zeros(6)), *SCENE, steps=0)


def test_same_answer_on_any_number_of_ranks(comm):
    """The mesh shared by all ranks against the whole of it on each rank; it is compared cell by cell."""
    shared, whole = (
        StrainOperator(box(ranks, elements=(5, 4, 1), size=(5e-5, 4e-5, 1e-5))) for ranks in (comm, MPI.COMM_SELF)
    )
    law = convex_energy(4)
    a, b = solve_law(shared, law, *SCENE), solve_law(whole, law, *SCENE)
    assert a.iterations == b.iterations > 3
    assert [i.negative_pivots for i in a.history] == [i.negative_pivots for i in b.history]
    for side, force in b.reactions.items():
        np.testing.assert_allclose(a.reactions[side], force, atol=1e-9 * np.abs(force).max())
    middle = {tuple(np.rint(x * 1e7)): k for k, x in enumerate(whole.cell_mean(whole.points))}
    same = [middle[tuple(np.rint(x * 1e7))] for x in shared.cell_mean(shared.points)]
    stress = whole.cell_mean(b.mechanical.stress)
    np.testing.assert_allclose(
        shared.cell_mean(a.mechanical.stress), stress[same], rtol=0, atol=1e-9 * np.abs(stress).max()
    )


def test_cg_with_gamg_gives_the_direct_solution(operator):
    options = PETSc.Options()
    given = {"ref_ksp_type": "cg", "ref_pc_type": "gamg", "ref_ksp_rtol": "1e-12"}
    direct = solve_law(operator, convex_energy(4), *SCENE)
    try:
        for name, value in given.items():
            options[name] = value
        iterative = solve_law(operator, convex_energy(4), *SCENE)
    finally:
        for name in given:
            options.delValue(name)
    assert direct.solver.startswith("preonly")
    assert iterative.solver == "cg + gamg"
    np.testing.assert_allclose(iterative.mechanical.u, direct.mechanical.u, atol=1e-8 * 2e-6)
