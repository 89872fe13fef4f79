"""Bodies under any load and of any tissue: stress from the energy, scaling of lengths, a path taken up again."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tsg_micro.bodies.cell import indent_cell
from tsg_micro.bodies.sheet import STRETCH, ClampedSheet, Sheet, stretch_sheet
from tsg_micro.bodies.sheet_means import cell_strain, row_balance
from tsg_micro.bodies.spheroid import build_spheroid, compress_spheroid
from tsg_micro.cells.laws.linear import LINEAR, NoCompression
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.tissue import UNIT_CELLS, Tissue
from tsg_micro.cells.truncated_octahedron import unit_cell
from tsg_micro.continuum.homogenise import block_fields
from tsg_micro.continuum.response import compressed_tendons
from tsg_micro.data.errors import InputError

SHEAR = (1.0, 0.0, 0.0)
MOTIONS = [STRETCH, SHEAR, (0.0, 0.0, 1.0), (0.48, 0.6, 0.64)]
TISSUE = Tissue(CellParameters(half_diagonal=0.45, E_tendon=8e6), 1.5e-8)
FACTOR = 1.7
LARGER = Tissue(
    dataclasses.replace(
        TISSUE.cell,
        **{name: FACTOR * getattr(TISSUE.cell, name) for name in ("height", "d_bar", "d_tendon")},
    ),
    FACTOR**2 * TISSUE.bar_force,
)
"""All lengths times FACTOR, all stresses the same."""


@pytest.mark.parametrize("motion", MOTIONS)
def test_nominal_stress_is_the_slope_of_the_energy_and_the_modulus_that_of_the_stress(motion):
    body = ClampedSheet(Sheet((2, 1), tissue=TISSUE), motion)
    below, above = (body.load(0.03 + step) for step in (-1e-5, 1e-5))
    slope = (above.state.energy - below.state.energy) / 2e-5
    at = body.load(0.03)
    assert at.nominal_stress == pytest.approx(slope / (body.area * body.height), rel=1e-5)
    modulus = (above.nominal_stress - below.nominal_stress) / 2e-5
    assert body.tangent_modulus() == pytest.approx(modulus, rel=1e-4)


@pytest.mark.parametrize("motion", MOTIONS)
def test_every_row_carries_the_stress_along_the_motion(motion):
    body = ClampedSheet(Sheet((2, 3)), motion)
    at = body.load(0.04)
    fields = block_fields(body.structure, at.state.displacement, body.members)
    assert row_balance(body.structure, fields, motion, at.nominal_stress) < 1e-8
    assert row_balance(body.structure, fields, motion, 1.01 * at.nominal_stress) == pytest.approx(0.01 / 1.01, rel=1e-4)


def test_a_path_taken_up_again_ends_where_the_other_does():
    whole, later = (ClampedSheet(Sheet((2, 1)), SHEAR) for _ in range(2))
    half = whole.load(0.03)
    later.resume(half.state.displacement)
    a, b = whole.load(0.06), later.load(0.06)
    assert b.nominal_stress == pytest.approx(a.nominal_stress, rel=1e-9)
    np.testing.assert_allclose(b.state.displacement, a.state.displacement, rtol=0, atol=1e-9 * 40e-6)


def test_a_flat_sheet_needs_no_force_to_be_flat():
    free, flat = (ClampedSheet(Sheet((2, 2), flat=held)) for held in (False, True))
    a, b = free.load(0.05), flat.load(0.05)
    assert b.nominal_stress == pytest.approx(a.nominal_stress, rel=1e-9)
    assert flat.midplane_force() < 1e-9
    assert not b.state.displacement[flat.middle, 2].any()
    assert flat.dofs < free.dofs == Sheet((2, 2)).unknowns
    with pytest.raises(InputError, match="flat: expected an even number of layers, with nodes between them, got 3"):
        Sheet((2, 2), layers=3, flat=True)


def test_the_mirror_image_of_a_cell_answers_alike(monkeypatch):
    monkeypatch.setitem(UNIT_CELLS, "mirrored", lambda r: unit_cell(r, mirrored=True))
    other = dataclasses.replace(TISSUE, unit="mirrored")
    pressed, mirrored = (indent_cell(tissue, [1e-9, 3e-9]) for tissue in (TISSUE, other))
    np.testing.assert_allclose(mirrored.displacement, pressed.displacement, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(mirrored.twist_angle, pressed.twist_angle, rtol=1e-9)
    # seen from below, a sheet of one layer is that of the mirror images; one of two layers is its own mirror image
    a, b = (ClampedSheet(Sheet((2, 1), 1, tissue), SHEAR).load(0.05) for tissue in (TISSUE, other))
    assert b.nominal_stress == pytest.approx(a.nominal_stress, rel=1e-9)


def test_the_law_of_the_members_is_that_of_the_tissue():
    """Pressed together a sheet has tendons under compression, but none where they cannot carry it."""
    linear, slack = (
        ClampedSheet(Sheet((2, 1), 1, dataclasses.replace(TISSUE, law=law))) for law in (LINEAR, NoCompression())
    )
    stress = [body.load(-0.15).nominal_stress for body in (linear, slack)]
    assert compressed_tendons(linear.structure, linear.members) > 0
    assert compressed_tendons(slack.structure, slack.members) == 0
    assert stress[0] < stress[1] < 0.0


def test_larger_cells_of_the_same_shape_have_the_same_stress():
    small, large = (stretch_sheet(Sheet((2, 1), 1, tissue), [0.05, 0.1]) for tissue in (TISSUE, LARGER))
    for name in ("nominal_stress", "tangent_modulus"):
        assert large.column(name)[1:] == pytest.approx(small.column(name)[1:], rel=1e-7)
    a, b = cell_strain(small), cell_strain(large)
    np.testing.assert_allclose(b.midpoint, FACTOR * a.midpoint, rtol=1e-12)
    np.testing.assert_allclose(b.strain, a.strain, rtol=0, atol=1e-9)
    assert large.edge_contraction == pytest.approx(FACTOR * small.edge_contraction, rel=1e-7)

    forces = np.array([1e-9, 3e-9])
    pressed, deeper = indent_cell(TISSUE, forces), indent_cell(LARGER, FACTOR**2 * forces)
    assert deeper.apparent_modulus == pytest.approx(pressed.apparent_modulus, rel=1e-7)
    np.testing.assert_allclose(deeper.displacement, FACTOR * pressed.displacement, rtol=1e-7, atol=1e-18)
    np.testing.assert_allclose(deeper.twist_angle, pressed.twist_angle, rtol=1e-9)

    balls = [build_spheroid(tissue, radius=1.0, profile="linear", decay=1.0) for tissue in (TISSUE, LARGER)]
    ends = [compress_spheroid(ball, "pressure", np.array([20.0, 40.0])).records[-1] for ball in balls]
    assert [end.level for end in ends] == [40.0, 40.0]
    assert [end.mean_pressure for end in ends] == pytest.approx([40.0, 40.0], rel=1e-6)
    np.testing.assert_allclose(ends[1].stress.cauchy, ends[0].stress.cauchy, rtol=1e-6)
    assert ends[1].volume == pytest.approx(FACTOR**3 * ends[0].volume, rel=1e-8)
