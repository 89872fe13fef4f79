"""Projection and linear elasticity: orthogonality, equilibrium, manufactured solutions, the two linear solvers."""

from __future__ import annotations

import numpy as np
import pytest
from petsc4py import PETSc

from dd_macro import Displacement, Projection, StrainOperator, Traction, box, isotropic
from dd_macro.parallel import total
from tsg_micro.data.errors import ConvergenceError

pytestmark = pytest.mark.mpi

METRIC = isotropic(young=1e3, poisson=0.3)


@pytest.fixture
def scene(comm):
    operator = StrainOperator(box(comm, elements=(4, 3, 2), size=(4e-5, 3e-5, 2e-5)))
    return Projection(
        operator,
        METRIC,
        [Displacement("bottom"), Displacement("top", (1e-6, 2e-6, 0.0))],
        [Traction("right", (0.0, 30.0, 10.0))],
    )


def inner(scene, a, b):
    """Global scalar product of two points of phase space, each (strain, stress)."""
    w = scene.operator.weights
    return float(total(scene.operator.comm, w @ (METRIC.whiten(*a) * METRIC.whiten(*b)).sum(axis=1)))


def random_state(scene, seed):
    points = scene.operator.domain.mesh.topology.original_cell_index[: scene.operator.domain.owned_cells]
    n = scene.operator.domain.global_cells
    values = np.random.default_rng(seed).normal(size=(n, scene.operator.points_per_cell, 12))[points].reshape(-1, 12)
    return 0.05 * values[:, :6], 50.0 * values[:, 6:]


def test_projection_is_in_equilibrium_and_compatible(scene):
    z = scene.project(*random_state(scene, 0))
    assert scene.residual(z.stress) < 1e-12
    np.testing.assert_allclose(z.strain, scene.operator.strain(z.u), atol=1e-14)
    np.testing.assert_array_equal(z.u[scene.problem.fixed], scene.problem.prescribed[scene.problem.fixed])
    assert not scene.residual(np.full_like(z.stress, np.nan)) < 1e-12  # no numbers are not in equilibrium


def test_projection_is_orthogonal_and_idempotent(scene):
    """y - z is orthogonal to every difference of admissible states, so Pythagoras holds and z projects onto itself."""
    y = random_state(scene, 1)
    z = scene.project(*y)
    other = scene.project(*random_state(scene, 2))
    away = (y[0] - z.strain, y[1] - z.stress)
    along = (other.strain - z.strain, other.stress - z.stress)
    direct = (y[0] - other.strain, y[1] - other.stress)
    assert abs(inner(scene, away, along)) < 1e-11 * inner(scene, along, along)
    assert inner(scene, direct, direct) == pytest.approx(
        inner(scene, away, away) + inner(scene, along, along), rel=1e-11
    )
    again = scene.project(z.strain, z.stress)
    np.testing.assert_allclose(again.stress, z.stress, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(again.u, z.u, rtol=1e-9, atol=1e-18)


def test_elastic_state_projects_onto_itself(scene):
    z = scene.elastic()
    assert scene.residual(z.stress) < 1e-12
    again = scene.project(z.strain, z.strain @ METRIC.C)
    np.testing.assert_allclose(again.u, z.u, atol=1e-16)
    np.testing.assert_allclose(again.stress, z.stress, atol=1e-9)


def test_reactions_balance_the_traction(scene):
    z = scene.elastic()
    pull = np.array([0.0, 30.0, 10.0]) * 3e-5 * 2e-5
    reactions = scene.reaction(z, "bottom") + scene.reaction(z, "top")
    np.testing.assert_allclose(
        reactions, -pull, atol=1e-11 * np.linalg.norm(pull) + 1e-12 * np.abs(scene.reaction(z, "top")).max()
    )


def test_reaction_of_uniaxial_stress(comm):
    operator = StrainOperator(box(comm, elements=(3, 2, 2), size=(3e-5, 2e-5, 1e-5)))
    free = [
        Displacement("left", (0.0,), (0,)),
        Displacement("bottom", (0.0,), (1,)),
        Displacement("back", (0.0,), (2,)),
    ]
    pulled = Projection(operator, METRIC, [*free, Displacement("right", (3e-6,), (0,))])
    z = pulled.elastic()
    np.testing.assert_allclose(z.stress, np.broadcast_to([100.0, 0, 0, 0, 0, 0], z.stress.shape), atol=1e-9)
    np.testing.assert_allclose(pulled.reaction(z, "right"), [100 * 2e-10, 0, 0], atol=1e-19)
    loaded = Projection(operator, METRIC, free, [Traction("right", (100.0, 0, 0))])
    np.testing.assert_allclose(loaded.elastic().u, z.u, atol=1e-16)


@pytest.mark.parametrize(("degree", "rate"), [(1, 2), (2, 3)])
def test_manufactured_elasticity(comm, degree, rate):
    """u = grad phi, phi harmonic, satisfies Navier's equation without body force; the L2 error is O(h^(degree + 1))."""
    import dolfinx
    import ufl

    def exact(x):
        a, b, c = x[:, 0], x[:, 1], np.sqrt(2) * x[:, 2]
        e = np.exp(c)
        along_z = np.sqrt(2) * np.sin(a) * np.sin(b) * e
        return np.column_stack([np.cos(a) * np.sin(b) * e, np.sin(a) * np.cos(b) * e, along_z])

    errors = []
    sizes = (2, 4) if degree == 2 else (3, 6)
    for n in sizes:
        operator = StrainOperator(box(comm, elements=(n, n, n), size=(1.0, 1.0, 1.0)), degree=degree)
        sides = operator.domain.names
        z = Projection(operator, METRIC, [Displacement(side, exact) for side in sides]).elastic()
        u = dolfinx.fem.Function(operator.displacements)
        u.x.array[: operator.owned_dofs] = z.u
        u.x.scatter_forward()
        x = ufl.SpatialCoordinate(operator.domain.mesh)
        r = np.sqrt(2.0)
        phi = ufl.sin(x[0]) * ufl.sin(x[1]) * ufl.exp(r * x[2])
        e = u - ufl.grad(phi)
        square = dolfinx.fem.assemble_scalar(dolfinx.fem.form(ufl.inner(e, e) * ufl.dx(degree=6)))
        errors.append(np.sqrt(comm.allreduce(square)))
    found = np.log(errors[0] / errors[1]) / np.log(sizes[1] / sizes[0])
    assert rate - 0.25 < found < rate + 0.6


@pytest.fixture
def petsc_options():
    options = PETSc.Options()
    added = []

    def add(**given):
        for name, value in given.items():
            options[f"dd_{name}"] = value
            added.append(f"dd_{name}")

    yield add
    for name in added:
        options.delValue(name)


def test_cg_with_gamg_gives_the_direct_solution(scene, petsc_options):
    petsc_options(ksp_type="cg", pc_type="gamg", ksp_rtol=1e-12, ksp_max_it=200)
    iterative = Projection(
        scene.operator,
        METRIC,
        [Displacement("bottom"), Displacement("top", (1e-6, 2e-6, 0.0))],
        [Traction("right", (0.0, 30.0, 10.0))],
    )
    assert iterative.solver == "cg + gamg"
    assert scene.solver.startswith("preonly")
    y = random_state(scene, 3)
    a, b = scene.project(*y), iterative.project(*y)
    np.testing.assert_allclose(a.u, b.u, atol=1e-8 * 2e-6)
    np.testing.assert_allclose(a.stress, b.stress, atol=1e-5)


def test_linear_solver_that_does_not_converge_is_an_error(scene, petsc_options):
    petsc_options(ksp_type="cg", pc_type="jacobi", ksp_rtol=1e-12, ksp_max_it=2)
    stuck = Projection(scene.operator, METRIC, [Displacement("bottom"), Displacement("top", (1e-6, 2e-6, 0.0))])
    with pytest.raises(ConvergenceError, match="linear solver cg \\+ jacobi: stopped after 2 iterations"):
        stuck.elastic()
