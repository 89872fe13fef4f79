"""``tsgdd monolayer`` at small size: balance, stiffening, strain of the cells, independence of the load steps."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import h5py
import meshio
import numpy as np
import pytest

from workflows.runs.monolayer import monolayer

SMALL = ("--blocks", 4, 2)


@pytest.fixture(scope="module")
def sheet(tmp_path_factory):
    """4 x 2 blocks to 25 %, with every figure."""
    folder = tmp_path_factory.mktemp("sheet")
    monolayer(folder, blocks=(4, 2), steps=5, write_every=2, convergence=[(2, 1), (3, 2)], band=[1e-9, 5e-8])
    return folder


@pytest.fixture
def run(tsgdd, read_summary, tmp_path):
    def start(*options):
        done = tsgdd("monolayer", *options, "--no-plots", "--out", tmp_path)
        assert done.code == 0, done.err
        return read_summary(tmp_path)

    return start


def test_curve_stiffens(sheet, read_summary):
    summary = read_summary(sheet)
    strain, stress, modulus = (np.array(summary[name]) for name in ("strain", "nominal_stress", "tangent_modulus"))
    np.testing.assert_allclose(strain, np.linspace(0.0, 0.25, 6), rtol=1e-12)
    assert abs(stress[0]) < 1e-6
    assert (np.diff(stress, n=2) > 0.0).all()
    assert (np.diff(modulus) > 0.0).all()
    assert 700 < stress[-1] < 1300
    # the tangent lies between the chords on its two sides
    chord = np.diff(stress) / np.diff(strain)
    assert (modulus[:-1] < chord).all()
    assert (chord < modulus[1:]).all()
    assert summary["compressed_tendons"] == [0] * 6
    assert summary["negative_pivots"] == [0] * 6
    assert summary["cells"] == 32
    assert summary["residual"] < 1e-9
    assert 0.0 < summary["edge_contraction"] < 0.1 * 80e-6
    assert summary["modulus_ratio"] == pytest.approx(modulus[0] / summary["cell_apparent_modulus"])
    assert summary["modulus_ratio_at_full_strain"] == pytest.approx(modulus[-1] / summary["cell_apparent_modulus"])


def test_every_cut_carries_the_stress(sheet, read_summary):
    sets = ET.parse(sheet / "monolayer.pvd").getroot().findall("Collection/DataSet")
    assert [float(entry.attrib["timestep"]) for entry in sets] == [0, 2, 4, 5]
    mesh = meshio.read(sheet / sets[-1].attrib["file"])
    lines = mesh.cells[0].data
    begin, end = mesh.points[lines].transpose(1, 0, 2)
    below, above = (mesh.points - mesh.point_data["displacement"])[lines].transpose(1, 0, 2)[..., 1]
    pull = mesh.cell_data["force"][0] / np.linalg.norm(end - begin, axis=1)
    for height in (8e-6, 20.5e-6, 33e-6):  # no node is there
        crossing = np.sign(above - height) - np.sign(below - height)
        force = 0.5 * (crossing * pull) @ (end - begin)[:, 1]
        # width times one cell height
        assert force / (80e-6 * 10e-6) == pytest.approx(read_summary(sheet)["nominal_stress"][-1], rel=1e-6)


def test_strain_of_the_cells(sheet, read_summary):
    with h5py.File(sheet / "cells.h5") as file:
        midpoint, strain, moved = (file[name][()] for name in ("midpoint", "strain", "displacement"))
    assert strain.shape == (32, 3, 3)
    np.testing.assert_array_equal(strain, strain.swapaxes(1, 2))
    # along each column the cells' stretches add up to that of the sheet
    for x in np.unique(midpoint[:, 0].round(9)):
        assert strain[np.isclose(midpoint[:, 0], x), 1, 1].mean() == pytest.approx(0.25, abs=1e-9)
    stated = read_summary(sheet)["cell_strain"]
    for name, (i, j) in {"eps_xx": (0, 0), "eps_yy": (1, 1), "eps_xy": (0, 1)}.items():
        row = stated[name]
        assert sum(row["counts"]) == 32
        counts, _ = np.histogram(strain[:, i, j], bins=row["edges"])
        assert counts.tolist() == row["counts"]
        assert row["median"] == pytest.approx(np.median(strain[:, i, j]), abs=1e-12)
    assert stated["eps_xy"]["mean"] == pytest.approx(0.0, abs=1e-9)
    assert -0.15 < stated["eps_xx"]["smallest"] < -0.05  # the free edges, which move inwards
    left = midpoint[:, 0] < 1e-5
    assert (moved[left, 0] > 0.0).all()


def test_other_sizes_and_bar_forces(sheet, read_summary, is_png):
    summary = read_summary(sheet)
    small, larger = summary["convergence"]
    assert (small["blocks"], larger["blocks"]) == ([2, 1], [3, 2])
    for row in (small, larger):
        difference = row["nominal_stress"][-1] / summary["nominal_stress"][-1] - 1.0
        assert row["difference_at_full_strain"] == pytest.approx(difference)
    soft, stiff = summary["band"]
    assert (soft["bar_force"], stiff["bar_force"]) == (1e-9, 5e-8)
    assert soft["nominal_stress"][-1] < summary["nominal_stress"][-1] < stiff["nominal_stress"][-1]
    assert soft["tangent_modulus"][0] < 0.2 * summary["tangent_modulus"][0]
    assert soft["modulus_ratio"] < summary["modulus_ratio"]
    for name in ("stress_strain", "strain", "monolayer", "corner", "sheet", "convergence", "band"):
        assert is_png(sheet / f"{name}.png"), name


def test_curve_does_not_depend_on_the_load_steps(run):
    few, many = (run(*SMALL, "--steps", steps) for steps in (2, 10))
    assert few["nominal_stress"][1:] == pytest.approx(many["nominal_stress"][5::5], rel=1e-7)
    assert few["tangent_modulus"][1:] == pytest.approx(many["tangent_modulus"][5::5], rel=1e-6)


def test_two_layers_are_the_sheet_of_dns(run, tsgdd, read_summary, tmp_path):
    scene = ("--blocks", 2, 1, "--strain", 0.05, "--bar-force", 2e-8)
    one, two = (run(*scene, "--steps", 1, "--layers", layers) for layers in (1, 2))
    assert two["cells"] == 2 * one["cells"] == 16
    done = tsgdd("dns", *scene, "--steps", 1, "--no-plots", "--out", tmp_path / "dns")
    assert done.code == 0, done.err
    assert two["nominal_stress"][-1] == pytest.approx(read_summary(tmp_path / "dns")["nominal_stress"], rel=1e-9)
    assert two["nominal_stress"][-1] > 1.1 * one["nominal_stress"][-1]  # layers hinder each other's lateral motion


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--strain", 2), "strain: expected a number between -0.5 and 1"),
        (("--blocks", 0, 2), "blocks: expected at least 1 along x and y, got 0 2"),
        (("--layers", 0), "steps, write_every, layers: expected at least 1, got 25, 5 and 0"),
        (("--bar-force", -1), "bar_force: expected positive forces"),
        (("--convergence", "4"), "convergence: expected sizes parted by commas, as 10x5,20x10, got '4'"),
        (("--band", "soft"), "band: expected numbers parted by commas, as 1e-9,2e-9, got 'soft'"),
        (("--linear-solver", "magic"), "linear solver: expected auto or one of"),
    ],
)
def test_bad_input(options, text, tsgdd, tmp_path):
    done = tsgdd("monolayer", *options, "--out", tmp_path / "out")
    assert done.code == 2
    assert text in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()
