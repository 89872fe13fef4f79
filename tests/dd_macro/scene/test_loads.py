"""Loads against closed forms: tractions, pressure that follows, body forces, and bodies that are free in space."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from petsc4py import PETSc

import dd_macro as dd
from dd_macro.parallel import total
from tsg_micro.data.errors import InputError

pytestmark = pytest.mark.mpi
SIZE = np.array([4e-5, 3e-5, 2e-5])


def bent(comm, elements=(4, 3, 2)):
    """A box whose inner nodes and sides are curved."""
    domain = dd.box(comm, elements=elements, size=tuple(SIZE))
    x = domain.mesh.geometry.x
    x[:, 1] += 0.1 * x[:, 0] ** 2 / SIZE[0]
    x[:, 2] *= 1.0 + 0.2 * x[:, 0] / SIZE[0]
    return domain


def resultant(operator, forces):
    each = forces[: 3 * operator.owned_nodes].reshape(-1, 3)
    return total(operator.comm, each.sum(axis=0)), total(
        operator.comm, np.cross(operator.node_coordinates(), each).sum(axis=0)
    )


@pytest.mark.parametrize("degree", [1, 2])
def test_resultant_and_moment_of_a_linear_traction(comm, degree):
    operator = dd.StrainOperator(dd.box(comm, elements=(3, 2, 2), size=tuple(SIZE)), degree=degree)
    load = dd.Traction("top", lambda x: np.column_stack([x[:, 0] / SIZE[0], 0 * x[:, 0], 2 + 0 * x[:, 0]]))
    force, moment = resultant(operator, load.nodal_forces(operator))
    area, (lx, ly, lz) = SIZE[0] * SIZE[2], SIZE
    np.testing.assert_allclose(force, [area / 2, 0, 2 * area], rtol=1e-12, atol=1e-25)
    # int x x t: (y tz, z tx - x tz, -y tx)
    np.testing.assert_allclose(moment, [2 * ly * area, area * (lz / 4 - lx), -ly * area / 2], rtol=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_weight(comm, degree):
    operator = dd.StrainOperator(bent(comm), degree=degree)
    volume = float(total(comm, operator.weights.sum()))
    force, _ = resultant(operator, dd.BodyForce((0.0, -3.0, 1.0)).nodal_forces(operator))
    np.testing.assert_allclose(force, np.array([0, -3, 1]) * volume, rtol=1e-12, atol=1e-30)


def pressures(domain):
    return [dd.Pressure(side, 7.0) for side in dd.SIDES]


@pytest.mark.parametrize("degree", [1, 2])
def test_a_closed_surface_under_pressure_is_in_balance_and_follows_the_volume(comm, degree):
    """sum f . x = -3 p V, no resultant, no moment: at rest and in any state of the body."""
    operator = dd.GradientOperator(bent(comm), degree=degree)
    x = operator.node_coordinates()
    u = 0.1 * np.column_stack([x[:, 1], -x[:, 0] + x[:, 2], 0.5 * x[:, 1]]).reshape(-1)
    F = np.eye(3) + 0.1 * np.array([[0, 1, 0], [-1, 0, 1], [0, 0.5, 0]])
    volume = float(total(comm, operator.weights.sum())) * np.linalg.det(F)
    force = sum(load.forces_at(operator, u) for load in pressures(operator.domain)).reshape(-1, 3)
    now = x + u.reshape(-1, 3)
    size = np.abs(force).max()
    np.testing.assert_allclose(total(comm, force.sum(axis=0)) / size, 0, atol=1e-12)
    np.testing.assert_allclose(total(comm, np.cross(now, force).sum(axis=0)) / (size * SIZE[0]), 0, atol=1e-12)
    assert total(comm, (now * force).sum()) == pytest.approx(-3 * 7.0 * volume, rel=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_the_tangent_of_a_pressure_is_the_derivative_of_its_forces(comm, degree):
    operator = dd.GradientOperator(bent(comm, (2, 2, 1)), degree=degree)
    n = 3 * operator.owned_nodes
    x = operator.node_coordinates()

    def field(k):
        return 1e-6 * np.sin(k + x @ np.array([[1, 2, 0.5], [0.3, 1, 2], [2, 0.1, 1]]) / SIZE.min()).reshape(-1)

    u, along = field(0.0), field(1.0)
    matrix = operator.stiffness(np.eye(6)).matrix
    matrix.zeroEntries()
    for load in pressures(operator.domain):
        load.add_stiffness(operator, u, matrix, 1.0)
    matrix.assemble()
    step, product = matrix.createVecs()
    step.array[:] = along
    matrix.mult(step, product)
    h = 1e-4
    ends = [sum(p.forces_at(operator, u + sign * h * along) for p in pressures(None)) for sign in (1, -1)]
    difference = -(ends[0] - ends[1]) / (2 * h)
    assert difference.shape == (n,)
    np.testing.assert_allclose(product.array, difference, rtol=0, atol=1e-7 * np.abs(difference).max())


@pytest.mark.parametrize("enhanced", [False, True])
def test_a_free_body_under_pressure(comm, enhanced):
    """Homogeneous: sigma = -p 1, and the mean of u and of its rotation is zero."""
    domain = bent(comm)
    operator = dd.THEORIES["small"].operator(domain, enhanced=enhanced)
    problem = dd.Problem(operator, [], pressures(domain), free=True)
    assert problem.motions.shape[0] == 6
    found = dd.Projection.of(problem, dd.isotropic(young=1e3, poisson=0.3)).elastic()
    np.testing.assert_allclose(found.stress, np.broadcast_to([-7.0] * 3 + [0.0] * 3, found.stress.shape), atol=1e-7)
    assert problem.residual(found.stress) < 1e-9
    nodal = found.u[: 3 * operator.owned_nodes]
    np.testing.assert_allclose(total(comm, problem.motions @ nodal), 0, atol=1e-12 * np.abs(found.u).max())


def test_a_free_body_follows_its_pressure_in_finite_strain(comm):
    """An isotropic stretch a with P = -p a^2 1, whatever the mesh, in few steps of Newton's method."""
    C, p = 1e3 * (np.eye(6) + 0.4 * np.outer([1, 1, 1, 0, 0, 0], [1, 1, 1, 0, 0, 0])), 300.0
    domain = bent(comm)
    operator = dd.THEORIES["finite"].operator(domain, enhanced=True)
    loads = [dd.Pressure(side, p) for side in dd.SIDES]
    found = dd.equilibrium(dd.Problem(operator, [], loads, free=True), dd.LinearLaw(C, np.zeros(6)))
    bulk = C[0, :3].sum()
    a = (-bulk + np.sqrt(bulk**2 + 4 * p * bulk)) / (2 * p)  # bulk (a - 1) = -p a^2
    np.testing.assert_allclose(found.mechanical.strain[:, :3], a - 1, rtol=1e-7)
    assert found.iterations <= 8
    assert found.residual < 1e-9


def test_symmetry_planes_and_the_mean_of_the_rest(comm):
    """One plane of symmetry holds three motions, the mean the other three."""
    domain = dd.box(comm, elements=(3, 3, 3), size=tuple(SIZE))
    operator = dd.StrainOperator(domain)
    plane = dd.Displacement("left", (0.0,), (0,))
    loads = [dd.Traction("right", (5.0, 0.0, 0.0))]
    with pytest.raises(InputError, match=r"got 3 of 6"):
        dd.Problem(operator, [plane], loads)
    problem = dd.Problem(operator, [plane], loads, free=True)
    assert len(problem.motions) == 3
    found = dd.Projection.of(problem, dd.isotropic(young=1e3, poisson=0.3)).elastic()
    np.testing.assert_allclose(
        found.strain[:, :3], np.tile([5e-3, -1.5e-3, -1.5e-3], (len(found.strain), 1)), rtol=1e-8
    )


def test_a_free_body_whose_loads_are_not_in_balance_is_refused(comm):
    operator = dd.StrainOperator(dd.box(comm, elements=(2, 2, 2), size=tuple(SIZE)))
    with pytest.raises(InputError, match=r"resultant of \(0 0 8.*e-10\) N"):
        dd.Problem(operator, [], [dd.Traction("top", (0.0, 0.0, 1.0))], free=True)


def test_parts_of_sides_edges_and_points(comm):
    domain = dd.box(comm, elements=(2, 2, 2), size=tuple(SIZE))
    operator = dd.StrainOperator(domain)
    point = dd.Displacement(("left", "bottom", "back"))
    edge = dd.Displacement(("left", "bottom"), (0.0, 0.0), (0, 1))
    half = dd.Displacement("right", (0.0,), (1,), where=lambda x: x[:, 2] < 0.6 * SIZE[2])
    problem = dd.Problem(operator, [point, edge, half])
    # the point has three components; two nodes more of the edge two each; six nodes of the lower part one each
    assert total(comm, problem.fixed.sum()) == 3 + 4 + 6
    with pytest.raises(InputError, match="expected nodes on all of left, right"):
        dd.Problem(operator, [dd.Displacement(("left", "right"))])
    with pytest.raises(InputError, match="expected nodes in the part of it"):
        dd.Problem(operator, [dd.Displacement("left", where=lambda x: x[:, 2] > 1.0)])


def test_a_scaled_problem(comm):
    operator = dd.StrainOperator(dd.box(comm, elements=(2, 2, 2), size=tuple(SIZE)))
    held = [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))]
    whole = dd.Problem(operator, held, [dd.Pressure("left", 3.0)])
    projection = dd.Projection.of(whole, dd.isotropic(young=1e3, poisson=0.3))
    full, part = projection.elastic(), projection.at(0.3).elastic()
    np.testing.assert_allclose(part.u, 0.3 * full.u, atol=1e-9 * np.abs(full.u).max())
    assert whole.at(0.0).at(1.0) is whole


def test_values_that_are_no_traction(comm):
    operator = dd.StrainOperator(dd.box(comm, elements=(2, 2, 2), size=tuple(SIZE)))
    values: tuple[Any, ...] = ((1.0, 2.0), (1.0, np.nan, 0.0), "text", lambda x: x[:, 0])
    for value in values:
        with pytest.raises(InputError, match="expected three finite numbers in Pa"):
            dd.Traction("top", value).nodal_forces(operator)
    with pytest.raises(InputError, match="region of the mesh"):
        dd.BodyForce((1.0, 0.0, 0.0), region="core").nodal_forces(operator)
    with pytest.raises(InputError, match="pressure on 'top'"):
        dd.Pressure("top", np.nan)


def test_a_free_body_by_iterations(comm):
    """Conjugate gradients find what a factorisation finds, although K is singular."""
    options = {"dd_ksp_type": "cg", "dd_pc_type": "gamg"}
    operator = dd.StrainOperator(bent(comm))
    problem = dd.Problem(operator, [], pressures(operator.domain), free=True)
    metric = dd.isotropic(young=1e3, poisson=0.3)
    exact = dd.Projection.of(problem, metric).elastic()
    database = PETSc.Options()
    for name, value in options.items():
        database[name] = value
    try:
        projection = dd.Projection.of(problem, metric)
    finally:
        for name in options:
            database.delValue(name)
    assert projection.solver == "cg + gamg"
    np.testing.assert_allclose(projection.elastic().stress, exact.stress, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"supports": dd.Displacement("left")}, "supports: expected a list of dd.Displacement, got Displacement"),
        ({"supports": ["left"]}, "supports: expected a list of dd.Displacement, got str in it"),
        (
            {"loads": dd.Traction("right", (1.0, 0.0, 0.0))},
            "loads: expected a list of loads, as dd.Traction, got Traction",
        ),
        ({"loads": [5.0]}, "loads: expected a list of loads, as dd.Traction, got float in it"),
        ({"operator": "box"}, "operator: expected a StrainOperator, as of dd.StrainOperator(mesh), got str"),
    ],
)
def test_arguments_of_another_kind(comm, change, text):
    operator = dd.StrainOperator(dd.box(comm, elements=(1, 1, 1), size=tuple(SIZE)))
    with pytest.raises(InputError, match=re.escape(text)):
        dd.Problem(**{"operator": operator, "supports": [dd.Displacement("left")]} | change)
