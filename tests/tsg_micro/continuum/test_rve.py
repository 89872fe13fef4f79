"""The RVE: size, objectivity, energy and tangent by differences, free components, symmetry of the lattice."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from tsg_micro.cells.lattice import box_cells, lattice
from tsg_micro.continuum.homogenise import kirchhoff_stress
from tsg_micro.continuum.rve import RVE, build_rve
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import BASIS, from_mandel, to_mandel
from tsg_micro.equilibrium.newton import NewtonOptions

TIGHT = NewtonOptions(tolerance=1e-12)
IN_PLANE = to_mandel([[-0.01, 0.01, 0.0], [0.01, 0.04, 0.0], [0.0, 0.0, 0.0]])
ALL_SIX = to_mandel([[0.01, 0.004, -0.003], [0.004, 0.02, 0.002], [-0.003, 0.002, -0.01]])
MEASURES = ("cauchy", "kirchhoff", "first_piola", "second_piola")
SHEET, BULK = (True, True, False), (True, True, True)


def relative(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


def tangent_of(state):
    assert state.tangent is not None
    return state.tangent


@pytest.fixture(scope="module")
def merged():
    return build_rve(bar_force=1e-8, options=TIGHT).solve_strain(IN_PLANE)


@pytest.mark.parametrize("blocks", [(2, 2, 1), (3, 3, 1)])
def test_one_merged_block_is_enough(merged, blocks):
    state = build_rve(bar_force=1e-8, blocks=blocks, options=TIGHT).solve_strain(IN_PLANE)
    for measure in MEASURES:
        assert relative(getattr(state, measure), getattr(merged, measure)) < 1e-8
    assert state.energy == pytest.approx(merged.energy, rel=1e-8)
    assert relative(state.tangent, merged.tangent) < 1e-8


def test_duplicated_images_err_like_one_over_the_size(merged):
    sizes = np.array([1, 2, 3, 4])
    errors = []
    for n in sizes:
        rve = build_rve(bar_force=1e-8, blocks=(n, n, 1), images="duplicated")
        errors.append(relative(rve.solve_strain(IN_PLANE, tangent=False).cauchy, merged.cauchy))
    slope = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert slope == pytest.approx(-1.0, abs=0.15)
    assert errors[0] > 0.01


@pytest.mark.parametrize("periodic", [SHEET, BULK, (True, False, False), (False, True, False)])
@pytest.mark.parametrize("seed", range(3))
def test_objectivity(periodic, seed):
    """R F: Cauchy stress turns with R, the second Piola stress does not see it."""
    random = np.random.default_rng(seed)
    H = 0.04 * random.normal(size=(3, 3))
    R = Rotation.from_rotvec(0.6 * random.uniform(-1.0, 1.0, size=3)).as_matrix()
    rve = build_rve(bar_force=1e-8, periodic=periodic, free=(), options=TIGHT)
    here = rve.solve_gradient(H)
    rve.reset()
    there = rve.solve_gradient(R @ here.F - np.eye(3), steps=4)
    assert relative(there.cauchy, R @ here.cauchy @ R.T) < 1e-9
    assert relative(there.second_piola, here.second_piola) < 1e-9
    assert relative(there.first_piola, R @ here.first_piola) < 1e-9
    assert there.energy == pytest.approx(here.energy, rel=1e-9)


def differences(rve, state, step):
    """d sym(P) / d strain (6, 6) by central differences, from the equilibrium ``state``."""
    y = np.append(state.equilibrium.displacement.ravel(), state.equilibrium.H.ravel())
    columns = []
    for direction in BASIS:
        ends = []
        for sign in (1.0, -1.0):
            rve.solver.move_to(y, rve.solver.force)
            ends.append(rve.solve_gradient(state.F - np.eye(3) + sign * step * direction).first_piola)
        columns.append(to_mandel((ends[0] - ends[1]) / (2.0 * step)))
    return np.array(columns).T


@pytest.mark.parametrize("periodic", [SHEET, BULK])
@pytest.mark.parametrize("strain", [np.zeros(6), ALL_SIX], ids=["reference", "strained"])
def test_tangent_with_all_strains_prescribed(periodic, strain):
    rve = build_rve(bar_force=1e-8, periodic=periodic, free=(), options=TIGHT)
    state = rve.solve_strain(strain)
    assert relative(state.tangent, differences(rve, state, 1e-5)) < 1e-5
    np.testing.assert_array_equal(tangent_of(state), tangent_of(state).T)


@pytest.mark.parametrize("free", [("zz", "yz", "xz"), ("xx", "zz", "yz", "xz")])
def test_tangent_at_a_free_state_is_that_of_all_six(free):
    state = build_rve(bar_force=1e-8, free=free, options=TIGHT).solve_strain(IN_PLANE)
    rve = build_rve(bar_force=1e-8, free=(), options=TIGHT)
    assert relative(state.tangent, differences(rve, state, 1e-5)) < 1e-5


def test_condensed_tangent_is_that_of_the_free_rve():
    """The Schur complement on the prescribed strains is what an RVE with free components answers."""
    rve = build_rve(bar_force=1e-8, options=TIGHT)
    state = rve.solve_strain(IN_PLANE)
    free, kept = [2, 3, 4], [0, 1, 5]
    C = tangent_of(state)
    coupling = C[np.ix_(free, kept)]
    expected = C[np.ix_(kept, kept)] - coupling.T @ np.linalg.solve(C[np.ix_(free, free)], coupling)
    found = []
    for component in kept:
        ends = [rve.solve_strain(IN_PLANE + sign * 1e-5 * np.eye(6)[component]).first_piola for sign in (1.0, -1.0)]
        found.append(to_mandel(ends[0] - ends[1])[kept] / 2e-5)
    assert relative(np.array(found).T, expected) < 1e-5


def test_first_piola_is_the_derivative_of_the_energy():
    rve = build_rve(bar_force=1e-8, free=(), options=TIGHT)
    H = from_mandel(ALL_SIX) + 0.01 * np.array([[0, 1, 0.5], [-1, 0, 0.2], [-0.5, -0.2, 0]])
    state = rve.solve_gradient(H)
    found = np.zeros((3, 3))
    for a, b in np.ndindex(3, 3):
        step = np.zeros((3, 3))
        step[a, b] = 1e-5
        found[a, b] = (rve.solve_gradient(H + step).energy - rve.solve_gradient(H - step).energy) / 2e-5
    assert relative(found, state.first_piola) < 1e-6


@pytest.mark.parametrize("periodic", [SHEET, BULK])
@pytest.mark.parametrize("images", ["merged", "duplicated"])
def test_two_routes_to_the_stress(periodic, images):
    """P from the forces on the border, and tau from the sum over members; S and tau are symmetric."""
    rve = build_rve(bar_force=1e-8, periodic=periodic, images=images, free=(), options=TIGHT)
    state = rve.solve_gradient(from_mandel(ALL_SIX) + 0.02 * np.array([[0, 1, 0], [-1, 0, 1], [0, -1, 0]]))
    assert relative(state.kirchhoff, kirchhoff_stress(state.equilibrium.members, rve.structure.volume)) < 1e-10
    assert relative(state.second_piola, state.second_piola.T) < 1e-10
    assert relative(state.cauchy * np.linalg.det(state.F), state.kirchhoff) < 1e-14
    np.testing.assert_allclose(state.strain, ALL_SIX, atol=1e-14)


def test_mean_strain_across_the_free_faces():
    """H e_z is the difference of the mean displacements of the two faces over the thickness."""
    rve = build_rve(bar_force=1e-8, options=TIGHT)
    state = rve.solve_strain(IN_PLANE)
    z = rve.structure.nodes[:, 2]
    u = state.equilibrium.displacement
    thickness = rve.structure.size[2]
    jump = u[z > thickness * (1 - 1e-9)].mean(axis=0) - u[z < thickness * 1e-9].mean(axis=0)
    np.testing.assert_allclose(jump / thickness, state.equilibrium.H[:, 2], atol=1e-12)


@pytest.mark.parametrize(
    ("free", "periodic"), [(("zz", "yz", "xz"), SHEET), (("xx", "zz", "yz", "xz"), SHEET), (("xx", "zz"), BULK)]
)
def test_free_components_carry_no_stress(free, periodic):
    rve = build_rve(bar_force=1e-8, free=free, periodic=periodic, options=TIGHT)
    state = rve.solve_strain(IN_PLANE)
    stress = to_mandel(state.first_piola)
    index = list(rve.free)
    assert np.abs(stress[index]).max() < 1e-9 * np.abs(stress).max()
    held = [k for k in range(6) if k not in index]
    np.testing.assert_allclose(state.strain[held], IN_PLANE[held], atol=1e-14)
    assert state.strain[2] != 0.0
    all_six = build_rve(bar_force=1e-8, free=(), periodic=periodic, options=TIGHT).solve_strain(state.strain)
    assert relative(all_six.first_piola, state.first_piola) < 1e-8
    assert all_six.energy < build_rve(bar_force=1e-8, free=(), periodic=periodic).solve_strain(IN_PLANE).energy


def test_bulk_tangent_has_cubic_symmetry():
    C = tangent_of(build_rve(bar_force=1e-8, periodic=BULK, free=(), options=TIGHT).solve_strain(np.zeros(6)))
    expected = np.zeros((6, 6))
    expected[:3, :3] = C[0, 1]
    expected[[0, 1, 2], [0, 1, 2]] = C[0, 0]
    expected[[3, 4, 5], [3, 4, 5]] = C[3, 3]
    np.testing.assert_allclose(C, expected, atol=1e-9 * np.abs(C).max())


def test_sheet_tangent_has_tetragonal_symmetry():
    C = tangent_of(build_rve(bar_force=1e-8, free=(), options=TIGHT).solve_strain(np.zeros(6)))
    swap = [1, 0, 2, 4, 3, 5]  # x and y change places
    np.testing.assert_allclose(C, C[np.ix_(swap, swap)], atol=1e-9 * np.abs(C).max())
    for flip in ([1, 1, 1, -1, -1, 1], [1, 1, 1, 1, -1, -1]):  # mirrored in z, in x
        np.testing.assert_allclose(C, C * np.outer(flip, flip), atol=1e-9 * np.abs(C).max())


def test_prestress_alone_stresses_nothing():
    for periodic in (SHEET, BULK):
        state = build_rve(bar_force=1e-8, periodic=periodic, free=()).solve_strain(np.zeros(6))
        assert np.abs(state.first_piola).max() < 1e-9 * state.energy


def test_stiffness_grows_with_the_bar_force():
    strain = 1e-3 * np.eye(6)[1]
    stress = [to_mandel(build_rve(bar_force=f).solve_strain(strain).cauchy)[1] for f in (1e-9, 1e-8, 1e-7)]
    assert 4.0 < stress[1] / stress[0] < 10.0
    assert 4.0 < stress[2] / stress[1] < 10.0  # less than in proportion


@pytest.mark.parametrize(("periodic", "free"), [(SHEET, ("zz", "yz", "xz")), (SHEET, ()), (BULK, ("xx", "xy"))])
def test_inertia_counts_constraints_and_free_strains(periodic, free):
    """Negative pivots: those of the dense second derivative on the moves that nodes and H may make together."""
    newton = build_rve(bar_force=1e-8, periodic=periodic, free=free).solver.newton
    system, border = newton.system, newton.border
    length = system.structure.size[0]
    moves = np.zeros((system.size, len(newton.free) + border.macro.shape[1]))
    moves[newton.free, np.arange(len(newton.free))] = length  # so that all entries are of one size
    moves[system.nodal_size :, len(newton.free) :] = border.macro
    if len(border.constraint):
        moves = moves @ null_space(border.constraint @ moves)
    counts = []
    for amplitude in (0.0, 2e-3, 1e-2, 3e-2):
        y = amplitude * np.random.default_rng(3).normal(size=system.size)
        y[: system.nodal_size] *= length / 4.0
        state = system.state(y)
        values = np.linalg.eigvalsh(moves.T @ system.tangent_product(state, moves))
        counts.append(newton.tangent(state).negative_pivots)
        assert counts[-1] == (values < 0.0).sum()
    assert counts[0] == 0
    assert counts[-1] > 5


def test_the_rate_is_the_derivative_of_the_unknowns_and_saves_a_factorisation():
    rve = build_rve(bar_force=1e-8, free=(), options=TIGHT)
    state = rve.solve_strain(ALL_SIX)
    assert state.rate is not None
    step = 1e-5 * IN_PLANE / np.linalg.norm(IN_PLANE)
    y, force = rve.solver.y, rve.solver.force
    ends = []
    for sign in (1.0, -1.0):
        rve.solver.move_to(y, force)
        rve.solve_strain(ALL_SIX + sign * step)
        ends.append(rve.solver.y)
    assert relative(0.5 * (ends[0] - ends[1]), state.rate @ step) < 1e-5
    found = []
    for rate in (None, state.rate, -3.0 * state.rate):  # a bad guess costs iterations, not the answer
        rve.solver.move_to(y, force)
        found.append(rve.solve_strain(ALL_SIX + 100.0 * step, rate=rate))
    plain, known, misled = found
    assert known.equilibrium.factorisations == plain.equilibrium.factorisations - 1
    for other in (known, misled):
        assert relative(other.first_piola, plain.first_piola) < 1e-9
        assert relative(other.strain, plain.strain) < 1e-14


def test_failure_leaves_the_last_state():
    rve = build_rve(bar_force=1e-8, options=NewtonOptions(max_iterations=1))
    with pytest.raises(ConvergenceError, match="stopped at"):
        rve.solve_strain(10.0 * IN_PLANE)
    H = rve.solver.y[-9:].reshape(3, 3)
    assert np.abs(H).max() < np.abs(10.0 * IN_PLANE).max()
    rve.reset()
    assert rve.solve_strain(np.zeros(6)).equilibrium.iterations == 0


@pytest.mark.parametrize("strain", [np.zeros(5), np.full(6, np.nan), np.zeros((3, 3))])
def test_bad_strain(strain):
    with pytest.raises(InputError, match="strain: expected six finite Mandel components"):
        build_rve(bar_force=1e-8).solve_strain(strain)


def test_bad_arguments():
    with pytest.raises(InputError, match=r"free: expected strain components among xx, .*, got 'zx'"):
        build_rve(bar_force=1e-8, free=("zx",))
    with pytest.raises(InputError, match="bar_force: expected positive forces"):
        build_rve(bar_force=-1e-8)
    with pytest.raises(InputError, match="cells: expected three counts"):
        build_rve(bar_force=1e-8, blocks=(0, 1, 1))
    with pytest.raises(InputError, match="structure: expected at least one periodic axis"):
        RVE(lattice(box_cells(2, 2, 2)))
    with pytest.raises(InputError, match="turned inside out"):
        build_rve(bar_force=1e-8, free=()).solve_gradient(-1.5 * np.eye(3))
