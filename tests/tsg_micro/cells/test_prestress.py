"""Self-stress: the sum of the cells' closed forms against the SVD, and the rest lengths that put it there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tsg_micro.cells.lattice import box_cells, lattice, spheroid_cells
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import (
    force_density_of_cells,
    prestressed,
    self_stress,
    with_bar_force,
    with_force_density,
)
from tsg_micro.cells.structure import equilibrium_matrix, member_vectors
from tsg_micro.data.errors import InputError
from tsg_micro.equilibrium.members import MemberSystem
from tsg_micro.equilibrium.self_stress_counts import self_stress_counts


def imbalance(structure, q):
    pull = np.abs(q) * np.linalg.norm(member_vectors(structure), axis=1)
    return np.abs(equilibrium_matrix(structure) @ q).max() / pull.max()


@pytest.mark.parametrize("size", [(1, 1, 1), (2, 2, 1), (2, 2, 2)])
@pytest.mark.parametrize("bar_force", [1e-10, 1e-8, 2e-7])
def test_sum_of_cells_equals_svd(cell, size, bar_force):
    structure = lattice(box_cells(*size), cell)
    found = self_stress(structure)
    assert found.states.shape[1] == np.prod(size)  # the cells' own states, and no other
    q = force_density_of_cells(structure, cell, bar_force)
    np.testing.assert_allclose(q, with_bar_force(found.states, structure, bar_force), rtol=1e-12)


@settings(max_examples=20)
@given(
    r=st.floats(0.1, 0.9),
    forces=st.lists(st.floats(1e-10, 1e-7), min_size=12, max_size=12),
)
def test_field_of_bar_forces(r, forces):
    """Any field is in equilibrium, and each bar carries the force of its own cell."""
    parameters = CellParameters(half_diagonal=r)
    structure = lattice(box_cells(2, 3, 2), parameters)
    q = force_density_of_cells(structure, parameters, forces)
    assert imbalance(structure, q) < 1e-13
    bars = structure.bars
    t = q * np.linalg.norm(member_vectors(structure), axis=1)
    np.testing.assert_allclose(-t[bars], np.array(forces)[structure.member_cells[bars, 0]], rtol=1e-13)
    assert (t[~bars] > 0.0).all()


@pytest.mark.parametrize("images", ["merged", "duplicated"])
@pytest.mark.parametrize("periodic", [(True, True, False), (True, True, True)])
def test_periodic_prestress_is_in_equilibrium(cell, periodic, images):
    structure = lattice(box_cells(2, 4, 2), cell, periodic=periodic, images=images)
    assert imbalance(structure, force_density_of_cells(structure, cell, 1e-8)) < 1e-13


def test_shared_tendons_carry_both_cells(cell):
    structure = lattice(box_cells(2, 1, 1), cell)
    t = force_density_of_cells(structure, cell, [1e-8, 3e-8])
    shared = (structure.member_cells >= 0).all(axis=1)
    alone = [t[(structure.kind == 0) & ~shared & (structure.member_cells[:, 0] == c)][0] for c in (0, 1)]
    np.testing.assert_allclose(t[shared], sum(alone), rtol=1e-13)


def test_rest_lengths_give_the_designed_forces(cell, rng):
    structure = lattice(box_cells(3, 2, 2), cell)
    forces = rng.uniform(1e-9, 1e-7, size=12)
    q = force_density_of_cells(structure, cell, forces)
    system = MemberSystem(prestressed(structure, cell, forces))
    state = system.state(np.zeros(system.size))
    np.testing.assert_allclose(state.force_density, q, rtol=1e-10, atol=1e-12 * np.abs(q).max())
    assert np.abs(system.gradient(state)).max() < 1e-12 * np.abs(state.force).max()


def test_spheroid_stands_in_equilibrium(cell, rng):
    cells = spheroid_cells(2.0)
    structure = prestressed(lattice(cells, cell), cell, rng.uniform(1e-9, 1e-7, size=len(cells)))
    system = MemberSystem(structure)
    state = system.state(np.zeros(system.size))
    assert np.abs(system.gradient(state)).max() < 1e-11 * np.abs(state.force).mean()


@pytest.mark.parametrize("bar_force", [1e-10, 1e-8, 2e-7])
def test_prestress_stiffens_every_mechanism(box, bar_force):
    """Of the cell's 25 zero modes of K_E the prestress leaves the six rigid motions."""
    structure = box(1, 1, 1, bar_force=bar_force)
    system = MemberSystem(structure)
    slackless = dataclasses.replace(structure, rest_length=np.linalg.norm(member_vectors(structure), axis=1))
    assert self_stress(slackless).mechanisms == 19
    K = system.tangent_product(system.state(np.zeros(system.size)), np.eye(system.size)[:, :-9])[:-9]
    values = np.linalg.eigvalsh(K)
    assert np.abs(values[:6]).max() < 1e-12 * values[-1]
    assert values[6] > 1e-3 * bar_force / 1e-5  # of the order f_b / h


@pytest.mark.parametrize(
    ("bar_force", "text"),
    [
        (-1e-8, "positive forces"),
        (0.0, "positive forces"),
        (np.nan, "positive forces"),
        (np.inf, "positive forces"),
        (1.0, "less than the bar stiffness"),
        ([1e-8, 1e-8], r"one per cell \(4\), got shape \(2,\)"),
        ([1e-8, 1e-8, -1e-8, 1e-8], "got -1e-08"),
    ],
)
def test_bad_bar_force(cell, bar_force, text):
    with pytest.raises(InputError, match=f"bar_force: expected.*{text}"):
        prestressed(lattice(box_cells(2, 2, 1), cell), cell, bar_force)


def test_states_that_cannot_give_one_bar_force(cell):
    structure = lattice(box_cells(2, 1, 1), cell)
    only_first = force_density_of_cells(structure, cell, [1e-8, 2e-8])[:, None]
    with pytest.raises(InputError, match="states: expected self-stress states that can give all bars one force"):
        with_bar_force(only_first, structure, 1e-8)
    with pytest.raises(InputError, match="bar_force"):
        with_bar_force(only_first, structure, -1e-8)


def test_force_density_beyond_the_stiffness(cell):
    structure = lattice(box_cells(1, 1, 1), cell)
    with pytest.raises(InputError, match="force_density: expected forces above -EA"):
        with_force_density(structure, -2.0 * structure.EA / structure.rest_length)


@pytest.mark.parametrize(
    ("structure", "states"),
    [
        (lattice(box_cells(2, 2, 2)), 8),
        (lattice(box_cells(3, 3, 3)), 27),  # beyond the SVD's limit
        (lattice(box_cells(4, 4, 2), periodic=(True, True, False)), None),
    ],
    ids=["svd", "inertia", "periodic"],
)
def test_counts_of_large_structures_equal_those_of_the_svd(structure, states):
    expected = self_stress(structure)
    found, mechanisms, how = self_stress_counts(structure)
    assert (found, mechanisms) == (expected.states.shape[1], expected.mechanisms)
    assert states in (found, None)
    assert how.startswith("singular" if len(structure.members) <= 1000 else "inertia")


def test_svd_is_for_moderate_sizes():
    with pytest.raises(InputError, match="self_stress: expected at most 4000 members for a dense SVD"):
        self_stress(lattice(box_cells(5, 5, 5)))
