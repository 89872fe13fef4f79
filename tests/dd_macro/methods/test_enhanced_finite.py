"""Hexahedra that bend, in finite strain: one potential, objectivity, elastica, no hourglassing, data-driven too."""

from __future__ import annotations

import dataclasses
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.optimize
from mpi4py import MPI
from scipy.spatial.transform import Rotation

import dd_macro as dd
from dd_macro.parallel import total
from dd_macro.scene.enhanced import EnhancedFiniteStrain
from dd_macro.scene.kinematics import second_piola
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.mandel import from_mandel, to_mandel

METRIC = dd.isotropic(young=1e3, poisson=0.3)
LINEAR = dd.LinearLaw(METRIC.C, np.zeros(6))


class NeoHooke:
    """W = mu/2 (|U|^2 - 3 - 2 ln J) + lambda/2 (ln J)^2 of the stretch U; Young's modulus 1."""

    def __init__(self, poisson):
        self.mu, self.lame = 0.5 / (1 + poisson), poisson / (1 + poisson) / (1 - 2 * poisson)

    def energy(self, e):
        U = np.eye(3) + from_mandel(e)
        log = np.log(np.linalg.det(U))
        return 0.5 * self.mu * ((U**2).sum(axis=(1, 2)) - 3 - 2 * log) + 0.5 * self.lame * log**2

    def stress(self, e):
        U = np.eye(3) + from_mandel(e)
        inverse = np.linalg.inv(U)
        log = np.log(np.linalg.det(U))[:, None, None]
        return to_mandel(self.mu * (U - inverse) + self.lame * log * inverse)

    def stress_and_tangent(self, e):
        h = 1e-6 * np.eye(6)
        D = np.stack([(self.stress(e + d) - self.stress(e - d)) / 2e-6 for d in h], axis=2)
        return self.stress(e), 0.5 * (D + D.swapaxes(1, 2))


def skewed(comm, elements, size):
    domain = dd.box(comm, elements=elements, size=size)
    x = domain.mesh.geometry.x
    t = x / np.array(size)
    x += 0.06 * np.array(size) * np.sin(np.pi * t) * np.cos(4.0 * t[:, [1, 2, 0]])
    return domain


@pytest.fixture(scope="module")
def operator():
    return dd.EnhancedGradientOperator(skewed(MPI.COMM_WORLD, (4, 3, 2), (4e-5, 3e-5, 2e-5)))


def nodal(operator, u):
    return u[: 3 * operator.owned_nodes].reshape(-1, 3)


def pulled(size, Q=None):
    """Bottom held and top pulled and sheared; then the whole body turned by Q."""
    Q = np.eye(3) if Q is None else Q

    def turn(shift):
        return lambda x: (x + shift) @ Q.T - x

    return [dd.Displacement("bottom", turn(np.zeros(3))), dd.Displacement("top", turn(size * np.array([0.5, 1.0, 0])))]


def test_stress_and_tangent_are_derivatives_of_the_energy(rng):
    law, x, h = NeoHooke(0.3), 0.1 * rng.normal(size=(8, 15)), 1e-6
    found = EnhancedFiniteStrain(x)
    stress, tangent = law.stress_and_tangent(found.strain)
    nominal, A = found.nominal_stress(stress), found.nominal_tangent(stress, tangent)
    np.testing.assert_allclose(A, A.swapaxes(1, 2), atol=1e-9 * np.abs(A).max())
    for j in range(15):
        sides = [EnhancedFiniteStrain(x + sign * h * np.eye(15)[j]) for sign in (1, -1)]
        energy = [law.energy(side.strain) for side in sides]
        np.testing.assert_allclose((energy[0] - energy[1]) / (2 * h), nominal[:, j], atol=1e-7)
        forces = [side.nominal_stress(law.stress(side.strain)) for side in sides]
        np.testing.assert_allclose((forces[0] - forces[1]) / (2 * h), A[:, :, j], atol=1e-6 * np.abs(A).max())


def test_what_is_inside_out_is_seen():
    gradient = np.zeros((3, 15))
    assert not EnhancedFiniteStrain(gradient).inside_out
    for bad in (np.nan, np.inf, -1.1):
        gradient[1, 10] = bad
        assert EnhancedFiniteStrain(gradient).inside_out
        assert np.isfinite(EnhancedFiniteStrain(gradient).strain).all()


def test_condensed_tangent_is_the_second_derivative_of_the_energy(rng):
    """Of the body's energy, by differences, all unknowns of a skewed mesh; its inner ones left out by a Schur block."""
    operator, law = dd.EnhancedGradientOperator(skewed(MPI.COMM_SELF, (2, 1, 1), (2.0, 1.0, 1.0))), NeoHooke(0.3)
    u, n = 0.05 * rng.normal(size=operator.owned_dofs), 3 * operator.owned_nodes

    def energy(u):
        return operator.weights @ law.energy(operator.local(operator.strain(u)).strain)

    def force(u):
        found = operator.local(operator.strain(u))
        return operator.force(found.nominal_stress(law.stress(found.strain)))

    h = 1e-6
    unit = np.eye(len(u))
    slope = [(energy(u + h * d) - energy(u - h * d)) / (2 * h) for d in unit]
    np.testing.assert_allclose(force(u), slope, atol=1e-8)
    K = np.stack([(force(u + h * d) - force(u - h * d)) / (2 * h) for d in unit], axis=1)
    found = operator.local(operator.strain(u))
    matrix = operator.stiffness().assemble(found.nominal_tangent(*law.stress_and_tangent(found.strain)))
    expected = K[:n, :n] - K[:n, n:] @ np.linalg.solve(K[n:, n:], K[n:, :n])
    dense = matrix.convert("dense").getDenseArray()
    np.testing.assert_allclose(dense, expected, atol=1e-7 * np.abs(expected).max())


def uniaxial(law, stretch):
    """The stretch U (3, 3) under a force along y alone."""

    def across(v):
        return law.stress(to_mandel(np.diag([v[0], stretch, v[1]]) - np.eye(3))[None])[0, [0, 2]]

    v = scipy.optimize.fsolve(across, [1.0, 1.0])
    return np.diag([v[0], stretch, v[1]])


def softest(operator, K):
    """Least eigenvalue of the motions of a block between plates that hold it."""
    y = operator.node_coordinates()[:, 1]
    free = np.repeat((y > 1e-9) & (y < 4 - 1e-9), 3)
    return np.linalg.eigvalsh(K[np.ix_(free, free)])[0]


def test_modes_on_the_gradient_would_hourglass():
    """The usual form, F + sum_b a_b g_b^T: at half its height the same block has a motion that gains energy."""
    law = NeoHooke(0.3)
    block = dd.box(MPI.COMM_SELF, elements=(3, 4, 3), size=(3.0, 4.0, 3.0))
    operator, modes = dd.GradientOperator(block), dd.EnhancedGradientOperator(block).modes
    U = uniaxial(law, 0.5)
    found = operator.local(np.tile((U - np.eye(3)).reshape(9), (len(operator.weights), 1)))
    A = found.nominal_tangent(*law.stress_and_tangent(found.strain))
    K = operator.stiffness().assemble(A).convert("dense").getDenseArray().copy()
    w = operator.weights[:8]  # all cells are equal
    nodal, inner = operator.shape_gradients(np.array([0]))[0], modes.gradients[0]
    N, M = (np.einsum("qbj,ik->qijbk", g, np.eye(3)).reshape(8, 9, -1) for g in (nodal, inner))
    K_ua, K_aa = (np.einsum("q,qia,ij,qjb->ab", w, left, A[0], M) for left in (N, M))
    for nodes in operator.displacements.dofmap.list:
        dofs = (3 * nodes[:, None] + np.arange(3)).reshape(-1)
        K[np.ix_(dofs, dofs)] -= K_ua @ np.linalg.solve(K_aa, K_ua.T)
    assert softest(operator, K) < -0.1


@pytest.mark.parametrize("poisson", [0.3, 0.49])
@pytest.mark.parametrize("stretch", [0.5, 0.8, 1.5])
def test_no_hourglassing(poisson, stretch):
    """A square block between plates, far compressed or stretched: no motion is softer than the trilinear element's."""
    law, least = NeoHooke(poisson), {}
    for kind in (dd.GradientOperator, dd.EnhancedGradientOperator):
        operator = kind(dd.box(MPI.COMM_SELF, elements=(3, 4, 3), size=(3.0, 4.0, 3.0)))
        U = uniaxial(law, stretch)
        u = np.zeros(operator.owned_dofs)
        u[: 3 * operator.owned_nodes] = (operator.node_coordinates() @ (U - np.eye(3))).ravel()
        found = operator.local(operator.strain(u))
        K = operator.stiffness().assemble(found.nominal_tangent(*law.stress_and_tangent(found.strain)))
        least[kind] = softest(operator, K.convert("dense").getDenseArray())
    assert least[dd.GradientOperator] > 0
    assert least[dd.EnhancedGradientOperator] > 0.9 * least[dd.GradientOperator]


@pytest.mark.mpi
def test_held_block_is_stable_and_right(comm):
    """Between plates that hold it, at -20 % and 50 %: no negative pivot, and nearer to quadratic elements."""
    law = NeoHooke(0.45)
    for top in (-0.4, 1.0):
        held = [dd.Displacement("bottom"), dd.Displacement("top", (0.0, top, 0.0))]
        force = {}
        domain = dd.box(comm, elements=(3, 3, 3), size=(2.0, 2.0, 2.0))
        operators = dd.EnhancedGradientOperator(domain), dd.GradientOperator(domain)
        for operator in (*operators, dd.GradientOperator(domain, degree=2)):
            result = dd.solve_law(operator, law, held, steps=2)
            force[operator] = result.reactions["top"][1]
            assert result.history[-1].negative_pivots in (0, None)
        enhanced, trilinear, quadratic = force.values()
        assert abs(enhanced - quadratic) < 0.35 * abs(trilinear - quadratic)


@pytest.mark.mpi
def test_elastica(comm):
    """Tip of a slender cantilever under a dead force of 2 EI / L^2: Mattiasson's elliptic integrals."""
    length = 30.0
    operator = dd.EnhancedGradientOperator(dd.box(comm, elements=(16, 1, 1), size=(length, 1.0, 1.0)))
    law = dd.LinearLaw(dd.isotropic(young=12.0, poisson=0.0).C, np.zeros(6))
    pull = [dd.Traction("right", (0.0, 2.0 / length**2, 0.0))]
    result = dd.solve_law(operator, law, [dd.Displacement("left")], pull, steps=4)
    corners = operator.corner_displacement(result.mechanical.u)
    end = corners[np.isclose(operator.cell_corners[..., 0], length)]
    sums = total(comm, np.append(end.sum(axis=0), len(end)))
    np.testing.assert_allclose(sums[:2] / sums[3] / length, [-0.16064, 0.49346], rtol=0.01)


@pytest.fixture(scope="module")
def data():
    strain = np.random.default_rng(3).uniform(-0.08, 0.08, (400, 6))
    stress, tangent = (1e3 * a for a in NeoHooke(0.3).stress_and_tangent(strain))
    n = np.arange(len(strain))
    return Dataset(strain, stress, "first_piola", path=0 * n, step=n, tangent=tangent)


@pytest.fixture(scope="module")
def datum():
    """The linear law."""
    place = np.zeros(1, dtype=int)
    return Dataset(np.zeros((1, 6)), np.zeros((1, 6)), "first_piola", path=place, step=place, tangent=METRIC.C[None])


@pytest.mark.mpi
@pytest.mark.parametrize("angle", [0.0, 30.0, 150.0])
def test_patch_whatever_the_rotation(operator, data, angle):
    """A datum everywhere, and its affine motion on all sides: no distance, and the datum is found."""
    Q = Rotation.from_rotvec(np.deg2rad(angle) * np.array([0.6, 0.0, 0.8])).as_matrix()
    datum = 17
    U = np.eye(3) + from_mandel(data.strain[datum])
    affine = [dd.Displacement(side, lambda x: x @ (Q @ U - np.eye(3)).T) for side in dd.SIDES]
    result = dd.solve(dd.FiniteProjection(operator, METRIC, affine), dd.MaterialSearch(data, METRIC))
    assert (result.index == datum).all()
    assert result.normalised_distance < 1e-7
    z = result.mechanical
    np.testing.assert_allclose(z.F, np.broadcast_to(Q @ U, z.F.shape), atol=1e-8)
    P = Q @ U @ second_piola(U[None], data.stress[[datum]])[0]
    np.testing.assert_allclose(z.first_piola, np.broadcast_to(P, z.F.shape), atol=1e-6 * np.abs(P).max())


@pytest.mark.mpi
def test_second_order_is_objective(operator, datum):
    """The body turned as a whole carries the same stretches and stresses, its displacement turned."""
    x = operator.node_coordinates()
    here = dd.solve_second_order(dd.FiniteProjection(operator, METRIC, pulled(2e-6)), dd.TangentSearch(datum, METRIC))
    Q = Rotation.from_rotvec([0.5, -0.3, 0.7]).as_matrix()
    scene, z = dd.FiniteProjection(operator, METRIC, pulled(2e-6, Q)), here.mechanical
    u = z.u.copy()
    nodal(operator, u)[:] = (x + nodal(operator, u)) @ Q.T - x
    start = dataclasses.replace(scene.elastic(), u=u, strain=z.strain, stress=z.stress)
    there = dd.solve_second_order(scene, dd.TangentSearch(datum, METRIC), start=start)
    np.testing.assert_allclose(there.mechanical.u, u, atol=1e-8 * 2e-6)
    np.testing.assert_allclose(there.mechanical.stress, z.stress, atol=1e-6 * METRIC.C[0, 0] * 0.05)


@pytest.mark.mpi
def test_second_order_is_newton_on_a_law_that_is_linear(operator, datum):
    """One datum with its tangent is the law itself: two routes to one solution, loads and free sides included."""
    conditions, pull = pulled(4e-6), [dd.Traction("right", (30.0, 0.0, 5.0))]
    scene = dd.FiniteProjection(operator, METRIC, conditions, pull)
    a = dd.solve_second_order(scene, dd.TangentSearch(datum, METRIC))
    b = dd.solve_law(operator, LINEAR, conditions, pull)
    np.testing.assert_allclose(a.mechanical.u, b.mechanical.u, atol=1e-9 * 4e-6)
    np.testing.assert_allclose(scene.reaction(a.mechanical, "top"), b.reactions["top"], rtol=1e-7, atol=1e-18)
    assert scene.residual(a.mechanical.nominal_stress) < 1e-9
    assert a.normalised_distance < 1e-9
    in_balance = scene.reaction(a.mechanical, "top") + scene.reaction(a.mechanical, "bottom")
    np.testing.assert_allclose(in_balance, -6e-10 * np.array([30.0, 0, 5.0]), rtol=1e-8, atol=1e-16)


@pytest.mark.mpi
def test_small_strain_is_the_limit(operator):
    """The two kinematics differ by the square of the load."""
    small = dd.EnhancedStrainOperator(operator.domain)
    sizes, gaps = [4e-7, 2e-7, 1e-7], []
    for size in sizes:
        a, b = (nodal(operator, dd.solve_law(op, LINEAR, pulled(size)).mechanical.u) for op in (operator, small))
        gaps.append(np.sqrt(total(operator.comm, ((a - b) ** 2).sum())))
    np.testing.assert_allclose(np.diff(np.log(gaps)) / np.diff(np.log(sizes)), 2.0, atol=0.1)


@pytest.mark.mpi
def test_points_near_the_law(operator):
    """Points as data, ever denser: the error against Newton's method on their law falls; what is shown is its state."""
    law = NeoHooke(0.3)
    metric = dd.isotropic(young=1.0, poisson=0.3)
    exact = dd.in_space(dd.solve_law(operator, law, pulled(2e-6))).mechanical
    errors = []
    for n in (300, 30000):
        strain = np.random.default_rng(n).normal(size=(n, 6)) * np.array([0.02, 0.06, 0.02, 0.02, 0.02, 0.03])
        strain[:, 1] += 0.05
        k = np.arange(n)
        points = Dataset(strain, law.stress(strain), "first_piola", path=0 * k, step=k)
        scene = dd.FiniteProjection(operator, metric, pulled(2e-6))
        result = dd.solve(scene, dd.MaterialSearch(points, metric))
        assert scene.residual(result.mechanical.nominal_stress) < 1e-9
        off = ((dd.in_space(result).mechanical.stress - exact.stress) ** 2).sum(axis=1)
        sums = total(operator.comm, [operator.weights @ off, operator.weights @ (exact.stress**2).sum(axis=1)])
        errors.append(np.sqrt(sums[0] / sums[1]))
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.15


RANKS = """
import dd_macro as dd
import numpy as np
from mpi4py import MPI
from tsg_micro.data.dataset import Dataset

comm = MPI.COMM_WORLD
law = dd.isotropic(young=1e3, poisson=0.3)
metric = dd.Metric(1.5 * law.C, "stiffer than the law")
strain = np.zeros((2000, 6))
strain[:, [0, 1, 5]] = np.random.default_rng(0).uniform([-0.03, -0.02, -0.03], [0.03, 0.08, 0.03], (2000, 3))
n = np.arange(2000)
stress = strain @ law.C
data = Dataset(strain, stress, "first_piola", path=0 * n, step=n)
for kind in (dd.EnhancedStrainOperator, dd.EnhancedGradientOperator):
    operator = kind(dd.box(comm, elements=(5, 4, 1), size=(5e-5, 4e-5, 1e-5)))
    held = [dd.Displacement("bottom"), dd.Displacement("top", (1e-6, 2e-6, 0.0))]
    pull = [dd.Traction("right", (5.0, 0.0, 0.0))]
    scene = dd.make_projection(operator, metric, held, pull)
    result = dd.solve(scene, dd.MaterialSearch(data, metric))
    exact = dd.solve_law(operator, dd.LinearLaw(law.C, np.zeros(6)), held, pull)
    a, b = scene.reaction(result.mechanical, "top"), exact.reactions["top"]
    if comm.rank == 0:
        print(result.iterations, result.normalised_distance, *a, *b)
"""


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts mpirun itself")
def test_same_answer_on_1_and_2_ranks(mpirun):
    root = str(Path(__file__).parents[3])
    environment = {"PYTHONPATH": os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])}
    numbers = []
    for ranks in (1, 2):
        done = mpirun(ranks, sys.executable, "-c", RANKS, env=environment)
        assert done.returncode == 0, done.stderr
        numbers.append(np.array(done.stdout.split(), dtype=float).reshape(2, 8))
    assert (numbers[0][:, 0] > 3).all()
    for a, b in zip(*numbers, strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-8, atol=1e-8 * np.abs(a[2:]).max())
