"""``tsgdd dns``, ``solve``, ``compare`` and ``demo`` at small size."""

from __future__ import annotations

import json

import h5py
import meshio
import numpy as np
import pytest

from dd_macro.results.quadrature_file import read_quadrature
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.mandel import pressure, von_mises
from workflows.runs.rest import with_rest

BLOCK = 20e-6


def test_dns_summary(chain, read_summary):
    summary = read_summary(chain.dns)
    assert summary["dofs"] == 5376
    assert summary["negative_pivots"] == 0
    assert 4 <= summary["newton_iterations"] <= summary["factorisations"] < 60
    assert summary["seconds"] > 0
    assert summary["units"]["nominal_stress"] == "Pa"
    assert summary["units"]["seconds"] == "s"
    assert summary["parameters"]["bar_force"] == 1e-8
    assert len(summary["nominal_stress_history"]) == 3
    assert 30 < summary["nominal_stress"] < 100  # bars of 10 nN: some tens of Pa at 4 %


@pytest.mark.parametrize(("load", "axis"), [("stretch", 1), ("shear", 0)])
def test_nominal_stress_by_a_cut_through_the_members(load, axis, tsgdd, read_summary, is_png, tmp_path):
    scene = ("--blocks", 3, 2, "--load", load, "--strain", 0.05, "--steps", 1, "--out", tmp_path)
    assert tsgdd("dns", *scene).code == 0
    mesh = meshio.read(tmp_path / "structure.vtu")
    begin, end = mesh.points[mesh.cells[0].data].transpose(1, 0, 2)
    displacement = mesh.point_data["displacement"]
    vector = end - begin
    pull = mesh.cell_data["force"][0] / np.linalg.norm(vector, axis=1)
    area = 3 * BLOCK * BLOCK
    below, above = (mesh.points - displacement)[mesh.cells[0].data].transpose(1, 0, 2)[..., 1]
    stress = read_summary(tmp_path)["nominal_stress"]
    for height in (0.21, 0.5, 0.83):  # of the sheet; no node is there
        cut = height * 2 * BLOCK
        crossing = np.sign(above - cut) - np.sign(below - cut)
        force = 0.5 * (crossing * pull) @ vector[:, axis]
        assert force / area == pytest.approx(stress, rel=1e-6)
    rows = read_dataset(tmp_path / "blocks.h5")
    assert rows.midpoint is not None
    component, scale = ((1, 1.0), (5, np.sqrt(2.0)))[axis == 0]
    for y in (0.5 * BLOCK, 1.5 * BLOCK):
        row = rows.stress[np.isclose(rows.midpoint[:, 1], y), component] / scale
        assert len(row) == 3
        # the row carries the reaction; of a shear the file holds the symmetric part of P only
        assert row.mean() == pytest.approx(stress, rel=1e-6 if axis == 1 else 5e-3)
    assert all(is_png(tmp_path / f"{name}.png") for name in ("sheet", "stress_strain", "blocks"))


def test_dns_does_not_depend_on_the_steps_or_the_linear_solver(tsgdd, read_summary, tmp_path):
    def stress(*options):
        scene = ("--blocks", 2, 1, "--strain", -0.03, "--no-plots", "--out", tmp_path)
        done = tsgdd("dns", *scene, *options)
        assert done.code == 0, done.err
        return read_summary(tmp_path)["nominal_stress"]

    once = stress("--steps", 1)
    assert once < -5  # compression
    assert stress("--steps", 3) == pytest.approx(once, rel=1e-7)
    assert stress("--steps", 1, "--linear-solver", "superlu") == pytest.approx(once, rel=1e-7)


def test_solve_summary_and_files(chain, read_summary):
    summary = read_summary(chain.dd)
    assert summary["converged"] is True
    assert 1 < summary["iterations"] < 100
    assert 0 < summary["normalised_distance"] < 1
    assert (summary["quadrature_points"], summary["data_points"], summary["ranks"]) == (8 * 16, 101, 1)
    assert summary["seconds"] > 0
    assert len(summary["distance_history"]) == summary["iterations"]
    fields = read_quadrature(chain.dd / "quadrature.h5")
    assert fields.mechanical_stress.shape == (16, 8, 6)
    data = with_rest(read_dataset(chain.data))
    np.testing.assert_array_equal(fields.material_stress, data.stress[fields.datum])
    with h5py.File(chain.dd / "fields.vtkhdf") as file:
        assert file["VTKHDF"].attrs["Type"] == b"UnstructuredGrid"
        assert file["VTKHDF/NumberOfCells"][()].sum() == 16
    # the force on the top side is the resultant of the mechanical stress of every row
    bottom = fields.midpoint[:, 1] < BLOCK
    force = fields.cell_mean(fields.mechanical_stress)[bottom, 1].mean() * 4 * BLOCK * BLOCK
    assert summary["top_force"] == pytest.approx(force, rel=1e-6)
    assert summary["units"]["top_force"] == "N"


def test_same_fields_on_1_2_and_3_ranks(chain, launch, read_summary, is_png, tmp_path):
    one, summary = read_quadrature(chain.dd / "quadrature.h5"), read_summary(chain.dd)
    for ranks in (2, 3):
        out = tmp_path / str(ranks)
        scene = ("--elements", 4, 4, 1, "--element", "trilinear", "--strain", 0.04, "--out", out)
        done = launch("solve", "--data", chain.data, *scene, *["--no-plots"] * (ranks > 2), ranks=ranks)
        assert done.code == 0, done.err
        assert (ranks > 2) or is_png(out / "fields.png")
        assert done.out.count("results") == 1  # one rank speaks
        other, its = read_quadrature(out / "quadrature.h5"), read_summary(out)
        assert (its["ranks"], its["iterations"]) == (ranks, summary["iterations"])
        assert its["top_force"] == pytest.approx(summary["top_force"], rel=1e-9)
        np.testing.assert_array_equal(other.datum, one.datum)
        for name in ("mechanical_strain", "mechanical_stress", "material_stress", "mechanical_p", "local_distance"):
            a, b = getattr(other, name), getattr(one, name)
            np.testing.assert_allclose(a, b, atol=1e-9 * np.abs(b).max(), err_msg=name)


def test_a_rank_without_elements(chain, tsgdd, launch, read_summary, tmp_path):
    def top_force(run, **options):
        scene = ("--elements", 1, 2, 1, "--no-graded", "--no-plots", "--out", tmp_path)
        done = run("solve", "--data", chain.data, *scene, **options)
        assert done.code == 0, done.err
        return read_summary(tmp_path)["top_force"]

    assert top_force(launch, ranks=3) == pytest.approx(top_force(tsgdd), rel=1e-9)


@pytest.mark.parametrize(
    "scene",
    [
        ("--elements", 1, 1, 1),
        ("--elements", 3, 3, 2, "--strain", -0.04),
        ("--elements", 3, 2, 1, "--load", "shear", "--strain", -0.03, "--metric", "secant"),
        ("--elements", 2, 2, 1, "--stress-measure", "cauchy", "--over-relaxation", 1),
    ],
)
def test_odd_but_legal_scenes(scene, chain, tsgdd, read_summary, tmp_path):
    done = tsgdd("solve", "--data", chain.data, *scene, "--no-plots", "--out", tmp_path)
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    assert summary["converged"] is True
    assert np.sign(summary["top_force"]) == (-1 if "--strain" in scene else 1)


def test_a_gmsh_mesh_is_the_same_as_elements(chain, tsgdd, read_summary, tmp_path):
    from meshes.sheet import flat_sheet

    flat_sheet(tmp_path / "sheet.msh", elements=(4, 4, 1), size=(4 * BLOCK, 4 * BLOCK, BLOCK))
    scene = ("--mesh", tmp_path / "sheet.msh", "--element", "trilinear", "--strain", 0.04)
    done = tsgdd("solve", "--data", chain.data, *scene, "--no-plots", "--out", tmp_path)
    assert done.code == 0, done.err
    summary, box = read_summary(tmp_path), read_summary(chain.dd)
    assert summary["iterations"] == box["iterations"]
    assert summary["top_force"] == pytest.approx(box["top_force"], rel=1e-8)
    a, b = read_quadrature(tmp_path / "quadrature.h5"), read_quadrature(chain.dd / "quadrature.h5")
    rows = [np.lexsort(np.round(f.midpoint / BLOCK, 3).T) for f in (a, b)]
    mean = [f.cell_mean(f.mechanical_stress)[row] for f, row in zip((a, b), rows, strict=True)]
    np.testing.assert_allclose(mean[0], mean[1], atol=1e-8 * np.abs(mean[1]).max())


def test_compare_against_the_errors_by_hand(chain, tsgdd, read_summary, is_png, tmp_path):
    done = tsgdd("compare", "--dd", chain.dd, "--dns", chain.dns, "--out", tmp_path)
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    blocks, fields = read_dataset(chain.dns / "blocks.h5"), read_quadrature(chain.dd / "quadrature.h5")
    assert blocks.midpoint is not None
    order_b, order_f = (np.lexsort(np.round(x / BLOCK, 3).T) for x in (blocks.midpoint, fields.midpoint))
    inner = np.zeros((4, 4), dtype=bool)
    inner[1:-1, 1:-1] = True
    for name, stress in (("mech", fields.mechanical_stress), ("mat", fields.material_stress)):
        for symbol, invariant in (("p", pressure), ("q", von_mises)):
            a, b = invariant(fields.cell_mean(stress))[order_f], invariant(blocks.stress)[order_b]
            expected = {}
            for suffix, use in (("", inner.ravel()), ("_all", slice(None))):
                expected["l2" + suffix] = np.linalg.norm((a - b)[use]) / np.linalg.norm(b[use])
                expected["mean" + suffix] = np.mean(np.abs(a - b)[use] / np.abs(b[use]))
            assert summary[f"error_{symbol}_{name}"] == pytest.approx(expected, rel=1e-9)
    assert summary["error_p_mech"]["l2"] < 0.4
    assert summary["blocks"] == 16
    assert is_png(tmp_path / "p.png")
    assert is_png(tmp_path / "q.png")
    assert is_png(tmp_path / "boundary.png")
    boundary, whole = summary["boundary_p_mech"], summary["error_p_mech"]
    np.testing.assert_allclose(boundary["error"], [whole["l2_all"], whole["l2"]], rtol=1e-9)
    assert boundary["clamped_rows"] + boundary["free_sides"] == pytest.approx(boundary["rings"][0])


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("strain", 0.05, "strain: expected the same in both runs, got 0.04 in"),
        ("load", "shear", "load: expected the same in both runs, got stretch in"),
        ("bar_force", 2e-8, "bar_force: expected the same in both runs, got 1e-08 in"),
    ],
)
def test_compare_refuses_runs_of_two_scenes(name, value, text, chain, tsgdd, tmp_path):
    other = json.loads((chain.dns / "summary.json").read_text())
    other["parameters"][name] = value
    (tmp_path / "summary.json").write_text(json.dumps(other))
    (tmp_path / "blocks.h5").write_bytes((chain.dns / "blocks.h5").read_bytes())
    done = tsgdd("compare", "--dd", chain.dd, "--dns", tmp_path, "--out", tmp_path / "out")
    assert done.code == 2
    assert text in done.err
    assert not (tmp_path / "out").exists()


def test_demo(tsgdd, read_summary, is_png, tmp_path):
    done = tsgdd("demo", "--blocks", 4, 3, "--paths", 20, "--out", tmp_path)
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    assert summary["error_p_mech"]["l2"] < 0.25
    assert summary["seconds"] > 0
    figures = ["demo", "data", "dns/sheet", "dns/stress_strain", "dns/blocks", "dd/fields", "dd/convergence"]
    assert all(is_png(tmp_path / f"{name}.png") for name in [*figures, "compare/p", "compare/q"])
    for folder in ("dns", "dd", "compare"):
        assert read_summary(tmp_path / folder)["command"] == {"dd": "solve"}.get(folder, folder)


def test_second_order_data_are_nearer_with_the_same_file(chain, tsgdd, read_summary, tmp_path):
    scene = ("--data", chain.data, "--elements", 4, 4, 1, "--strain", 0.04, "--no-plots")
    assert tsgdd("solve", *scene, "--order", 2, "--out", tmp_path).code == 0
    first, second = read_summary(chain.dd), read_summary(tmp_path)
    assert (first["parameters"]["order"], second["parameters"]["order"]) == (1, 2)
    assert second["normalised_distance"] < 0.5 * first["normalised_distance"]
    assert second["held"] == 0
    assert tsgdd("compare", "--dd", tmp_path, "--dns", chain.dns, "--out", tmp_path / "compare", "--no-plots").code == 0
