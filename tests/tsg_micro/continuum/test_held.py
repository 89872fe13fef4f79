"""RVEs with held axes: tangents by differences, a clamped strip as a second route, symmetry, and their data."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve import RVE
from tsg_micro.continuum.rve_law import RVELaw
from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import SHEET, RVESpec
from tsg_micro.continuum.sampling import BOXES, join_paths, sample_paths
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import from_mandel, to_mandel
from tsg_micro.equilibrium.load_path import EquilibriumSolver
from tsg_micro.equilibrium.newton import NewtonOptions

TIGHT = NewtonOptions(tolerance=1e-12)
TISSUE = Tissue(bar_force=1e-8)
INSIDE = RVESpec(TISSUE, free=())
CLAMP, CORNER = INSIDE.at(("", "held", "")), INSIDE.at(("free", "held", ""))
BULK = RVESpec.of_kind("bulk", TISSUE)
ALL_SIX = to_mandel([[0.002, 0.003, -0.001], [0.003, 0.03, 0.002], [-0.001, 0.002, -0.004]])


def make(spec, free=()):
    structure = spec.tissue.box(tuple(2 * n for n in spec.blocks), periodic=spec.periodic)
    return RVE(structure, free=free, held=spec.held, options=TIGHT)


def relative(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


@pytest.mark.parametrize("spec", [CLAMP, CORNER, BULK.at(("", "held", ""))], ids=["clamp", "corner", "bulk"])
def test_tangents_are_derivatives(spec):
    """P of the energy, both tangents of P and of the support stress."""
    rve = make(spec)
    state = rve.solve_strain(ALL_SIX)
    stress, support, power, step = [], [], [], 1e-6
    for direction in np.eye(6):
        ends = [rve.solve_strain(ALL_SIX + sign * step * direction) for sign in (1, -1)]
        stress.append(to_mandel(ends[0].first_piola - ends[1].first_piola) / (2 * step))
        support.append(to_mandel(ends[0].support_stress - ends[1].support_stress) / (2 * step))
        power.append((ends[0].energy - ends[1].energy) / (2 * step))
    assert relative(np.array(power), to_mandel(state.first_piola)) < 1e-5
    assert relative(np.array(stress).T, state.tangent) < 1e-5
    assert relative(np.array(support).T, state.support_tangent) < 1e-5
    np.testing.assert_array_equal(state.tangent, state.tangent.T)


@pytest.mark.parametrize("bar_force", [2e-9, 1e-8, 5e-8])
def test_a_clamped_strip_is_the_second_route(bar_force):
    """Cells between two clamps: the reaction over the area is P_yy, the mean of the members P and the support."""
    spec = RVESpec(Tissue(bar_force=bar_force)).at(("", "held", ""))
    rve = make(spec, free=SHEET)
    state = rve.solve_strain([0, 0.05, 0, 0, 0, 0])
    structure = rve.structure
    nodes, (width, height, thickness) = structure.nodes, structure.size
    top = np.flatnonzero(nodes[:, 1] > height * (1 - 1e-9))
    fixed = np.zeros(nodes.shape, dtype=bool)
    fixed[top] = fixed[nodes[:, 1] < height * 1e-9] = True
    moved = np.zeros(nodes.shape)
    moved[top, 1] = 0.05 * height
    strip = EquilibriumSolver(structure, fixed=fixed, options=TIGHT).solve(displacement=moved, H=np.zeros((3, 3)))
    pull = strip.reaction[top].sum(axis=0)[1] / (width * thickness)
    members = strip.members
    ends = nodes[structure.members[:, 1]] - nodes[structure.members[:, 0]] + structure.shift * structure.size
    mean = np.einsum("m,ma,mb->ab", members.force_density, members.vector, ends) / structure.volume
    assert state.first_piola[1, 1] == pytest.approx(pull, rel=1e-8)
    assert relative(state.first_piola + state.support_stress, mean) < 1e-8
    assert state.energy * structure.volume == pytest.approx(strip.energy, rel=1e-8)
    # the clamps carry the thickness, which does no work
    assert abs(state.support_stress[2, 2]) > 0.05 * state.first_piola[1, 1]
    assert np.abs(to_mandel(state.first_piola)[2:5]).max() < 1e-9 * pull


def test_at_rest_nothing_is_carried():
    for spec in (CLAMP, CORNER, BULK.at(("free", "held", ""))):
        state = make(spec).solve_strain(np.zeros(6))
        scale = 1e-9 * np.abs(state.tangent).max()
        assert np.abs(state.first_piola).max() < scale
        assert np.abs(to_mandel(state.support_stress)).max() < 1e-9 * state.energy


@pytest.mark.parametrize("inside", [INSIDE, BULK], ids=["sheet", "bulk"])
def test_a_clamp_across_x_is_one_across_y_turned(inside):
    """The lattice is its mirror image, a cell further along: so it does not matter where the period begins."""
    x, y = (make(inside.at(place)).solve_strain for place in (("held", "", ""), ("", "held", "")))
    swap = [1, 0, 2, 4, 3, 5]
    here, there = y(ALL_SIX), x(ALL_SIX[swap])
    for name in ("first_piola", "support_stress"):
        assert relative(to_mandel(getattr(there, name)), to_mandel(getattr(here, name))[swap]) < 1e-8
    assert relative(there.support_tangent, here.support_tangent[np.ix_(swap, swap)]) < 1e-7


@pytest.mark.parametrize("spec", [CLAMP, CORNER, BULK.at(("", "held", ""))], ids=["clamp", "corner", "bulk"])
def test_a_small_turn_with_the_clamp_stresses_nothing(spec):
    """About axes in the plane of the clamp, to the first order; data are of symmetric H, turned with the body later."""
    rve, stress = make(spec), []
    for angle in (0.004, 0.002):
        R = Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_matrix()
        rve.reset()
        stress.append(np.abs(rve.solve_gradient(R - np.eye(3)).first_piola).max())
    assert stress[0] / stress[1] == pytest.approx(4.0, rel=0.15)


def test_strain_along_a_clamp_rises_from_its_face():
    """Between two clamps a homogeneous medium would have H at half depth, none at the faces, and H as its mean."""
    rve = make(CLAMP)
    structure, system = rve.structure, rve.solver.system
    H = np.zeros(system.size)
    H[system.nodal_size :] = np.diag([0.01, 0.0, 0.02]).ravel()  # z is free across the faces: no member follows H_zz
    change = (system.D @ H).reshape(-1, 3)
    start = structure.nodes[structure.members[:, 0]]
    vector = system.reference
    middle = (start + 0.5 * vector)[:, 1] / structure.size[1]
    np.testing.assert_allclose(change[:, 0], 0.01 * (2 - np.abs(4 * middle - 2)) * vector[:, 0], atol=1e-15)
    np.testing.assert_allclose(change[:, 1:], 0.0, atol=1e-18)


def test_axes_without_an_edge_are_as_before():
    """A sheet's RVE, and one whose place is the inside, are the same."""
    assert INSIDE.at(("", "", "")) == INSIDE == INSIDE.with_axes("periodic periodic free")
    state = make(INSIDE).solve_strain(ALL_SIX)
    assert state.support_stress is None
    assert state.support_tangent is None


def test_an_axis_is_periodic_or_held():
    structure = TISSUE.box((2, 2, 2), periodic=(True, True, False))
    with pytest.raises(InputError, match="held: expected axes that are not periodic"):
        RVE(structure, held=(False, True, False))


PLACES = {
    ("", "held", ""): ((1, 2, 1), (True, False, False), (False, True, False)),
    ("free", "", ""): ((2, 1, 1), (False, True, False), (False, False, False)),
    ("free twice", "held", ""): ((1, 2, 1), (False, False, False), (False, True, False)),
    ("held twice", "", "free"): ((1, 1, 1), (False, True, False), (True, False, False)),
}


@pytest.mark.parametrize("place", PLACES)
def test_the_rve_of_a_place(place):
    spec = INSIDE.at(place)
    assert (spec.blocks, spec.periodic, spec.held) == PLACES[place]
    assert RVESpec.from_parameters(spec.parameters()) == spec
    assert spec.is_edge_of(INSIDE)
    assert not INSIDE.is_edge_of(spec)
    words = [met.replace(" ", "-") or "periodic" for met in place]
    assert INSIDE.with_axes(" ".join([*words[:2], "free"])) == spec


def test_sheet_and_bulk_have_the_same_edges_but_for_their_faces():
    assert BULK.at(("", "", "free twice")).faces == INSIDE.faces
    assert BULK.at(("", "", "free")).blocks == (1, 1, 2)
    assert not BULK.is_edge_of(INSIDE)
    with pytest.raises(InputError, match="kind: expected sheet or bulk, got 'spheroid'"):
        RVESpec.of_kind("spheroid", TISSUE)


@pytest.mark.parametrize(
    ("axes", "text"),
    [
        ("periodic held", "axes: expected three words"),
        ("periodic clamped free", "axes: expected three words of periodic, free, held"),
        ("periodic held held", "axes: expected free along z, as the tissue is there, got 'held'"),
    ],
)
def test_axes_that_are_none(axes, text):
    with pytest.raises(InputError, match=text):
        INSIDE.with_axes(axes)


def test_sampled_adapted_and_asked_by_a_law_the_support_is_one():
    """Sampled, adapted and asked by a law: one support stress, with one tangent."""
    done = sample_paths(CLAMP.build(), dataclasses.replace(BOXES["inplane"], free=()), paths=[0], steps=2, seed=0)
    sampled = join_paths(done, seed=0, parameters=CLAMP.parameters(), versions={})
    source = RVESource(CLAMP).states(sampled.strain, 0 * sampled.strain)
    law = RVELaw(CLAMP.build())
    law.stress_and_tangent(sampled.strain)
    assert sampled.support is not None
    assert source is not None
    assert source.support is not None
    assert np.abs(sampled.support).max() > 10
    np.testing.assert_allclose(source.support, sampled.support, atol=1e-6 * np.abs(sampled.support).max())
    np.testing.assert_allclose(law.support(sampled.strain), sampled.support, atol=1e-6 * np.abs(sampled.support).max())
    assert relative(source.support_tangent, sampled.support_tangent) < 1e-6
    state = make(CLAMP).solve_gradient(from_mandel(sampled.strain[0]))
    np.testing.assert_allclose(to_mandel(state.support_stress), sampled.support[0], rtol=1e-6, atol=1e-5)
