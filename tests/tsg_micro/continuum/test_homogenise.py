"""From members to continuum: affine fields exactly, averages that add up, and section forces of a small sheet."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tsg_micro.cells.lattice import box_cells, lattice, spheroid_cells
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import prestressed
from tsg_micro.continuum.homogenise import block_fields, cell_gradient, kirchhoff_stress
from tsg_micro.data.errors import InputError
from tsg_micro.equilibrium.load_path import EquilibriumSolver
from tsg_micro.equilibrium.members import MemberSystem
from tsg_micro.equilibrium.newton import NewtonOptions

CELL = CellParameters()
SHAPES = {
    "sheet": prestressed(lattice(box_cells(4, 6, 2), CELL), CELL, 1e-8),
    "hollow": prestressed(lattice([c for c in box_cells(4, 4, 4) if not (c // 2 == 0).all()], CELL), CELL, 1e-8),
    "ball": prestressed(lattice(spheroid_cells(1.5), CELL), CELL, 1e-8),
}


def state_at(structure, displacement):
    system = MemberSystem(structure)
    return system.state(np.append(displacement.ravel(), np.zeros(9)))


@pytest.mark.parametrize("shape", sorted(SHAPES))
@settings(max_examples=10)
@given(seed=st.integers(0, 10**6))
def test_gradient_of_an_affine_field_is_exact(shape, seed):
    structure = SHAPES[shape]
    random = np.random.default_rng(seed)
    H, shift = random.normal(size=(3, 3)), random.normal(size=3) * 1e-5
    u = structure.nodes @ H.T + shift
    np.testing.assert_allclose(
        cell_gradient(structure, u), np.broadcast_to(H, (len(structure.cells), 3, 3)), atol=1e-12
    )
    fields = block_fields(structure, u, state_at(structure, u))
    np.testing.assert_allclose(fields.F, np.broadcast_to(np.eye(3) + H, fields.F.shape), atol=1e-12)


def test_gradient_of_a_quadratic_field_is_that_of_the_cell_centre():
    """The face means differ by the centre's gradient, since every face has the same second moments."""
    structure = SHAPES["sheet"]
    x = structure.nodes / CELL.height
    u = np.zeros_like(x)
    u[:, 0] = CELL.height * x[:, 1] ** 2
    H = cell_gradient(structure, u)
    centre = structure.cells[:, 1] + 0.5
    np.testing.assert_allclose(H[:, 0, 1], 2.0 * centre, rtol=1e-12)
    assert np.abs(H[:, 1:]).max() == 0.0


@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_block_stresses_add_up_to_the_stress_of_the_whole(shape, rng):
    """All blocks are full here, so the plain mean is the volume's."""
    structure = SHAPES[shape]
    u = 0.02 * CELL.height * rng.normal(size=structure.nodes.shape)
    state = state_at(structure, u)
    volume = len(structure.cells) * CELL.height**3
    whole = kirchhoff_stress(state, volume)
    np.testing.assert_allclose(
        block_fields(structure, u, state).kirchhoff.mean(axis=0), whole, atol=1e-12 * np.abs(whole).max()
    )


def test_half_blocks_are_weighted_by_their_volume(rng):
    structure = prestressed(lattice(box_cells(3, 2, 2), CELL), CELL, 1e-8)
    u = 0.02 * CELL.height * rng.normal(size=structure.nodes.shape)
    state = state_at(structure, u)
    fields = block_fields(structure, u, state)
    assert len(structure.blocks) == 2
    whole = kirchhoff_stress(state, structure.volume)
    np.testing.assert_allclose(
        (2.0 * fields.kirchhoff[0] + fields.kirchhoff[1]) / 3.0, whole, atol=1e-12 * np.abs(whole).max()
    )
    np.testing.assert_allclose(fields.midpoint, CELL.height * np.array([[1.0, 1, 1], [2.5, 1, 1]]))


def test_virial_of_one_member():
    """A bar of force t along e in a volume V: tau = t l / V e (x) e."""
    structure = SHAPES["sheet"]
    state = state_at(structure, np.zeros(structure.nodes.shape))
    tau = kirchhoff_stress(state, 1.0)
    direction = state.vector / state.length[:, None]
    terms = (state.force * state.length)[:, None, None] * direction[:, :, None] * direction[:, None, :]
    np.testing.assert_allclose(tau, terms.sum(axis=0), atol=1e-14 * np.abs(terms).max() * len(terms))
    assert np.abs(tau).max() < 1e-12 * np.abs(terms).sum()  # a self-stress has no virial


@pytest.fixture(scope="module")
def sheet():
    """A sheet of 3 x 4 x 1 blocks, its bottom held and its top moved: 5 % stretch and some shear."""
    structure = prestressed(lattice(box_cells(6, 8, 2), CELL), CELL, 1e-8)
    keys = structure.node_keys[:, 1]
    high, low = keys == keys.max(), keys == keys.min()
    fixed = np.zeros(structure.nodes.shape, dtype=bool)
    fixed[high | low] = True
    u = np.zeros(structure.nodes.shape)
    u[high] = np.array([0.01, 0.05, 0.0]) * structure.size[1]
    solver = EquilibriumSolver(structure, fixed=fixed, options=NewtonOptions(tolerance=1e-11))
    result = solver.solve(displacement=u, stable=True)
    return structure, result, result.reaction[high].sum(axis=0)


def test_every_section_carries_the_reaction(sheet):
    """Sum over the members of a row of t_e (x) L_e, L_e the reference vector: the section force times its height."""
    structure, result, reaction = sheet
    reference = MemberSystem(structure).reference
    moment = (result.members.force_density[:, None] * result.members.vector)[:, :, None] * reference[:, None, :]
    owned = structure.member_cells >= 0
    row_of_cell = structure.cells[:, 1] // 2
    for row in range(4):
        inside = (owned & (row_of_cell[structure.member_cells] == row)).sum(axis=1) / owned.sum(axis=1)
        force = (inside[:, None] * moment[:, :, 1]).sum(axis=0) / (2.0 * CELL.height)
        np.testing.assert_allclose(force, reaction, atol=1e-9 * np.abs(reaction).max())


def test_mean_first_piola_of_block_rows_is_the_nominal_stress(sheet):
    """The block stresses are in balance with the supports; tau F^-T with the block's mean F only nearly so."""
    structure, result, reaction = sheet
    assert result.negative_pivots == 0
    fields = block_fields(structure, result.displacement, result.members)
    approximate = fields.kirchhoff @ np.linalg.inv(fields.F).transpose(0, 2, 1)
    nominal = reaction / (structure.size[0] * structure.size[2])
    for row in range(4):
        here = structure.blocks[:, 1] == row
        np.testing.assert_allclose(fields.first_piola[here, :, 1].mean(axis=0), nominal, atol=1e-9 * nominal.max())
        assert approximate[here, 1, 1].mean() == pytest.approx(nominal[1], rel=5e-3)  # found: 1.9e-3 where clamped


def test_whole_virial_is_the_work_of_the_supports(sheet):
    """Sum of t_e (x) l_e = sum of reaction (x) position: the stress of the body from its boundary alone."""
    structure, result, _ = sheet
    position = structure.nodes + result.displacement
    boundary = result.reaction.T @ position / structure.volume
    tau = kirchhoff_stress(result.members, structure.volume)
    np.testing.assert_allclose(boundary, tau, atol=1e-9 * np.abs(tau).max())


def test_periodic_lattices_have_no_cell_faces_of_their_own():
    structure = lattice(box_cells(2, 2, 2), periodic=(True, True, False))
    with pytest.raises(InputError, match="structure: expected a lattice without periodic axes"):
        cell_gradient(structure, np.zeros(structure.nodes.shape))
