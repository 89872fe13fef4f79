"""``tsgdd cell``: the curves of the paper's Section 3.1, the work of the force, and what is not imported for them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ET

import meshio
import numpy as np
import pytest

from tsg_micro.cells.truncated_octahedron import unit_cell
from workflows.experiments import published, sources
from workflows.runs.cell import DEFAULT_BAND, cell


@pytest.fixture
def run(tsgdd, read_summary, tmp_path):
    """``run(*options)``: the summary of a run without figures."""

    def start(*options):
        done = tsgdd("cell", *options, "--no-plots", "--out", tmp_path)
        assert done.code == 0, done.err
        return read_summary(tmp_path)

    return start


@pytest.fixture(scope="module")
def band(tmp_path_factory):
    """The default band, with figures."""
    folder = tmp_path_factory.mktemp("band")
    cell(folder, steps=6)
    return folder


def test_default_band(band, read_summary):
    summary = read_summary(band)
    rows = summary["band"]
    assert [row["bar_force"] for row in rows] == list(DEFAULT_BAND)
    depth = np.array([row["displacement"][-1] for row in rows])
    assert (np.diff(depth) < 0.0).all()
    assert 1.1e-6 < depth[0] < 1.3e-6
    assert depth[-1] < 0.2e-6
    assert summary["full_displacement"] == depth.tolist()
    assert summary["twist_angle_at_rest"] == pytest.approx(15.037, abs=5e-4)
    for row in rows:
        force, displacement = np.array(row["force"]), np.array(row["displacement"])
        np.testing.assert_allclose(force, np.linspace(0.0, 3e-9, 7), rtol=1e-12)
        assert displacement[0] == pytest.approx(0.0, abs=1e-15)
        assert (np.diff(displacement) > 0.0).all()
        assert row["secant_stiffness"] == pytest.approx(3e-9 / displacement[-1], rel=1e-12)
        assert row["apparent_modulus"] == pytest.approx((3e-9 / 1e-10) / (displacement[-1] / 1e-5), rel=1e-12)
        assert row["stiffening"] == pytest.approx(row["tangent_stiffness"] / row["initial_stiffness"])
        assert row["most_negative_pivots"] == row["negative_pivots"] == 0
        assert row["twist_angle"][0] == pytest.approx(np.degrees(unit_cell(0.5).theta), abs=1e-9)
        assert (np.diff(row["twist_angle"]) < 0.0).all()
        assert row["residual"] < 1e-9
        if row["bar_force"] <= 5e-9:  # the curve flattens where the prestress is small
            assert (np.diff(displacement, n=2) < 0.0).all()
            assert row["stiffening"] > 1.5
    # stiffness at rest is that of the prestress: proportional to it
    initial = [row["initial_stiffness"] / row["bar_force"] for row in rows]
    assert max(initial) < 1.03 * min(initial)


def test_band_figures_and_series(band, is_png):
    assert is_png(band / "force_displacement.png")
    assert is_png(band / "cell.png")
    for bar_force in DEFAULT_BAND:
        path = band / f"cell_{1e9 * bar_force:g}nN.pvd"
        sets = ET.parse(path).getroot().findall("Collection/DataSet")
        assert [float(entry.attrib["timestep"]) for entry in sets] == pytest.approx(np.linspace(0.0, 3.0, 7))
        assert all((band / entry.attrib["file"]).is_file() for entry in sets)
    last = meshio.read(band / sets[-1].attrib["file"])
    assert set(last.cell_data) >= {"force", "strain", "slack", "kind"}
    top = np.isclose(last.points[:, 2] - last.point_data["displacement"][:, 2], 1e-5)
    assert top.sum() == 4


def test_work_of_the_force_is_the_energy(run):
    summary = run("--bar-force", 1e-8, "--steps", 60)
    force, depth, energy = (np.array(summary[name]) for name in ("force", "displacement", "energy"))
    work = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(depth))])
    np.testing.assert_allclose(energy - energy[0], work, atol=1e-4 * work[-1])
    assert summary["units"]["displacement"] == "m"
    assert summary["parameters"]["bar_force"] == [1e-8]


def test_tangent_is_the_slope_and_the_steps_do_not_matter(run):
    at = {force: run("--bar-force", 2e-9, "--force", force, "--steps", 3) for force in (2.99e-9, 3e-9, 3.01e-9)}
    depth = [summary["displacement"][-1] for summary in at.values()]
    assert at[3e-9]["tangent_stiffness"] == pytest.approx(0.02e-9 / (depth[2] - depth[0]), rel=1e-4)
    once = run("--bar-force", 2e-9, "--steps", 1)
    assert once["displacement"][-1] == pytest.approx(depth[1], rel=1e-7)


def test_a_guided_top_and_stiffer_members_sink_less(run):
    depth = [
        run("--bar-force", 1e-9, "--steps", 2, *options)["displacement"][-1]
        for options in ((), ("--top", "guided"), ("--e-tendon", 2e7), ("--e-bar", 2.4e9))
    ]
    assert all(other < depth[0] for other in depth[1:])
    assert depth[1] == pytest.approx(0.84 * depth[0], rel=0.02)


@pytest.mark.parametrize("bar_force", [1e-11, 1e-10])
def test_a_cell_all_but_slack_is_not_turned_inside_out(bar_force, run):
    """Its stiffness at rest is next to nothing, and still it sinks little more than one with 1 nN in its bars."""
    summary = run("--bar-force", bar_force, "--steps", 2)
    assert summary["displacement"][-1] == pytest.approx(1.25e-6, rel=0.02)
    assert summary["negative_pivots"] == 0


def test_two_bar_forces(run):
    summary = run("--bar-force", 3e-9, "--bar-force", 6e-9, "--steps", 1)
    assert [row["bar_force"] for row in summary["band"]] == [3e-9, 6e-9]
    assert "displacement" not in summary


def test_nothing_heavy_is_imported(tmp_path):
    code = (
        "import sys; from workflows.cli import main\n"
        f"sys.argv = ['tsgdd', 'cell', '--bar-force', '1e-9', '--no-plots', '--out', {str(tmp_path)!r}]\n"
        "main()\n"
        "heavy = ('dolfinx', 'dolfinx_solver', 'mpi4py', 'petsc4py', 'matplotlib', 'pyvista', 'vtkmodules', 'meshio')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.splitlines()[-1:] == ["[]"], done.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["displacement"][-1] == pytest.approx(1.2e-6, rel=0.02)
    assert os.listdir(tmp_path) == ["summary.json"]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--force", -1e-9), "force: expected a positive number in N (it points down), got -1e-09"),
        (("--steps", 0), "steps: expected at least 1, got 0"),
        (("--bar-force", 0), "bar_force: expected positive forces"),
        (("--bar-force", 1e-9, "--bar-force", 1e-9), "bar_force: expected each value once"),
        (("--top", "glued"), "top: expected free or guided, got 'glued'"),
        (("--e-tendon", -1), "E_tendon: expected a positive number"),
        (("--half-diagonal", 1.5), "half_diagonal r: expected a number in (0, 1)"),
    ],
)
def test_bad_input(options, text, tsgdd, tmp_path):
    done = tsgdd("cell", *options, "--out", tmp_path / "out")
    assert done.code == 2
    assert text in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_published_numbers():
    assert sources() == ["dolega_2017", "harris_2011", "harris_2012", "helmlinger_1997"]
    ratio = published("harris_2012")["modulus_ratio"]
    assert (ratio.label, ratio.low, ratio.high) == ("Harris et al. 2012", 100.0, 100.0)
    assert published("harris_2012")["stretch_at_failure"].high == np.inf
    stress = published("helmlinger_1997")["growth_inhibiting_stress"]
    assert (stress.low, stress.high) == pytest.approx((45 * 133.322, 120 * 133.322), rel=1e-4)
    assert published("harris_2011")["indentation_force"].high == 3e-9
