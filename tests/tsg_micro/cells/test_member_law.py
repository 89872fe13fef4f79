"""The member law of docs/CONTRIBUTING.md, and ours: derivatives, prestress, an RVE, and the name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tsg_micro.cells.lattice import box_cells
from tsg_micro.cells.laws.linear import Linear, NoCompression
from tsg_micro.cells.member_law import Members, law_as_dict, law_from_dict
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import prestressed
from tsg_micro.cells.structure import member_vectors
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import to_mandel
from tsg_micro.equilibrium.members import MemberSystem

DOC = (Path(__file__).parents[3] / "docs" / "CONTRIBUTING.md").read_text()
NAMES: dict[str, Any] = {"__name__": __name__}
exec(DOC.split("## A member law")[1].split("```python\n")[1].split("```")[0], NAMES)
Exponential = NAMES["Exponential"]

LAWS = [Linear(), NoCompression(), Exponential(), Exponential(3.0)]


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_force_and_stiffness_are_derivatives_of_the_energy(law, rng):
    m = 50
    members = Members(10.0 ** rng.uniform(-6.0, -4.0, m), rng.random(m) < 0.3)
    rest = 1e-5 * rng.uniform(0.5, 1.5, m)
    length = rest * (1.0 + rng.uniform(-0.05, 0.05, m))
    step = 1e-6 * rest
    one = [(rest[i : i + 1], Members(members.EA[i : i + 1], members.bar[i : i + 1])) for i in range(m)]
    energy = [[law.energy(x[i : i + 1], *one[i]) for i in range(m)] for x in (length + step, length - step)]
    force = law.force(length, rest, members)
    slope = (np.array(energy[0]) - energy[1]) / (2.0 * step)
    np.testing.assert_allclose(slope, force, rtol=1e-6, atol=1e-7 * np.abs(force).max())
    change = (law.force(length + step, rest, members) - law.force(length - step, rest, members)) / (2.0 * step)
    np.testing.assert_allclose(change, law.stiffness(length, rest, members), rtol=1e-6)
    assert law.energy(length, rest, members) == pytest.approx(
        sum(law.energy(length[i : i + 1], *one[i]) for i in range(m)), rel=1e-12
    )


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_prestress_puts_the_wanted_force_at_rest(law):
    """Whatever the law, the cells carry the same force densities where they stand."""
    tissue = Tissue(bar_force=3e-8, law=law)
    system = MemberSystem(tissue.box((2, 2, 2), periodic=(True, True, False)))
    state = system.state(np.zeros(system.size))
    bars = system.structure.bars
    np.testing.assert_allclose(state.force[bars], -3e-8, rtol=1e-9)
    linear = MemberSystem(replace(tissue, law=Linear()).box((2, 2, 2), periodic=(True, True, False)))
    expected = linear.state(np.zeros(linear.size)).force_density
    np.testing.assert_allclose(state.force_density, expected, rtol=1e-9)
    assert np.abs(system.gradient(state)[:-9]).max() < 1e-9 * np.abs(state.force).mean()


def test_tangent_of_a_structure_is_the_derivative_of_its_forces(rng):
    system = MemberSystem(Tissue(law=Exponential()).box((2, 2, 2), periodic=(True, True, True)))
    y, direction = 0.01 * rng.normal(size=(2, system.size))
    for vector in (y, direction):
        vector[: system.nodal_size] *= 1e-5
    state, step = system.state(y), 1e-4
    ahead, behind = (system.state(y + s * step * direction) for s in (1.0, -1.0))
    slope = (system.energy(ahead) - system.energy(behind)) / (2.0 * step)
    assert slope == pytest.approx(system.gradient(state) @ direction, rel=1e-6)
    change = (system.gradient(ahead) - system.gradient(behind)) / (2.0 * step)
    product = system.tangent_product(state, direction[:, None])[:, 0]
    for part in (slice(None, system.nodal_size), slice(system.nodal_size, None)):
        np.testing.assert_allclose(change[part], product[part], rtol=0.0, atol=1e-6 * np.abs(product[part]).max())


@pytest.mark.parametrize("law", [NoCompression(), Exponential()], ids=repr)
def test_tangent_of_an_RVE_is_the_derivative_of_its_stress(law, rng):
    rve = RVESpec(Tissue(bar_force=5e-8, law=law), free=()).build()
    strain, change = np.array([0.01, 0.02, -0.01, 0.005, 0.0, 0.01]), rng.normal(size=6)
    tangent = rve.solve_strain(strain).tangent
    step = 1e-6
    ahead = to_mandel(rve.solve_strain(strain + step * change).first_piola)
    behind = to_mandel(rve.solve_strain(strain - step * change).first_piola)
    expected = tangent @ change
    np.testing.assert_allclose((ahead - behind) / (2.0 * step), expected, atol=1e-5 * np.abs(expected).max())


def test_laws_are_different_materials_that_agree_for_small_forces():
    strain = np.array([0.0, 0.08, 0.0, 0.0, 0.0, 0.0])
    stress = {
        law: RVESpec(Tissue(law=law)).build().solve_strain(strain).first_piola[1, 1]
        for law in (Linear(), NoCompression(), Exponential(), Exponential(1e-6))
    }
    assert stress[Exponential()] > 1.01 * stress[Linear()]
    assert stress[Exponential(1e-6)] == pytest.approx(stress[Linear()], rel=1e-6)


def test_slack_is_the_law_without_compression(rng):
    structure = Tissue().box((1, 1, 1))
    y = 0.03 * rng.normal(size=structure.nodes.size + 9)
    y[:-9] *= 1e-5
    systems = MemberSystem(structure, slack=True), MemberSystem(replace(structure, law=NoCompression()))
    one, other = (system.state(y) for system in systems)
    assert (one.stiffness == 0.0).any()
    np.testing.assert_array_equal(one.force, other.force)
    assert systems[0].energy(one) == systems[1].energy(other)


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_a_law_is_written_by_name_and_read_back(law):
    tissue = Tissue(bar_force=2e-8, law=law)
    assert Tissue.from_dict(tissue.as_dict()) == tissue
    assert law_from_dict(law_as_dict(law)) == law


def test_a_law_without_a_name_computes_and_cannot_be_written():
    class Nameless(Linear):
        pass

    tissue = Tissue(law=Nameless())
    assert tissue.box((1, 1, 1)).law is tissue.law
    with pytest.raises(InputError, match="law: expected one that @member_law gave a name, got Nameless"):
        tissue.as_dict()


@pytest.mark.parametrize(
    ("law", "text"),
    [
        ({"name": "cubic"}, "law, name: expected one of .*linear.*, got 'cubic'"),
        ({}, "law, name: expected one of .*linear.*, got None"),
        ("linear", "law, name: expected one of .*, got 'linear'"),
        ({"name": ["linear"]}, "law, name: expected one of"),
        ({"name": "linear", "k": 2.0}, "law: expected some of name, got k"),
        ({"name": "exponential", "k": "two"}, "law, k: expected a number, got 'two'"),
        ({"name": "exponential", "k": True}, "law, k: expected a number, got True"),
    ],
)
def test_bad_laws(law, text):
    with pytest.raises(InputError, match=text):
        Tissue.from_dict({"law": law})


def test_forces_that_a_member_cannot_carry():
    with np.errstate(invalid="ignore"), pytest.raises(InputError, match=r"force_density: expected forces that.* carry"):
        Tissue(bar_force=5e-8, law=Exponential(300.0)).box((1, 1, 1))  # no length has that compression
    structure = Tissue(law=NoCompression()).lattice(box_cells(1, 1, 1))
    length = np.linalg.norm(member_vectors(structure), axis=1)
    with pytest.raises(InputError, match="force_density: expected no compression in the tendons"):
        structure.law.rest_length(length, np.full(len(length), -1e-9), structure.material)
    cell = CellParameters()
    assert prestressed(structure, cell, 1e-8).law == NoCompression()
