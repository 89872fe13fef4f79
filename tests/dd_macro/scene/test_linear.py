"""Every linear solve is checked by its residual, whatever solver PETSc's options ask for."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from dd_macro import Displacement, Problem, StrainOperator, box, isotropic
from dd_macro.parallel import total
from dd_macro.scene import factor_size, linear
from dd_macro.scene.factor_size import factor_memory
from dd_macro.scene.linear import LinearSolver
from tsg_micro.data.errors import ConvergenceError

pytestmark = pytest.mark.mpi


@pytest.fixture
def options():
    """Set PETSc's options of the solver ``test_``, and take them away again."""
    database, names = PETSc.Options(), []

    def put(text):
        for name, value in zip(text.split()[::2], text.split()[1::2], strict=True):
            names.append(f"test_{name}")
            database[names[-1]] = value

    yield put
    for name in names:
        database.delValue(name)


def make(comm, *, thickness=1e-5):
    operator = StrainOperator(box(comm, elements=(4, 3, 2), size=(4e-5, 3e-5, thickness)))
    problem = Problem(operator, [Displacement("bottom")])
    stiffness = operator.stiffness(isotropic(young=1e3, poisson=0.3).C)
    return operator, LinearSolver(problem, stiffness, prefix="test_")


def right_side(operator):
    return np.sin(1e5 * operator.node_coordinates()).ravel()


@pytest.mark.parametrize(
    "text",
    [
        "ksp_type preonly pc_type jacobi",
        "ksp_type preonly pc_type none",
        "ksp_type cg pc_type jacobi ksp_rtol 1e-2",
        "ksp_type richardson pc_type jacobi ksp_max_it 3 ksp_error_if_not_converged 0",
        "ksp_type gmres pc_type none ksp_rtol 1e-3",
    ],
)
def test_a_solver_that_solves_nothing_is_named(comm, options, text):
    options(text)
    operator, solver = make(comm)
    with pytest.raises(ConvergenceError, match=rf"linear solver {solver._ksp.getType()} \+ .*PETSC_OPTIONS|stopped"):
        solver.solve(right_side(operator))


@pytest.mark.parametrize("text", ["", "ksp_type cg pc_type jacobi", "ksp_type cg pc_type gamg"])
@pytest.mark.parametrize("thickness", [1e-5, 1e-8])
def test_solvers_that_solve_agree(comm, options, text, thickness):
    """Flat elements, 1:1000, too: a factorisation of an ill-conditioned matrix is no error."""
    if text and thickness < 1e-6:
        pytest.skip("no iterative solver gets there")
    options(text)
    operator, solver = make(comm, thickness=thickness)
    b = right_side(operator)
    x = solver.solve(b)
    b[solver._fixed] = 0.0
    energy = total(comm, [x @ b, np.abs(x @ b)])
    assert energy[0] > 0
    assert not solver.solve(0 * b).any()


@pytest.mark.parametrize("text", ["", "ksp_type preonly pc_type lu", "ksp_type cg pc_type jacobi"])
def test_two_right_sides_at_once_are_one_after_the_other(comm, options, text):
    options(text)
    operator, solver = make(comm)
    a = right_side(operator)
    b = np.cos(3e5 * operator.node_coordinates()).ravel()
    for found, expected in zip(solver.solve_both(a, b), (solver.solve(a), solver.solve(b)), strict=True):
        scale = comm.allreduce(np.abs(expected).max(initial=0.0), op=MPI.MAX)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * scale)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_older_factorisation_finds_the_same_solution(comm, sign):
    """Conjugate gradients with the factor of other values, and a new factor where the matrix is not positive."""
    operator, _ = make(comm)
    problem = Problem(operator, [Displacement("bottom")])
    soft = isotropic(young=1e3, poisson=0.3).C
    hard = np.where(operator.points[:, :1, None] > 2e-5, 3.0, 1.0) * soft
    stiffness = operator.stiffness()
    b, found = right_side(operator), []
    for keep in (False, True):
        stiffness.assemble(np.broadcast_to(soft, hard.shape))
        solver = LinearSolver(problem, stiffness, prefix="test_", definite=False)
        stiffness.assemble(sign * hard)
        solver.update(keep=keep)
        found.append(solver.solve(b))
    scale = comm.allreduce(np.abs(found[0]).max(initial=0.0), op=MPI.MAX)
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-8 * scale)
    if sign > 0:
        near = solver.solve(2.0 * b, within=1e-2)
        away = comm.allreduce(np.abs(near - 2.0 * found[0]).max(initial=0.0), op=MPI.MAX)
        assert 1e-8 * scale < away < 0.1 * scale


@pytest.mark.parametrize("elements", [(30, 30, 1), (20, 20, 3), (8, 8, 8)])
def test_memory_of_a_factor_is_estimated(comm, elements, monkeypatch):
    """At least that of its entries, not more than twice as much; what does not fit is solved by iterations."""
    operator = StrainOperator(box(comm, elements=elements, size=tuple(1e-5 * n for n in elements)))
    problem = Problem(operator, [Displacement("bottom")])
    C = isotropic(young=1e3, poisson=0.3).C
    solver = LinearSolver(problem, operator.stiffness(C), prefix="test_")
    if "mumps" in solver.name:
        entries = solver._ksp.getPC().getFactorMatrix().getMumpsInfog(29)
        assert 12.0 * entries < factor_memory(operator) < 24.0 * entries
    monkeypatch.setattr(factor_size, "available_memory", lambda: int(factor_memory(operator)))
    assert LinearSolver(problem, operator.stiffness(C), prefix="test_").name == "cg + gamg"


def halves(operator, factor):
    """Moduli of the points, those of one half times ``factor``: where that is negative K is not definite."""
    C = isotropic(young=1e3, poisson=0.3).C
    return np.where(operator.points[:, :1, None] > 2e-5, factor, 1.0) * C


@pytest.mark.parametrize("factor", [1.01, -1.5])
@pytest.mark.parametrize("keep", [True, False])
def test_iterations_and_a_factorisation_agree(comm, factor, keep, monkeypatch):
    """With levels of GAMG of other values too; what iterations do not solve is factorised, its pivots are counted."""
    operator, _ = make(comm)
    problem, b, found = Problem(operator, [Displacement("bottom")]), right_side(operator), []
    for most in (1e3, 1.0):
        monkeypatch.setattr(linear, "_MOST_ENTRIES", most)
        stiffness = operator.stiffness()
        stiffness.assemble(halves(operator, 1.0))
        solver = LinearSolver(problem, stiffness, prefix="test_", definite=False)
        solver.solve(b)
        stiffness.assemble(halves(operator, factor))
        solver.update(keep=keep and most == 1.0)
        found.append((solver.solve(b), solver))
    (expected, direct), (x, solver) = found
    scale = comm.allreduce(np.abs(expected).max(initial=0.0), op=MPI.MAX)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-7 * scale)
    assert (solver.name == "cg + gamg") is (factor > 0)
    assert solver.negative_pivots == (None if factor > 0 else direct.negative_pivots)
    if factor > 0:
        near = comm.allreduce(np.abs(solver.solve(b, within=1e-3) - expected).max(initial=0.0), op=MPI.MAX)
        assert 1e-7 * scale < near < 0.1 * scale


def test_conjugate_gradients_go_on_with_the_factor_of_another_matrix(comm):
    """From a solver that is given away to one of near values, without a factorisation of its own."""
    operator, older = make(comm)
    C = isotropic(young=1e3, poisson=0.3).C
    hard, problem, found = (
        C * np.array([1.0, 1.3, 0.8, 1.0, 1.2, 1.0])[:, None] ** 0.5,
        Problem(operator, [Displacement("bottom")]),
        [],
    )
    hard = 0.5 * (hard + hard.T)
    for given in (None, older):
        solver = LinearSolver(problem, operator.stiffness(hard), prefix="test_", definite=False, older=given)
        assert solver._old is (given is not None)
        found.append(solver.solve(right_side(operator)))
    scale = comm.allreduce(np.abs(found[0]).max(initial=0.0), op=MPI.MAX)
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-8 * scale)


def test_a_solver_that_is_gone_leaves_no_factor(comm):
    """On several ranks petsc4py destroys nothing by itself: the next solver has to."""
    operator, solver = make(comm)
    held = solver.matrix.getRefCount()
    stiffness, problem = solver.stiffness, Problem(operator, [Displacement("bottom")])
    del solver
    other = LinearSolver(problem, stiffness, prefix="test_")
    assert other.matrix.getRefCount() == held
