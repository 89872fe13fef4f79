"""Cells that are not the default one: that of docs/CONTRIBUTING.md, and mirror images in other frames.

The expanded octahedron has six bars, 24 tendons and two nodes on every face. The mirror image of the truncated
octahedron is another cell, as that is symmetric under no reflection; braced across its z-faces it is no longer cubic.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tsg_micro.cells.lattice import box_cells, lattice, side_nodes
from tsg_micro.cells.prestress import force_density_of_cells, self_stress, with_self_stress
from tsg_micro.cells.structure import equilibrium_matrix, from_arrays, member_vectors
from tsg_micro.cells.tissue import UNIT_CELLS, Tissue
from tsg_micro.cells.truncated_octahedron import unit_cell
from tsg_micro.cells.unit_cell import BAR, EDGE_TENDON, SQUARE_TENDON, UnitCell
from tsg_micro.continuum.homogenise import block_fields, cell_gradient
from tsg_micro.continuum.response import cell_displacement
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import from_mandel, to_mandel
from tsg_micro.equilibrium.members import MemberSystem
from tsg_micro.equilibrium.surface import enclosed_volume, outer_surface

MIRROR = np.diag([-1, 1, 1])
QUARTER = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
CYCLE = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])


DOC = (Path(__file__).parents[3] / "docs" / "CONTRIBUTING.md").read_text()
NAMES: dict[str, Any] = {}
exec(DOC.split("## A unit cell")[1].split("```python\n")[1].split("```")[0], NAMES)
expanded_octahedron = NAMES["expanded_octahedron"]
del UNIT_CELLS["expanded-octahedron"]


def braced(half_diagonal: float) -> UnitCell:
    """The truncated octahedron with tendons along both diagonals of its two faces across z, without force at rest."""
    unit = unit_cell(half_diagonal)
    at = np.concatenate(unit.faces[2])
    pairs = [(i, j) for i in at for j in at if i < j and (unit.places[i] + unit.places[j])[:2].tolist() == [0, 0]]
    pairs = [(i, j) for i, j in pairs if unit.places[i, 2] == unit.places[j, 2]]
    more = len(pairs)
    return replace(
        unit,
        members=np.concatenate([unit.members, pairs]),
        kind=np.append(unit.kind, np.full(more, SQUARE_TENDON, dtype=np.uint8)),
        force_density=np.append(unit.force_density, np.zeros(more)),
    )


CELLS = {
    "truncated octahedron": unit_cell,
    "its mirror image, turned": lambda r: unit_cell(r, mirrored=True).turned(QUARTER),
    "expanded octahedron": expanded_octahedron,
    "expanded octahedron, turned": lambda r: expanded_octahedron(r).turned(QUARTER),
}


@pytest.fixture(autouse=True)
def known(monkeypatch):
    """All of them can be named in a tissue."""
    for name, make in CELLS.items():
        monkeypatch.setitem(UNIT_CELLS, name, make)


OTHERS = list(CELLS)[1:]


def test_svd_finds_the_self_stress_of_the_expanded_octahedron():
    """By hand: at a node the bar's 4 q_b and the four tendons' 6 q_t vanish together."""
    unit = expanded_octahedron(0.5)
    assert np.bincount(unit.kind).tolist() == [0, 24, 6]
    assert [len(nodes) for sides in unit.faces for nodes in sides] == [2] * 6
    np.testing.assert_allclose(unit.force_density, np.where(unit.bars, -1.0, 2.0 / 3.0), rtol=1e-12)
    assert unit.bar_length == 2.0


def test_svd_finds_the_closed_form_of_the_truncated_octahedron():
    unit = unit_cell(0.4)
    found = with_self_stress(replace(unit, force_density=np.zeros(48)))
    np.testing.assert_allclose(found.force_density, unit.force_density, rtol=1e-12)
    assert found.bar_length == pytest.approx(unit.bar_length, rel=1e-14)


@pytest.mark.parametrize("name", OTHERS)
def test_tiling(name):
    tissue, size = Tissue(unit=name), (2, 3, 2)
    unit, structure = tissue.unit_cell, tissue.lattice(box_cells(*size))
    nodes, members = len(unit.nodes), len(unit.members)
    on_face = len(unit.faces[0][0])
    faces = 3 * 12 - (6 + 4 + 6)
    assert len(structure.nodes) == nodes * 12 - on_face * faces
    shared = (structure.member_cells >= 0).all(axis=1)
    assert len(structure.members) == members * 12 - shared.sum()
    assert shared.sum() == (4 * faces if on_face == 4 else 0)
    assert structure.height == pytest.approx(tissue.cell.height, rel=1e-14)
    np.testing.assert_allclose(np.ptp(structure.nodes, axis=0), structure.size, rtol=1e-14)
    mirror = np.where(structure.cells % 2, -1, 1)[:, None]
    at = (structure.cells[:, None] + 0.5 + 0.5 * unit.nodes * mirror) * tissue.cell.height
    np.testing.assert_allclose(structure.nodes[structure.cell_nodes], at, atol=1e-12 * tissue.cell.height)
    for axis, cells_on_side in enumerate((6, 4, 6)):
        low, high = side_nodes(structure, axis, end="low"), side_nodes(structure, axis, end="high")
        for side, place in ((low, 0.0), (high, structure.size[axis])):
            assert len(side) == on_face * cells_on_side
            np.testing.assert_allclose(structure.nodes[side, axis], place, atol=1e-18)
    bulk = tissue.lattice(box_cells(2, 2, 2), periodic=(True, True, True))
    assert len(bulk.nodes) == 8 * (nodes - 3 * on_face)
    lengths = np.linalg.norm(member_vectors(bulk), axis=1)
    assert all(np.ptp(lengths[bulk.kind == kind]) < 1e-12 * lengths.max() for kind in np.unique(bulk.kind))


@pytest.mark.parametrize(("name", "rank"), list(zip(OTHERS, (47, 29, 29), strict=True)))
def test_rank_of_self_stress(name, rank):
    """One state a cell, and no other in a row of cells."""
    tissue = Tissue(unit=name)
    one = self_stress(tissue.lattice(box_cells(1, 1, 1)))
    assert (one.rank, one.states.shape[1]) == (rank, 1)
    assert one.singular_values[rank - 1] > 1e-3 * one.singular_values[0]
    assert self_stress(tissue.lattice(box_cells(3, 1, 1))).states.shape[1] >= 3


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("periodic", [(False, False, False), (True, True, False), (True, True, True)])
def test_any_field_of_bar_forces_is_in_equilibrium(name, periodic, rng):
    tissue, forces = Tissue(unit=name), rng.uniform(1e-9, 1e-7, size=16)
    structure = tissue.lattice(box_cells(2, 4, 2), periodic=periodic)
    q = force_density_of_cells(structure, tissue.cell, forces)
    t = q * np.linalg.norm(member_vectors(structure), axis=1)
    bars = structure.bars
    np.testing.assert_allclose(-t[bars], forces[structure.member_cells[bars, 0]], rtol=1e-11)
    assert (t[~bars] > 0.0).all()
    if not any(periodic):
        assert np.abs(equilibrium_matrix(structure) @ q).max() < 1e-12 * np.abs(t).max()
    system = MemberSystem(tissue.box((2, 4, 2), periodic=periodic))
    state = system.state(np.zeros(system.size))
    assert np.abs(system.gradient(state)[:-9]).max() < 1e-11 * np.abs(state.force).max()


@pytest.mark.parametrize("name", OTHERS)
def test_affine_motion_is_found_in_every_cell(name, rng):
    tissue = Tissue(unit=name)
    structure = tissue.box((2, 4, 2))
    H = 0.05 * rng.normal(size=(3, 3))
    u = structure.nodes @ H.T
    np.testing.assert_allclose(cell_gradient(structure, u), np.broadcast_to(H, (16, 3, 3)), atol=1e-13)
    system = MemberSystem(structure)
    fields = block_fields(structure, u, system.state(np.append(u.ravel(), np.zeros(9))))
    np.testing.assert_allclose(fields.F, np.broadcast_to(np.eye(3) + H, (2, 3, 3)), atol=1e-13)
    middle = (structure.cells + 0.5) * tissue.cell.height
    np.testing.assert_allclose(cell_displacement(structure, u), middle @ H.T, atol=1e-12 * tissue.cell.height)


def stress_of(unit, strain, monkeypatch, **shape):
    monkeypatch.setitem(UNIT_CELLS, "one", lambda r: unit)
    state = RVESpec(Tissue(unit="one", bar_force=3e-8), **shape).build().solve_strain(to_mandel(strain))
    return state.first_piola, state.tangent


@pytest.mark.parametrize("turn", [MIRROR, QUARTER, CYCLE, -np.eye(3, dtype=int), QUARTER @ MIRROR], ids=str)
@pytest.mark.parametrize("make", [unit_cell, braced, expanded_octahedron])
def test_stress_of_a_turned_cell_is_the_turned_stress(make, turn, monkeypatch):
    """A bulk RVE under any strain: Q sigma(eps) Q^T = sigma'(Q eps Q^T), and its tangent likewise."""
    strain = np.array([[0.02, 0.01, -0.004], [0.01, 0.03, 0.006], [-0.004, 0.006, -0.01]])
    shape = {"periodic": (True, True, True), "free": ()}
    stress, tangent = stress_of(make(0.4), strain, monkeypatch, **shape)
    turned, turned_tangent = stress_of(make(0.4).turned(turn), turn @ strain @ turn.T, monkeypatch, **shape)
    np.testing.assert_allclose(turned, turn @ stress @ turn.T, atol=1e-8 * np.abs(stress).max())
    for one in np.eye(6):
        expected = to_mandel(turn @ from_mandel(tangent @ one) @ turn.T)
        got = turned_tangent @ to_mandel(turn @ from_mandel(one) @ turn.T)
        np.testing.assert_allclose(got, expected, atol=1e-7 * np.abs(tangent).max())


def test_a_braced_cell_has_frames_that_differ(monkeypatch):
    """Else the turned stress would be that of every frame."""
    unit, strain = braced(0.4), np.array([[0.02, 0.01, 0.0], [0.01, 0.0, 0.0], [0.0, 0.0, 0.0]])
    shape = {"periodic": (True, True, True), "free": ()}
    here, _ = stress_of(unit, strain, monkeypatch, **shape)
    there, _ = stress_of(unit.turned(CYCLE), strain, monkeypatch, **shape)
    assert np.abs(there - here).max() > 0.1 * np.abs(here).max()


@pytest.mark.parametrize("make", [braced, expanded_octahedron])
def test_a_sheet_of_turned_cells(make, monkeypatch):
    """Free faces included: what is without stress across z stays so when the sheet is turned about z."""
    strain, unit = np.diag([-0.01, 0.04, 0.0]), make(0.4)
    here, _ = stress_of(unit, strain, monkeypatch)
    turned, _ = stress_of(unit.turned(QUARTER), QUARTER @ strain @ QUARTER.T, monkeypatch)
    np.testing.assert_allclose(turned, QUARTER @ here @ QUARTER.T, atol=1e-8 * np.abs(here).max())
    assert here[1, 1] > 0.0
    assert np.abs(here[2]).max() < 1e-8 * here[1, 1]


@pytest.mark.parametrize("name", OTHERS)
def test_tangent_is_the_derivative_of_the_stress(name, rng):
    rve = RVESpec(Tissue(unit=name), free=()).build()
    strain, change, step = np.array([0.01, 0.02, -0.01, 0.005, 0.0, 0.01]), rng.normal(size=6), 1e-6
    tangent = rve.solve_strain(strain).tangent
    ahead, behind = (to_mandel(rve.solve_strain(strain + s * step * change).first_piola) for s in (1.0, -1.0))
    expected = tangent @ change
    np.testing.assert_allclose((ahead - behind) / (2.0 * step), expected, atol=1e-5 * np.abs(expected).max())


def test_surface_asks_for_square_faces():
    with pytest.raises(InputError, match="structure: expected cells with four nodes on every face"):
        outer_surface(Tissue(unit="expanded octahedron").box((2, 2, 2)))
    volumes = []
    for name in list(CELLS)[:2]:
        structure = Tissue(unit=name).box((2, 4, 2))
        volumes.append(enclosed_volume(outer_surface(structure), structure.nodes))
    assert volumes[1] == pytest.approx(volumes[0], rel=1e-12)


@pytest.mark.parametrize("name", OTHERS)
def test_a_data_set_says_which_cell_it_is_from(name):
    spec = RVESpec(Tissue(unit=name, bar_force=2e-8), periodic=(True, True, True), free=())
    again = RVESpec.from_parameters(spec.parameters())
    assert again == spec
    np.testing.assert_array_equal(again.build().structure.nodes, spec.build().structure.nodes)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"nodes": np.zeros((5, 3))}, "unit cell: expected n nodes and places"),
        ({"per_cell": 7}, "unit cell: expected n nodes and places, m members, an even per_cell"),
        ({"places": np.ones((12, 3), dtype=int)}, r"places: expected distinct ones, \+-2 where a coordinate is \+-1"),
        ({"kind": np.full(30, EDGE_TENDON, dtype=np.uint8), "members": np.array([[0, 1]] * 30)}, "force_density"),
        ({"force_density": np.ones(30)}, "force_density: expected equilibrium"),
        ({"bar_length": 1.0}, "bar_length as the compression of every bar"),
    ],
)
def test_bad_cells(change, text):
    with pytest.raises(InputError, match=text):
        replace(expanded_octahedron(0.5), **change)


def test_bars_belong_to_one_cell_and_no_member_to_four():
    unit = unit_cell(0.5)
    with pytest.raises(InputError, match="tendons only on its faces"):
        replace(unit, kind=np.full(48, BAR, dtype=np.uint8))
    corners = np.array([[x, y, z] for z in (1, -1) for y in (1, -1) for x in (1, -1)])
    with pytest.raises(InputError, match="members: expected none along an edge of the cube"):
        UnitCell(corners * 1.0, corners, 2, np.array([[0, 1]]), np.zeros(1, np.uint8), np.zeros(1), 1.0)
    with pytest.raises(InputError, match="as many nodes on a face as on the opposite one"):
        UnitCell(corners[:1] * 1.0, corners[:1], 2, np.array([[0, 0]]), np.zeros(1, np.uint8), np.zeros(1), 1.0)


def test_what_is_no_lattice_has_no_faces():
    one = np.ones(1)
    rod = from_arrays(np.eye(3)[:2], np.array([[0, 1]]), kind=one.astype(np.uint8), EA=one, rest_length=one)
    with pytest.raises(InputError, match="structure: expected a lattice of cells"):
        side_nodes(replace(rod, cells=np.zeros((1, 3), dtype=int)), 0, end="low")


def test_unknown_cell():
    with pytest.raises(InputError, match=r"tissue, unit: expected one of .*truncated-octahedron, got 'kelvin'"):
        Tissue(unit="kelvin")
    assert lattice(box_cells(1, 1, 1)).unit is unit_cell(0.5)
