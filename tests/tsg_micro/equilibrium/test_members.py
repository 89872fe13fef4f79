"""Energy, force and tangent: each the derivative of the one before, on the reference and on random states."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tsg_micro.cells.lattice import box_cells, lattice
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import prestressed
from tsg_micro.equilibrium.members import MACRO, MemberSystem, NodalPattern

CELL = CellParameters()
SYSTEMS = {
    (kind, slack): MemberSystem(prestressed(lattice(box_cells(*size), CELL, **options), CELL, 1e-8), slack=slack)
    for kind, size, options in (
        ("cell", (1, 1, 1), {}),
        ("sheet", (2, 2, 2), {"periodic": (True, True, False)}),
        ("bulk", (2, 2, 2), {"periodic": (True, True, True), "images": "duplicated"}),
    )
    for slack in (False, True)
}


def random_point(system, seed, amplitude):
    """Displacements of about ``amplitude`` cell heights, and an H of the same size."""
    y = amplitude * np.random.default_rng(seed).normal(size=system.size)
    y[: system.nodal_size] *= CELL.height
    return y


def difference(function, y, direction, step):
    return (function(y + step * direction) - function(y - step * direction)) / (2.0 * step)


@pytest.mark.parametrize("kind", ["cell", "sheet", "bulk"])
@pytest.mark.parametrize("slack", [False, True])
@settings(max_examples=12)
@given(seed=st.integers(0, 10**6), amplitude=st.sampled_from([0.0, 1e-3, 0.03]))
def test_force_and_tangent_are_derivatives(kind, slack, seed, amplitude):
    system = SYSTEMS[kind, slack]
    y = random_point(system, seed, amplitude)
    state = system.state(y)
    if slack and amplitude == 0.03:
        assert (state.stiffness == 0.0).any()
    direction = random_point(system, seed + 1, 1.0)
    direction /= np.abs(direction[: system.nodal_size]).max() / CELL.height
    force = system.gradient(state)
    # relative to what the members alone would give, so that it holds at equilibrium too, where the sum vanishes
    scale = np.abs(state.force).max() * CELL.height
    slope = difference(lambda x: system.energy(system.state(x)), y, direction, 1e-6)
    assert slope == pytest.approx(force @ direction, rel=1e-6, abs=1e-6 * scale)
    ends = [system.state(y + step * direction).stiffness == 0.0 for step in (-1e-6, 1e-6)]
    assume(np.array_equal(*ends))  # no derivative where a tendon goes slack in between
    change = difference(lambda x: system.gradient(system.state(x)), y, direction, 1e-6)
    product = system.tangent_product(state, direction[:, None])[:, 0]
    for part in (slice(None, system.nodal_size), slice(system.nodal_size, None)):  # N and J: apart
        np.testing.assert_allclose(change[part], product[part], rtol=0.0, atol=1e-6 * np.abs(product[part]).max())


def test_force_is_the_derivative_in_every_component(rng):
    system = SYSTEMS["sheet", False]
    y = random_point(system, 3, 0.02)
    step = np.append(np.full(system.nodal_size, 1e-6 * CELL.height), np.full(MACRO, 1e-6))
    energy = [
        difference(lambda x: system.energy(system.state(x)), y, direction, h)
        for direction, h in zip(np.eye(system.size), step, strict=True)
    ]
    force = system.gradient(system.state(y))
    for part in (slice(None, system.nodal_size), slice(system.nodal_size, None)):
        np.testing.assert_allclose(np.array(energy)[part], force[part], atol=1e-6 * np.abs(force[part]).max())


@pytest.mark.parametrize("kind", ["cell", "sheet", "bulk"])
@pytest.mark.parametrize("slack", [False, True])
def test_tangent_is_symmetric(kind, slack):
    system = SYSTEMS[kind, slack]
    K = system.tangent_product(system.state(random_point(system, 5, 0.03)), np.eye(system.size))
    assert np.abs(K - K.T).max() < 1e-14 * np.abs(K).max()


@pytest.mark.parametrize("kind", ["cell", "sheet", "bulk"])
@pytest.mark.parametrize("seed", range(3))
def test_sparse_pattern_holds_the_same_tangent(kind, seed):
    system = SYSTEMS[kind, True]
    free = np.random.default_rng(seed).random(system.nodal_size) < 0.7
    pattern = NodalPattern(system.structure, free)
    state = system.state(random_point(system, seed, 0.02))
    values = pattern.assemble(system.member_blocks(state))
    upper = sp.csr_array((values, pattern.indices, pattern.indptr), shape=(pattern.size, pattern.size)).toarray()
    assert np.array_equal(upper, np.triu(upper))
    np.testing.assert_array_equal(values[pattern.diagonal], upper.diagonal())
    whole = np.eye(system.size)[:, : system.nodal_size][:, free]
    K = system.tangent_product(state, whole)[: system.nodal_size][free]
    np.testing.assert_allclose(upper + np.triu(upper, 1).T, K, atol=1e-14 * np.abs(K).max())


@given(
    rotation=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    translation=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    seed=st.integers(0, 10**6),
)
@settings(max_examples=25)
def test_rigid_motion_changes_no_energy_and_turns_the_forces(rotation, translation, seed):
    system = SYSTEMS["cell", False]
    R = Rotation.from_rotvec(rotation).as_matrix()
    nodes = system.structure.nodes
    y = random_point(system, seed, 0.01)
    moved = (nodes + y[:-MACRO].reshape(-1, 3)) @ R.T + CELL.height * np.array(translation)
    here = system.state(y)
    there = system.state(np.append((moved - nodes).ravel(), np.zeros(MACRO)))
    assert system.energy(there) == pytest.approx(system.energy(here), rel=1e-11)
    turned = system.gradient(here)[:-MACRO].reshape(-1, 3) @ R.T
    np.testing.assert_allclose(
        system.gradient(there)[:-MACRO].reshape(-1, 3), turned, atol=1e-11 * np.abs(here.force).max()
    )


@given(seed=st.integers(0, 10**6))
@settings(max_examples=10)
def test_forces_balance_on_any_state(seed):
    """No net force and no net moment from members alone."""
    system = SYSTEMS["cell", True]
    y = random_point(system, seed, 0.05)
    state = system.state(y)
    force = system.gradient(state)[:-MACRO].reshape(-1, 3)
    position = system.structure.nodes + y[:-MACRO].reshape(-1, 3)
    scale = np.abs(state.force).max()
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * scale
    assert np.abs(np.cross(position, force).sum(axis=0)).max() < 1e-12 * scale * CELL.height


def test_macroscopic_gradient_is_an_affine_motion_of_the_infinite_body():
    """Moving nodes and jumps by one H gives every member the vector F d."""
    system = SYSTEMS["bulk", False]
    H = 0.1 * np.random.default_rng(2).normal(size=(3, 3))
    y = np.append((system.structure.nodes @ H.T).ravel(), H.ravel())
    np.testing.assert_allclose(system.state(y).vector, system.reference @ (np.eye(3) + H).T, atol=1e-19)


def test_slack_tendons_carry_nothing_and_bars_do():
    system = SYSTEMS["cell", True]
    y = np.append(-0.3 * system.structure.nodes.ravel(), np.zeros(MACRO))  # the cell shrinks evenly
    state = system.state(y)
    bars = system.structure.bars
    assert (state.force[~bars] == 0.0).all()
    assert (state.force[bars] < 0.0).all()
