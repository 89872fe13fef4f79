"""Every factorisation solves, and counts its negative pivots, like dense algebra does."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import scipy.sparse as sp
from threadpoolctl import threadpool_limits

from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.equilibrium.linear_solvers import BACKENDS, choose_backend, make_solver
from tsg_micro.equilibrium.members import MemberSystem, NodalPattern


@pytest.fixture(params=sorted(BACKENDS))
def backend(request):
    try:
        return choose_backend(1, request.param).backend
    except InputError:
        pytest.skip(f"{request.param} is not installed")


def dense(pattern, values):
    n = pattern.size
    upper = sp.csr_array((values, pattern.indices, pattern.indptr), shape=(n, n)).toarray()
    return upper + np.triu(upper, 1).T


@pytest.fixture
def tangents(box, clamped, rng):
    """The pattern of a small sheet, and tangents from stable to quite indefinite."""
    structure = box(3, 2, 1)
    fixed, _ = clamped(structure, 1)
    system = MemberSystem(structure)
    pattern = NodalPattern(structure, ~fixed.ravel())
    y = np.append(1e-7 * rng.normal(size=system.nodal_size), np.zeros(9))
    values = []
    for point, shift in ((np.zeros_like(y), 0.0), (y, 0.0), (-3.0 * y, 0.0), (y, -5e-3), (y, -0.5)):
        entry = pattern.assemble(system.member_blocks(system.state(point)))
        entry[pattern.diagonal] += shift
        values.append(entry)
    return pattern, values


def test_solves_and_counts_like_dense_algebra(backend, tangents, rng):
    pattern, matrices = tangents
    solver = make_solver(pattern.indptr, pattern.indices, backend)
    counts = []
    for values in matrices:  # one solver, one pattern, changing values
        K = dense(pattern, values)
        eigenvalues = np.linalg.eigvalsh(K)
        factor = solver.factorise(values)
        counts.append(factor.negative_pivots)
        assert factor.negative_pivots == (eigenvalues < 0.0).sum()
        b = rng.normal(size=(pattern.size, 3))
        for right in (b, b[:, 0]):
            x = factor.solve(right)
            assert x.shape == right.shape
            assert np.abs(K @ x - right).max() < 1e-10 * np.abs(K).max() * np.abs(x).max()
            expected = np.linalg.solve(K, right)
            condition = np.abs(eigenvalues).max() / np.abs(eigenvalues).min()
            assert np.abs(x - expected).max() < max(1e-10, 1e-15 * condition) * np.abs(expected).max()
    assert counts[0] == 0
    assert counts[-1] > 20


def test_two_solvers_do_not_disturb_each_other(backend, tangents, rng):
    pattern, (values, *_, indefinite) = tangents
    first, second = (make_solver(pattern.indptr, pattern.indices, backend) for _ in range(2))
    b = rng.normal(size=pattern.size)
    one = first.factorise(values)
    two = second.factorise(indefinite)
    np.testing.assert_allclose(dense(pattern, values) @ one.solve(b), b, atol=1e-9)
    np.testing.assert_allclose(dense(pattern, indefinite) @ two.solve(b), b, atol=1e-9)


def test_another_number_of_threads(backend, box, clamped, rng):
    """Analysed on two threads, used on one, and back; PARDISO crashed from about 1300 unknowns on."""
    structure = box(6, 5, 1)
    fixed, _ = clamped(structure, 1)
    system = MemberSystem(structure)
    pattern = NodalPattern(structure, ~fixed.ravel())
    values = pattern.assemble(system.member_blocks(system.state(np.zeros(system.nodal_size + 9))))
    solver, b = make_solver(pattern.indptr, pattern.indices, backend), rng.normal(size=(pattern.size, 12))
    upper = sp.csr_array((values, pattern.indices, pattern.indptr), shape=(pattern.size, pattern.size))
    K = upper + sp.triu(upper, 1).T
    with threadpool_limits(2):
        factor = solver.factorise(values)
    for threads in (1, 2, 1):
        with threadpool_limits(threads):
            for used in (factor, factor := solver.factorise(values), solver.factorise(values)):
                x = used.solve(b)
                assert np.abs(K @ x - b).max() < 1e-10 * np.abs(values).max() * np.abs(x).max()


@pytest.mark.parametrize("n", [1, 7, 60])
def test_random_indefinite_matrices(backend, n):
    random = np.random.default_rng(n)
    lower = sp.random_array((n, n), density=min(1.0, 4.0 / n), rng=random).toarray()
    A = lower + lower.T + np.diag(random.choice([-6.0, 6.0], size=n))
    upper = sp.csr_array(np.triu(A))
    upper.sort_indices()
    factor = make_solver(upper.indptr.astype(np.int32), upper.indices.astype(np.int32), backend).factorise(upper.data)
    b = random.normal(size=n)
    np.testing.assert_allclose(factor.solve(b), np.linalg.solve(A, b), rtol=1e-10, atol=1e-12)
    assert factor.negative_pivots == (np.linalg.eigvalsh(A) < 0.0).sum()


def test_superlu_refuses_a_singular_matrix():
    solver = make_solver(np.array([0, 2, 3], dtype=np.int32), np.array([0, 1, 1], dtype=np.int32), "superlu")
    with pytest.raises(ConvergenceError, match="linear solver superlu"):
        solver.factorise(np.zeros(3))
    with pytest.raises(ConvergenceError, match="singular"):  # needs a pivot off the diagonal
        solver.factorise(np.array([0.0, 1.0, 0.0]))


def test_choice_by_size_and_by_what_is_installed(monkeypatch):
    assert choose_backend(200).backend == "superlu"
    assert "200 unknowns" in choose_backend(200).reason
    assert choose_backend(10**6, "superlu").reason == "asked for"
    for name in ("pypardiso", "petsc4py", "dolfinx_solver"):
        monkeypatch.setitem(sys.modules, name, None)  # as if it were not there
    large = choose_backend(10**6)
    assert large.backend == "superlu"
    assert "neither pypardiso nor petsc4py is installed" in large.reason
    for name in ("pardiso", "mumps"):
        with pytest.raises(InputError, match=f"linear solver: {name} is not installed"):
            choose_backend(10, name)


def test_large_systems_take_the_fastest_installed(backend):
    if backend == "pardiso":
        assert choose_backend(201).backend == "pardiso"
    elif backend == "mumps":
        assert choose_backend(1001).backend in ("pardiso", "mumps")
    assert "the fastest installed" in choose_backend(201).reason or choose_backend(201).backend == "superlu"


def test_unknown_backend():
    with pytest.raises(InputError, match="expected auto or one of superlu, pardiso, mumps, got 'umfpack'"):
        choose_backend(10, "umfpack")
