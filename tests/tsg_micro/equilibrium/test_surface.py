"""The surface of a body: volume in closed form, derivatives, and a pressure that neither pushes nor turns the body."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from tsg_micro.cells.lattice import box_cells, lattice, spheroid_cells
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import force_density_of_owners, prestressed
from tsg_micro.cells.structure import member_vectors
from tsg_micro.cells.truncated_octahedron import unit_cell
from tsg_micro.continuum.homogenise import block_fields, kirchhoff_stress
from tsg_micro.continuum.radial_profiles import (
    bar_force_profile,
    block_radius,
    core_over_rim,
    radial_profile,
    radial_stress,
)
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.equilibrium.load_path import EquilibriumSolver
from tsg_micro.equilibrium.members import NodalPattern
from tsg_micro.equilibrium.newton import NewtonOptions
from tsg_micro.equilibrium.pressure import PressurisedSystem
from tsg_micro.equilibrium.rigid import rigid_border
from tsg_micro.equilibrium.surface import enclosed_volume, outer_surface, pair_vectors, volume_gradient
from tsg_micro.equilibrium.tangent import lowest_stiffness

H = CellParameters().height
BODIES = {
    "cell": box_cells(1, 1, 1),
    "box": box_cells(3, 2, 4),
    "ball": spheroid_cells(1.5),
    "round": spheroid_cells(2),
}


@pytest.fixture(params=BODIES)
def body(request):
    """A body, its surface, and its nodes in cell heights."""
    structure = lattice(BODIES[request.param])
    return structure, outer_surface(structure), structure.nodes / H


def moved(x, rng, amount=0.05):
    return x + amount * rng.normal(size=x.shape)


def test_surface_is_closed(body):
    """Every side of a polygon is passed once in each direction, and Euler's formula holds."""
    _, surface, _ = body
    sides = np.concatenate([np.stack([p, np.roll(p, -1, axis=1)], axis=-1).reshape(-1, 2) for p in surface.polygons])
    there = {tuple(side) for side in sides.tolist()}
    assert len(there) == len(sides)
    assert there == {(j, i) for i, j in there}
    faces = sum(len(p) for p in surface.polygons)
    assert len(surface.nodes) - len(sides) // 2 + faces == 2
    assert len(surface.nodes) == 4 * len(surface.squares)


def test_volume_of_a_cell():
    """Twelve nodes up to symmetry: six squares of area 2 r^2 at distance 1, eight fans over the hexagons between."""
    unit = unit_cell(0.5)
    squares = 6 * (2 * 0.5**2) / 3.0
    corner = np.array([1.0, 1.0, 1.0])
    near = unit.nodes[np.argsort(-(unit.nodes @ corner))[:6]]
    flat = near - np.outer(near @ corner, corner) / 3.0
    start = flat[0] / np.linalg.norm(flat[0])
    angle = np.arctan2(flat @ np.cross(corner, start) / np.sqrt(3.0), flat @ start)
    ring = near[np.argsort(angle)]
    fan = sum(np.linalg.det([ring.mean(axis=0), ring[i], ring[(i + 1) % 6]]) for i in range(6)) / 6.0
    structure = lattice(BODIES["cell"])
    expected = (squares + 8 * fan) * (H / 2) ** 3
    assert enclosed_volume(outer_surface(structure), structure.nodes) == pytest.approx(expected, rel=1e-12)


def test_volume_of_boxes():
    """What is left out of n^3 voxels grows with 8 corners and with edges of length n - 1, and with nothing else."""
    left_out = []
    for n in (1, 2, 3, 5):
        structure = lattice(box_cells(n, n, n))
        left_out.append(n**3 - enclosed_volume(outer_surface(structure), structure.nodes) / H**3)
    corners, edge = left_out[0], left_out[1] - left_out[0]
    np.testing.assert_allclose(left_out[2:], [corners + 2 * edge, corners + 4 * edge], rtol=1e-11)
    assert 0.0 < edge / 12 < 0.125  # less than the prism between the midlines of the faces


def test_volume_of_the_spheroid_of_the_paper():
    structure = lattice(spheroid_cells(5))
    surface = outer_surface(structure)
    assert len(surface.squares) == 1920  # 6 times the 4 x 80 cells of its shadow
    assert enclosed_volume(surface, structure.nodes) == pytest.approx(4416 * H**3, rel=0.005)


def test_volume_under_affine_maps(body, rng):
    _, surface, x = body
    x, A = moved(x, rng), np.eye(3) + 0.3 * rng.normal(size=(3, 3))
    expected = np.linalg.det(A) * enclosed_volume(surface, x)
    assert enclosed_volume(surface, x @ A.T + [3.0, -1.0, 2.0]) == pytest.approx(expected, rel=1e-10)


def test_gradient_and_second_derivative_against_differences(body, rng):
    _, surface, x = body
    x, d = moved(x, rng), rng.normal(size=x.shape)
    gradient = volume_gradient(surface, x)
    for step in (1e-2, 1e-3):  # V is cubic: what a difference lacks is the third order alone
        ahead, back = (enclosed_volume(surface, x + s * step * d) for s in (1, -1))
        assert (ahead - back) / (2 * step) == pytest.approx((gradient * d).sum(), abs=2e2 * step**2 * len(x) ** 0.5)
    w, (i, j) = pair_vectors(surface, x), surface.pairs.T
    product = np.zeros_like(x)
    np.add.at(product, i, np.cross(w, d[j]))
    np.add.at(product, j, np.cross(d[i], w))
    # exact: the gradient is quadratic
    change = volume_gradient(surface, x + 0.1 * d) - volume_gradient(surface, x - 0.1 * d)
    np.testing.assert_allclose(change / 0.2, product, atol=1e-11 * max(1.0, np.abs(x).max()))


def test_pressure_has_no_resultant_no_moment_and_a_hydrostatic_virial(body, rng):
    _, surface, x = body
    x = moved(x, rng, 0.1)
    force = -volume_gradient(surface, x)
    scale = np.abs(force).max()
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * scale * len(x)
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-12 * scale * len(x)
    np.testing.assert_allclose(x.T @ force, -enclosed_volume(surface, x) * np.eye(3), atol=1e-11 * len(x))


@pytest.fixture
def ball(cell):
    """A ball of 8 blocks with a bar force of its own for each cell, and its surface."""
    raw = lattice(BODIES["ball"], cell)
    force = 1e-8 * (1.0 + np.arange(len(raw.cells)) / len(raw.cells))
    return prestressed(raw, cell, force), outer_surface(raw)


def test_tangent_under_pressure(ball, rng):
    """The product, the assembled matrix and differences of the gradient are one; the energy has that gradient."""
    structure, surface = ball
    system = PressurisedSystem(structure, surface)
    system.pressure = 300.0
    y = np.zeros(system.size)
    y[: system.nodal_size] = 1e-7 * rng.normal(size=system.nodal_size)
    d = np.zeros(system.size)
    d[: system.nodal_size] = rng.normal(size=system.nodal_size)
    state = system.state(y)
    product = system.tangent_product(state, d[:, None])[:, 0]
    step = 1e-11
    change = system.gradient(system.state(y + step * d)) - system.gradient(system.state(y - step * d))
    np.testing.assert_allclose(change / (2 * step), product, atol=1e-5 * np.abs(product).max())
    members_alone = super(PressurisedSystem, system).tangent_product(state, d[:, None])[:, 0]
    assert np.abs(product - members_alone).max() > 1e-4 * np.abs(product).max()
    pattern = NodalPattern(structure, np.ones(system.nodal_size, dtype=bool), system.pairs)
    values = pattern.assemble(system.member_blocks(state), system.pair_blocks(state))
    upper = sp.csr_array((values, pattern.indices, pattern.indptr), shape=(pattern.size, pattern.size))
    full = upper + upper.T - sp.diags_array(upper.diagonal())
    np.testing.assert_allclose(full @ d[:-9], product[:-9], atol=1e-12 * np.abs(product).max())
    slope = (system.energy(system.state(y + step * d)) - system.energy(system.state(y - step * d))) / (2 * step)
    assert slope == pytest.approx(system.gradient(state) @ d, rel=1e-5)


@pytest.fixture
def pressed(ball):
    structure, surface = ball
    fixed = np.zeros(structure.nodes.shape, dtype=bool)
    return EquilibriumSolver(structure, fixed=fixed, border=rigid_border(structure), surface=surface)


def test_free_body_under_pressure(pressed, ball):
    """Stable, no force keeps it, it neither drifts nor turns, and its mean stress is -p exactly."""
    structure, surface = ball
    result = pressed.solve(pressure=200.0, stable=True)
    assert (result.residual < 1e-10, result.negative_pivots) == (True, 0)
    mean_force = np.abs(result.members.force).mean()
    assert np.abs(result.reaction).max() < 1e-9 * mean_force
    X = structure.nodes - structure.nodes.mean(axis=0)
    assert np.abs(result.displacement.mean(axis=0)).max() < 1e-12 * X.max()
    assert np.abs(np.cross(X, result.displacement).mean(axis=0)).max() < 1e-12 * X.max() ** 2
    volume = enclosed_volume(surface, structure.nodes + result.displacement)
    assert volume < 0.97 * enclosed_volume(surface, structure.nodes)
    np.testing.assert_allclose(kirchhoff_stress(result.members, volume), -200.0 * np.eye(3), atol=1e-7)
    assert lowest_stiffness(pressed.tangent()) > 0.0


def test_work_of_the_pressure_is_the_stored_energy(pressed, ball):
    """Members' energy gained = integral of -p dV, by Simpson's rule over the load."""
    structure, surface = ball
    levels = np.linspace(0.0, 100.0, 9)
    results = [pressed.solve(pressure=level) for level in levels]
    volume = np.array([enclosed_volume(surface, structure.nodes + result.displacement) for result in results])
    stored = [result.energy - level * v for result, level, v in zip(results, levels, volume, strict=True)]
    simpson = np.array([1, 4, 2, 4, 2, 4, 2, 4, 1]) @ volume * (levels[1] / 3.0)
    assert stored[-1] - stored[0] == pytest.approx(simpson - levels[-1] * volume[-1], rel=1e-3)


def test_pressure_does_not_depend_on_the_steps_and_goes_back(pressed, ball):
    structure, surface = ball
    there = pressed.solve(pressure=150.0, steps=3, stable=True)
    fixed = np.zeros(structure.nodes.shape, dtype=bool)
    other = EquilibriumSolver(structure, fixed=fixed, border=rigid_border(structure), surface=surface)
    once = other.solve(pressure=150.0, stable=True)
    np.testing.assert_allclose(there.displacement, once.displacement, atol=1e-7 * np.abs(once.displacement).max())
    back = pressed.solve(pressure=0.0)
    assert np.abs(back.displacement).max() < 1e-6 * np.abs(once.displacement).max()


def test_lost_equilibrium_keeps_the_last_one(ball):
    structure, surface = ball
    options = NewtonOptions(max_iterations=15, smallest_part=0.25)
    fixed = np.zeros(structure.nodes.shape, dtype=bool)
    solver = EquilibriumSolver(structure, fixed=fixed, border=rigid_border(structure), surface=surface, options=options)
    with pytest.raises(ConvergenceError, match="of the load"):
        solver.solve(pressure=20000.0, steps=20)
    reached = solver.system.pressure
    assert 0.0 <= reached < 10000.0
    again = solver.solve()
    assert again.residual < 1e-10
    assert solver.system.pressure == reached


def test_radial_stress_of_a_homogeneous_ball_is_the_pressure(cell):
    """Blocks of one bar force, no load: none; under pressure: near -p in each, and -p V in the sum."""
    raw = lattice(BODIES["round"], cell)
    structure, surface = prestressed(raw, cell, 5e-8), outer_surface(raw)
    prestress = force_density_of_owners(structure, cell, 5e-8) * np.linalg.norm(member_vectors(raw), axis=1)[:, None]
    fixed = np.zeros(raw.nodes.shape, dtype=bool)
    solver = EquilibriumSolver(structure, fixed=fixed, border=rigid_border(raw), surface=surface)
    rest = solver.solve()
    before = radial_stress(structure, rest.displacement, rest.members, prestress)
    assert np.abs(before.cauchy).max() < 1e-9
    result = solver.solve(pressure=100.0)
    after = radial_stress(structure, result.displacement, result.members, prestress)
    np.testing.assert_allclose(after.cauchy, -100.0, rtol=0.1)
    np.testing.assert_allclose(after.halves, after.cauchy, rtol=1e-12)  # neighbours are alike
    np.testing.assert_allclose(after.kirchhoff, after.J * after.cauchy)
    np.testing.assert_allclose(block_fields(structure, result.displacement, result.members).F[:, 0, 0], 0.99, atol=0.02)
    r = block_radius(structure, 4 * H)
    np.testing.assert_allclose(np.unique(np.round(r, 12)), np.sqrt([0.75, 2.75]) / 2.0)
    assert core_over_rim(r, after.cauchy) == pytest.approx(1.0, abs=0.1)


def test_prestress_alone_is_no_stress_unless_shared_tendons_are_halved(cell):
    raw = lattice(BODIES["round"], cell)
    force = bar_force_profile(block_radius(raw, 4 * H), profile="exponential", f_max=5e-8, decay=2.0)[raw.cell_block]
    structure = prestressed(raw, cell, force)
    prestress = force_density_of_owners(raw, cell, force) * np.linalg.norm(member_vectors(raw), axis=1)[:, None]
    system = PressurisedSystem(structure, outer_surface(raw))
    stress = radial_stress(structure, np.zeros_like(raw.nodes), system.state(np.zeros(system.size)), prestress)
    assert np.abs(stress.cauchy).max() < 1e-9
    assert np.abs(stress.halves).max() > 10.0


def test_profiles():
    r = np.array([0.0, 0.5, 1.0])
    of = {
        name: bar_force_profile(r, profile=name, f_max=2.0, decay=3.0) for name in ("exponential", "linear", "constant")
    }
    np.testing.assert_allclose(of["exponential"], 2.0 * np.exp([0.0, -1.5, -3.0]))
    np.testing.assert_allclose(of["linear"], [2.0, 1.0 + np.exp(-3.0), 2.0 * np.exp(-3.0)])
    np.testing.assert_allclose(of["constant"], 2.0)
    shells = radial_profile(np.array([0.1, 0.2, 0.9, 1.0]), np.array([1.0, 3.0, 5.0, 5.0]), shells=4)
    assert shells.mean.tolist() == [2.0, 5.0]
    assert shells.std.tolist() == [1.0, 0.0]
    assert shells.count.tolist() == [2, 2]
    assert core_over_rim(np.array([0.1, 0.2, 0.9, 1.0]), np.array([1.0, 3.0, 5.0, 5.0])) == pytest.approx(0.4)


def test_bad_input(ball):
    structure, _ = ball
    with pytest.raises(InputError, match="touch along an edge only"):
        outer_surface(lattice(np.array([[0, 0, 0], [1, 1, 0]])))
    with pytest.raises(InputError, match="without periodic axes"):
        outer_surface(lattice(box_cells(2, 2, 2), periodic=(True, False, False)))
    fixed = np.zeros(structure.nodes.shape, dtype=bool)
    with pytest.raises(InputError, match="fixed: expected some"):
        EquilibriumSolver(structure, fixed=fixed)
    solver = EquilibriumSolver(structure, fixed=fixed, border=rigid_border(structure))
    with pytest.raises(InputError, match="a surface for it to act on"):
        solver.solve(pressure=1.0)
    for name, profile, f_max, decay in (
        ("profile", "cubic", 1.0, 1.0),
        ("f_max", "linear", -1.0, 1.0),
        ("decay", "linear", 1.0, np.nan),
    ):
        with pytest.raises(InputError, match=name):
            bar_force_profile(np.zeros(1), profile=profile, f_max=f_max, decay=decay)
