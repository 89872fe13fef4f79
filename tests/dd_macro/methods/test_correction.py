"""One linear solve from the residual of the material to the error: exact for a linear material, Prager and Synge."""

from __future__ import annotations

import numpy as np
import pytest

from dd_macro import (
    Displacement,
    EnhancedGradientOperator,
    EnhancedStrainOperator,
    Metric,
    Problem,
    StrainOperator,
    box,
    isotropic,
    project,
)
from dd_macro.methods.correction import correct
from dd_macro.methods.finite_projection import state_on
from dd_macro.methods.projection import relative_distance
from dd_macro.scene import linear

pytestmark = pytest.mark.mpi

LAW = isotropic(young=1e3, poisson=0.3)


def stretched(comm, kind, pull=2e-6):
    operator = kind(box(comm, elements=(3, 4, 2), size=(3e-5, 4e-5, 2e-5)))
    return Problem(operator, [Displacement("bottom"), Displacement("top", (5e-7, pull, 0.0))])


@pytest.mark.parametrize("kind", [StrainOperator, EnhancedStrainOperator])
def test_a_linear_material_has_its_error_from_the_residual(comm, kind):
    """Any admissible state: the correction leads to the solution, and its length is that of the residual."""
    problem = stretched(comm, kind)
    points = problem.operator.points
    datum = np.sin(1e5 * points @ np.arange(18.0).reshape(3, 6)) * 0.02
    z = project(problem, LAW).project(datum, 1e3 * datum[:, ::-1])
    n = len(points)
    found = correct(problem, z, z.stress - z.strain @ LAW.C, LAW.C[None], np.zeros(n, dtype=np.int64), LAW)
    exact = project(problem, LAW).elastic()
    assert found.linear
    assert found.change == pytest.approx(found.residual, rel=1e-9)
    assert found.change / found.state == pytest.approx(relative_distance(problem.operator, LAW, z, exact), rel=1e-9)


def test_another_metric_than_the_material(comm):
    problem = stretched(comm, StrainOperator)
    soft = Metric(np.diag([300.0, 900.0, 2000.0, 500.0, 700.0, 400.0]), "not the material")
    z = project(problem, soft).elastic()
    n = len(z.strain)
    found = correct(problem, z, z.stress - z.strain @ LAW.C, LAW.C[None], np.zeros(n, dtype=np.int64), soft)
    exact = project(problem, LAW).elastic()
    assert found.change / found.state == pytest.approx(relative_distance(problem.operator, soft, z, exact), rel=1e-9)
    assert found.change != pytest.approx(found.residual, rel=0.02)


def test_finite_strain_to_first_order(comm):
    """The answer of a material 1 % softer than the law of the state: what is left is of second order."""
    problem = stretched(comm, EnhancedGradientOperator)
    z = project(problem, LAW).elastic()
    operator = problem.operator
    found = operator.local(operator.strain(z.u))
    state = state_on(z.u, found, found.strain @ LAW.C)
    n = len(z.strain)
    for part in (1e-2, 1e-3):
        residual = part * state.stress + 0.0 * z.strain
        change = correct(problem, state, residual, LAW.C[None], np.zeros(n, dtype=np.int64), LAW)
        assert 0.3 * part < change.change / change.state


def test_a_material_without_stiffness_leaves_the_residual(comm):
    problem = stretched(comm, EnhancedStrainOperator)
    z = project(problem, LAW).elastic()
    found = correct(problem, z, 0.1 * z.stress, np.zeros((1, 6, 6)), np.zeros(len(z.strain), dtype=np.int64), LAW)
    assert not found.linear
    assert found.change == found.residual


@pytest.mark.parametrize("most", [1.0, 1e3])
def test_an_older_solver_goes_on(comm, most, monkeypatch):
    """One that iterates takes the new values itself, a factorisation is left as it is; the correction is the same."""
    monkeypatch.setattr(linear, "_MOST_ENTRIES", most)
    problem = stretched(comm, EnhancedStrainOperator)
    operator, n = problem.operator, len(problem.operator.weights)
    own = np.zeros(n, dtype=np.int64)
    stiffness = operator.stiffness()
    stiffness.assemble(1.2 * LAW.C[None], own)
    older = linear.LinearSolver(problem, stiffness, prefix="test_", definite=False)
    assert older.direct is (most > 1.0)
    older.solve(problem.forces - operator.force(operator.strain(problem.prescribed)))
    z = project(problem, LAW).elastic()
    found = [
        correct(problem, z, 0.1 * z.stress[:, ::-1], LAW.C[None], own, LAW, older=given) for given in (None, older)
    ]
    assert found[0].linear
    assert found[1].linear
    assert found[1].change == pytest.approx(found[0].change, rel=1e-4)
