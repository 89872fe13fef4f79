"""Hexahedra that bend, in small strain: closed forms, the patch test, rates, and two routes to one number."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from dd_macro.methods.projection import relative_distance
from dd_macro.parallel import total
from tsg_micro.data.errors import ConvergenceError
from tsg_micro.data.mandel import to_mandel

pytestmark = pytest.mark.mpi
SIDES = ("left", "right", "bottom", "top", "back", "front")


def distorted(comm, elements, size, by=0.08):
    """A box whose nodes are moved along all axes; its sides stay flat."""
    domain = dd.box(comm, elements=elements, size=size)
    x = domain.mesh.geometry.x
    t = x / np.array(size)
    for k in range(3):
        others = np.cos(4.0 * t[:, (k + 1) % 3] + k) + np.sin(5.0 * t[:, (k + 2) % 3])
        x[:, k] += by * size[k] * np.sin(np.pi * t[:, k]) * others
    return domain


def everywhere(u):
    return [dd.Displacement(side, u) for side in SIDES]


@pytest.mark.parametrize("size", [(2.0, 1.0, 1.5), (1.0, 1e4, 1e-3)], ids=["ordinary", "flat"])
def test_patch(comm, rng, size):
    """An affine displacement is met exactly, its inner unknowns are zero, and its stress is in equilibrium."""
    operator = dd.EnhancedStrainOperator(distorted(comm, (4, 3, 3), size))
    H = rng.normal(size=(3, 3)) / np.array(size)[:, None] * min(size)
    metric = dd.isotropic(young=3.0, poisson=0.4)
    z = dd.Projection(operator, metric, everywhere(lambda x: x @ H.T)).elastic()
    strain = to_mandel(H)
    np.testing.assert_allclose(z.strain, np.broadcast_to(strain, z.strain.shape), atol=1e-8 * np.abs(strain).max())
    inner = z.u[3 * operator.owned_nodes :]
    assert np.abs(inner).max(initial=0.0) <= 1e-9 * np.abs(z.u).max(initial=1.0)


def test_patch_under_traction(comm):
    """A distorted block that is pulled at one side has the same stress everywhere."""
    operator = dd.EnhancedStrainOperator(distorted(comm, (3, 3, 2), (3.0, 2.0, 1.0)))
    held = [dd.Displacement("left", (0.0,), (0,)), dd.Displacement("bottom", (0.0,), (1,))]
    scene = dd.Projection(
        operator,
        dd.isotropic(young=10.0, poisson=0.3),
        [*held, dd.Displacement("back", (0.0,), (2,))],
        [dd.Traction("right", (2.0, 0.0, 0.0))],
    )
    z = scene.elastic()
    np.testing.assert_allclose(z.stress, np.broadcast_to([2.0, 0, 0, 0, 0, 0], z.stress.shape), atol=1e-10)
    np.testing.assert_allclose(scene.reaction(z, "left"), [-4.0, 0.0, 0.0], atol=1e-10)


def matrix_of(operator, C):
    """K (unknowns square) of all unknowns, column by column from strain and force; one rank."""
    unit = np.eye(operator.owned_dofs)
    return np.column_stack([operator.force(operator.strain(e) @ C) for e in unit])


def test_force_is_the_adjoint_of_strain(comm):
    operator = dd.EnhancedStrainOperator(distorted(comm, (3, 2, 2), (3.0, 2.0, 1.0)))
    rng = np.random.default_rng(comm.rank)
    u, s = rng.normal(size=operator.owned_dofs), rng.normal(size=(len(operator.weights), 6))
    work = total(comm, [operator.force(s) @ u, operator.weights @ (operator.strain(u) * s).sum(axis=1)])
    assert work[0] == pytest.approx(work[1], rel=1e-11)


@pytest.mark.parametrize("make", [distorted, lambda comm, n, size: dd.box(comm, elements=n, size=size)])
def test_condensed_matrix_is_the_schur_complement(make, rng):
    """Of the matrix of all unknowns, made column by column; so are right side and inner unknowns."""
    operator = dd.EnhancedStrainOperator(make(MPI.COMM_SELF, (3, 1, 2), (3.0, 1.0, 1.5)))
    C = dd.isotropic(young=3.0, poisson=0.2).C
    K, n = matrix_of(operator, C), 3 * operator.owned_nodes
    stiffness = operator.stiffness(C)
    condensed = K[:n, :n] - K[:n, n:] @ np.linalg.solve(K[n:, n:], K[n:, :n])
    dense = stiffness.matrix.convert("dense").getDenseArray()
    np.testing.assert_allclose(dense, condensed, atol=1e-12 * np.abs(condensed).max())
    f, u = rng.normal(size=operator.owned_dofs), rng.normal(size=n)
    inner = np.linalg.solve(K[n:, n:], f[n:] - K[n:, :n] @ u)
    np.testing.assert_allclose(stiffness.expand(u, f), np.concatenate([u, inner]), atol=1e-11)
    np.testing.assert_allclose(stiffness.condense(f), f[:n] - K[:n, n:] @ np.linalg.solve(K[n:, n:], f[n:]), atol=1e-11)
    everywhere_its_own = operator.stiffness().assemble(np.broadcast_to(C, (len(operator.weights), 6, 6)))
    np.testing.assert_allclose(
        everywhere_its_own.convert("dense").getDenseArray(), dense, atol=1e-13 * np.abs(dense).max()
    )


@pytest.mark.parametrize("enhanced", [True, False])
def test_matrix_of_shared_moduli_is_that_of_a_modulus_at_every_point(comm, rng, enhanced):
    operator = (dd.EnhancedStrainOperator if enhanced else dd.StrainOperator)(
        dd.box(comm, elements=(4, 3, 2), size=(4.0, 3.0, 1.0))
    )
    C = np.array([dd.isotropic(young=young, poisson=0.2).C for young in (1.0, 2.0, 5.0)])
    own = (operator.points[:, 0] + operator.points[:, 1]).astype(np.int64) % 3  # cells of one modulus, and of two
    shared, each = operator.stiffness(), operator.stiffness()
    shared.assemble(C, own)
    each.assemble(C[own])
    off = shared.matrix.copy()
    off.axpy(-1.0, each.matrix)
    assert off.norm() <= 1e-13 * each.matrix.norm()
    force = np.sin(np.arange(operator.owned_dofs))
    np.testing.assert_allclose(shared.condense(force), each.condense(force), rtol=0, atol=1e-12)


@pytest.mark.parametrize("rank_of_one", [True, False])
def test_negative_and_lost_stiffness_of_the_modes(comm, rng, rank_of_one):
    """Negative eigenvalues are those of all unknowns; where a modulus has none there is an error on all ranks."""
    operator = dd.EnhancedStrainOperator(distorted(comm, (2, 2, 2), (1.0, 1.0, 1.0)))
    C = np.diag([1.0, 1.0, -0.1, 1.0, 1.0, 1.0])
    stiffness = operator.stiffness(C)
    assert 8 <= stiffness.negative <= 8 * 5
    if comm.size == 1:
        n = 3 * operator.owned_nodes
        all_of_it = np.linalg.eigvalsh(matrix_of(operator, C))
        condensed = np.linalg.eigvalsh(stiffness.matrix.convert("dense").getDenseArray()[:n, :n])
        count = [(values < -1e-9).sum() for values in (all_of_it, condensed)]
        assert count[0] == count[1] + stiffness.negative
    moduli = np.tile(np.eye(6), (len(operator.weights), 1, 1))
    if comm.rank == 0 or not rank_of_one:
        moduli[:8, 2] = moduli[:8, :, 2] = 0.0
        moduli[:8, 3:] = moduli[:8, :, 3:] = 0.0
    with pytest.raises(ConvergenceError, match="expected modes with some stiffness, got none in"):
        operator.stiffness().assemble(moduli)


@pytest.mark.parametrize("size", [(1.0, 1.0, 1.0), (1.0, 10.0, 1e-1)])
@pytest.mark.parametrize("by", [0.0, 0.15])
def test_one_element_has_six_motions_without_energy(rng, size, by):
    domain = dd.box(MPI.COMM_SELF, elements=(1, 1, 1), size=size)
    domain.mesh.geometry.x[:] += by * np.array(size) * rng.uniform(-1, 1, (8, 3))
    operator = dd.EnhancedStrainOperator(domain)
    K = operator.stiffness(dd.isotropic(young=1.0, poisson=0.3).C).matrix.convert("dense").getDenseArray()
    np.testing.assert_allclose(K, K.T, atol=1e-13 * np.abs(K).max())
    scale = np.sqrt(np.diag(K))
    values = np.linalg.eigvalsh(K / np.outer(scale, scale))
    assert np.abs(values[:6]).max() < 1e-14
    assert values[6] > 1e-7  # bending over the square of the aspect ratio, 100


def test_energy_of_pure_bending():
    """One cube bent by unit curvature has the energy of a plate (its width held) or of a beam (free): closed forms."""
    operator = dd.EnhancedStrainOperator(dd.box(MPI.COMM_SELF, elements=(1, 1, 1), size=(2.0, 2.0, 2.0)))
    young, poisson = 5.0, 0.3
    K = operator.stiffness(dd.isotropic(young=young, poisson=poisson).C).matrix
    x, y, z = (operator.node_coordinates() - 1.0).T
    for width, modulus in ((0.0, young / (1 - poisson**2)), (poisson, young)):
        u = K.createVecRight()
        u.array[:] = np.column_stack([x * y, 0 * x, -width * z * y]).ravel()
        assert (K * u).dot(u) == pytest.approx(modulus * 8 / 3, rel=1e-12)


def cantilever(operator_class, comm, length, elements, *, slope=0.0):
    """Tip displacement of a beam of unit square section without lateral contraction under unit tip force."""
    domain = dd.box(comm, elements=elements, size=(length, 1.0, 1.0))
    x = domain.mesh.geometry.x
    x[:, 0] += slope * (x[:, 1] - 0.5) * np.sin(np.pi * x[:, 0] / length) ** 2
    operator = operator_class(domain)
    scene = dd.Projection(
        operator,
        dd.isotropic(young=1.0, poisson=0.0),
        [dd.Displacement("left")],
        [dd.Traction("right", (0.0, 1.0, 0.0))],
    )
    corners = operator.corner_displacement(scene.elastic().u)
    at_end = np.isclose(operator.cell_corners[..., 0], length)
    sums = total(comm, [corners[at_end][:, 1].sum(), at_end.sum()])
    return sums[0] / sums[1]


@pytest.mark.parametrize("length", [10.0, 100.0, 1000.0])
def test_cantilever_of_one_row_of_elements(comm, length):
    """Ten elements are Timoshenko's beam but for 1/400, their straight bending line; trilinear ones are far off."""
    exact = 4.0 * length**3 + length * 2.0 * 1.0  # F L^3 / 3 EI + F L / GA, G = E / 2
    elements = (10, 1, 1)
    assert cantilever(dd.EnhancedStrainOperator, comm, length, elements) == pytest.approx(exact, rel=0.004)
    assert cantilever(dd.StrainOperator, comm, length, elements) < 0.7 * exact
    assert cantilever(dd.EnhancedStrainOperator, comm, length, (40, 1, 1)) == pytest.approx(exact, rel=4e-4)


def test_cantilever_of_skewed_elements(comm):
    exact = 4.0 * 10.0**3 + 20.0
    skewed = cantilever(dd.EnhancedStrainOperator, comm, 10.0, (20, 1, 1), slope=0.25)
    assert skewed == pytest.approx(exact, rel=0.05)
    assert abs(cantilever(dd.StrainOperator, comm, 10.0, (20, 1, 1), slope=0.25) / exact - 1) > 0.1


def test_rates_of_a_manufactured_solution(comm):
    """u = grad phi with phi harmonic is in equilibrium; on distorted meshes u is met like h^2, the strain like h."""

    def u(x):
        a, s, c = np.exp(1.3 * x[:, 0]), 0.5, 1.2  # 1.3^2 = 0.5^2 + 1.2^2
        y, z = s * x[:, 1], c * x[:, 2]
        return np.column_stack(
            [1.3 * a * np.cos(y) * np.cos(z), -s * a * np.sin(y) * np.cos(z), -c * a * np.cos(y) * np.sin(z)]
        )

    def strain(x, d=1e-5):
        H = np.stack([(u(x + d * e) - u(x - d * e)) / (2 * d) for e in np.eye(3)], axis=2)
        return to_mandel(H)

    sizes, errors = np.array([8, 12, 16]), []
    for n in sizes:
        operator = dd.EnhancedStrainOperator(distorted(comm, (n, n, n), (1.0, 1.0, 1.0), 0.03))
        z = dd.Projection(operator, dd.isotropic(young=1.0, poisson=0.3), everywhere(u)).elastic()
        centre = operator.cell_corners.mean(axis=1)
        off_u = ((operator.corner_displacement(z.u).mean(axis=1) - u(centre)) ** 2).sum()
        off_e = operator.weights @ ((z.strain - strain(operator.points)) ** 2).sum(axis=1)
        sums = total(comm, [off_u / n**3, off_e])
        errors.append(np.sqrt(sums))
    rates = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert rates[0] > 1.9
    assert rates[1] > 0.95


def sheared(operator):
    return [dd.Displacement("bottom"), dd.Displacement("top", (0.1, 0.05, 0.0))]


def anisotropic(rng):
    A = rng.normal(size=(6, 6))
    return A @ A.T + np.eye(6)


def linear_data(make_dataset, C):
    strain = np.vstack([np.zeros((1, 6)), 0.1 * np.eye(6), -0.1 * np.eye(6)])
    return make_dataset(strain, strain @ C, tangent=np.broadcast_to(C, (13, 6, 6)))


def test_projection_is_the_closest_point(comm, rng):
    """It leaves what is compatible and in equilibrium alone, and the way to it is at right angles to all of that."""
    operator = dd.EnhancedStrainOperator(distorted(comm, (3, 3, 2), (1.0, 1.0, 1.0)))
    metric = dd.isotropic(young=2.0, poisson=0.3)
    law = dd.LinearLaw(anisotropic(rng), np.zeros(6))
    pull = [dd.Traction("right", (0.3, 0.1, 0.0))]
    scene = dd.Projection(operator, metric, sheared(operator), pull)
    z = dd.solve_law(operator, law, sheared(operator), pull).mechanical
    same = scene.project(z.strain, z.stress)
    assert relative_distance(operator, metric, same, z) < 1e-9
    random = np.random.default_rng(comm.rank)
    y = random.normal(size=(2, len(operator.weights), 6))
    near = scene.project(*y)
    across = metric.whiten(y[0] - near.strain, y[1] - near.stress)
    along = metric.whiten(z.strain - near.strain, z.stress - near.stress)
    sums = total(comm, [operator.weights @ (a * b).sum(axis=1) for a, b in ((across, along), (along, along))])
    assert abs(sums[0]) < 1e-9 * sums[1]


@pytest.mark.parametrize("method", ["local-tangent", "alternating"])
def test_data_of_a_linear_law_give_its_solution(comm, rng, make_dataset, method):
    operator = dd.EnhancedStrainOperator(distorted(comm, (4, 3, 2), (1.0, 1.0, 0.5)))
    C = anisotropic(rng)
    metric = dd.Metric(0.5 * C + np.eye(6), "softer")
    scene = dd.Projection(operator, metric, sheared(operator))
    found = dd.solve_second_order(scene, dd.TangentSearch(linear_data(make_dataset, C), metric), method=method)
    law = dd.solve_law(operator, dd.LinearLaw(C, np.zeros(6)), sheared(operator))
    elastic = dd.Projection(operator, dd.Metric(C, "the law"), sheared(operator)).elastic()
    assert relative_distance(operator, metric, law.mechanical, elastic) < 1e-9
    assert relative_distance(operator, metric, found.mechanical, elastic) < 1e-5
    np.testing.assert_allclose(
        scene.reaction(found.mechanical, "top"), law.reactions["top"], rtol=1e-5, atol=1e-6 * np.abs(C).max()
    )
    assert scene.residual(found.mechanical.stress) < 1e-8
