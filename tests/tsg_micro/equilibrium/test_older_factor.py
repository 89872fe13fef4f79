"""Older factors give the steps, the equilibria and the inertia of new ones, or are not used."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from tsg_micro.bodies.sheet import ClampedSheet, Sheet
from tsg_micro.continuum.rve import build_rve
from tsg_micro.equilibrium import newton
from tsg_micro.equilibrium.linear_solvers import SuperLU
from tsg_micro.equilibrium.load_path import EquilibriumSolver
from tsg_micro.equilibrium.older_factor import conjugate_gradients, corrected


def matrix_of(eigenvalues, rng):
    """A symmetric matrix with these eigenvalues, and its upper triangle."""
    Q = np.linalg.qr(rng.normal(size=(len(eigenvalues),) * 2))[0]
    K = (Q * eigenvalues) @ Q.T
    return 0.5 * (K + K.T), sp.csr_array(np.triu(0.5 * (K + K.T)))


def test_conjugate_gradients_solve_or_say_that_a_stiffness_is_negative(rng):
    for low, found in ((0.5, True), (-0.5, False)):
        K, _ = matrix_of(np.append(low, np.linspace(0.9, 1.1, 39)), rng)
        b = rng.normal(size=40)
        x = conjugate_gradients(K.__matmul__, np.copy, b, within=1e-10)
        assert (x is not None) == found
        if x is not None:
            np.testing.assert_allclose(K @ x, b, atol=1e-8)


@pytest.mark.parametrize("negative", [0, 3])
@pytest.mark.parametrize("change", [0.0, 1e-6, 1e-3, 0.1])
def test_a_nearby_factor_solves_exactly_and_a_far_one_is_refused(rng, change, negative):
    eigenvalues = np.append(-np.ones(negative), np.linspace(1.0, 5.0, 40 - negative))
    K0, upper0 = matrix_of(eigenvalues, rng)
    other, _ = matrix_of(rng.uniform(-1.0, 1.0, 40), rng)
    K = K0 + change * other
    factor = corrected(SuperLU(upper0.indptr, upper0.indices).factorise(upper0.data), sp.csr_array(np.triu(K)))
    assert (factor is None) == (change == 0.1)
    if factor is not None:
        assert factor.negative_pivots == (np.linalg.eigvalsh(K) < 0.0).sum() == negative
        for b in (rng.normal(size=40), rng.normal(size=(40, 2))):
            np.testing.assert_allclose(factor.solve(b), np.linalg.solve(K, b), rtol=0, atol=1e-8)


@pytest.fixture
def both(monkeypatch):
    """What a function gives with new factors only, and with older ones however few the unknowns are."""

    def run(function):
        results = []
        for large in (10**9, 0):
            monkeypatch.setattr(newton, "_LARGE", large)
            results.append(function())
        return results

    return run


@pytest.mark.parametrize("motion", [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0)])
def test_a_sheet_takes_the_same_path(both, motion):
    def follow():
        body = ClampedSheet(Sheet((3, 2)), motion)
        steps = [body.load(strain) for strain in (0.02, 0.04)]
        return steps, body.tangent_modulus()

    (new, modulus), (older, same) = both(follow)
    for a, b in zip(new, older, strict=True):
        assert b.nominal_stress == pytest.approx(a.nominal_stress, rel=1e-9)
        assert (b.state.residual <= 1e-10, b.state.negative_pivots) == (True, a.state.negative_pivots)
        assert b.state.factorisations < 0.6 * a.state.factorisations
    assert same == pytest.approx(modulus, rel=1e-8)


def test_free_macroscopic_strains_and_constraints_are_kept(both, cell):
    new, older = both(lambda: build_rve(cell, bar_force=1e-8).solve_strain([0.03, -0.02, 0, 0, 0, 0.02]))
    np.testing.assert_allclose(older.equilibrium.H, new.equilibrium.H, rtol=0, atol=1e-10)
    assert older.equilibrium.energy == pytest.approx(new.equilibrium.energy, rel=1e-10)


def test_a_column_that_buckles_ends_on_the_same_stable_branch(both, short_column):
    structure, fixed, u = short_column
    new, older = both(lambda: EquilibriumSolver(structure, fixed=fixed).solve(displacement=u, steps=4, stable=True))
    assert older.negative_pivots == new.negative_pivots == 0
    assert older.energy == pytest.approx(new.energy, rel=1e-9)
