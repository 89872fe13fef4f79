"""Edges as tissues of their own, against the full tensegrity, sampled, adapted, on ranks; sheet and bulk tissue."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset_file import read_dataset
from workflows.runs.edges import data_of, inside_of
from workflows.runs.fe2 import fe2
from workflows.runs.scene import Scene
from workflows.runs.solve import solve

F_B = 1e-8
FEW = ("--paths", 20, "--steps", 4, "--processes", 1, "--no-plots", "--load", "inplane", "--bar-force", F_B)
AXES = ("periodic held free", "free periodic free", "free held free")
SHEET = ("--elements", 6, 4, 1, "--element", "enhanced", "--kinematics", "finite")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("edges")


@pytest.fixture(scope="module")
def data(folder):
    """Data of the inside, the clamp, the free side and the corner, one file, and of the inside alone."""
    from tests.workflows.conftest import call

    for name in ("all", "inside"):
        assert call("sample", *FEW, "--out", folder / f"{name}.h5") == 0
    for axes in AXES:
        assert call("sample", *FEW, "--axes", axes, "--append", "--out", folder / "all.h5") == 0
    return {name: folder / f"{name}.h5" for name in ("all", "inside")}


def test_the_rows_of_a_sheet(tsgdd, read_summary, tmp_path):
    """Against every bar and tendon: the error of p of all blocks falls to less than half, in stretch and in shear."""
    for load in ("stretch", "shear"):
        dns = tmp_path / f"dns-{load}"
        run = ("--load", load, "--no-plots")
        assert tsgdd("dns", "--blocks", 6, 4, *run, "--flat", "--steps", 2, "--out", dns).code == 0
        errors = []
        for edges in ("--no-edges", "--edges"):
            out = tmp_path / f"{load}{edges}"
            assert tsgdd("solve", "--adapt", "--bar-force", F_B, *SHEET, *run, "--flat", edges, "--out", out).code == 0
            assert tsgdd("compare", "--dd", out, "--dns", dns, "--no-plots", "--out", tmp_path / "c").code == 0
            errors.append([read_summary(tmp_path / "c")[f"error_{s}_mech"]["l2_all"] for s in "pq"])
        assert errors[1][0] < 0.5 * errors[0][0]
        assert errors[1][1] < errors[0][1]


def test_ranks_do_not_change_the_answer(tsgdd, launch, tmp_path):
    plan = ("--adapt", "--bar-force", F_B, "--rve-budget", 24, "--adapt-tolerance", 0, "--edges", "--no-plots")
    scene = ("solve", *SHEET, "--load", "shear", *plan)
    assert tsgdd(*scene, "--out", tmp_path / "1").code == 0
    assert launch(*scene, "--out", tmp_path / "2", ranks=2).code == 0
    a, b = (dd.read_quadrature(tmp_path / rank / "quadrature.h5") for rank in "12")
    order = [np.lexsort(np.round(fields.midpoint.T * 1e6)) for fields in (a, b)]
    for name in ("mechanical_stress", "material_stress"):
        here, there = (fields.cell_mean(getattr(fields, name))[at] for fields, at in zip((a, b), order, strict=True))
        np.testing.assert_allclose(there, here, atol=1e-8 * np.abs(here).max())


def test_sampled_data_say_which_edge_they_are_of(data):
    dataset = read_dataset(data["all"])
    inside = inside_of(dataset)
    assert inside is not None
    specs = [inside.at(place) for place in (dd.INSIDE, ("", "held", ""), ("free", "", ""), ("free", "held", ""))]
    assert RVESpec.of(dataset) == tuple(specs)
    parts = [part for part in data_of(dataset, specs) if part is not None]
    assert [len(part) for part in parts] == [80, 80, 80, 80]
    carried = []
    for k, part in enumerate(parts):
        assert part.source is not None
        assert part.support is not None
        np.testing.assert_array_equal(part.source, k)
        carried.append(np.abs(part.support).max())
    assert carried[0] == carried[2] == 0.0
    assert min(carried[1], carried[3]) > 10.0
    # without edges the inside's data are used alone
    (alone,) = data_of(dataset, [inside])
    assert alone is not None
    np.testing.assert_array_equal(alone.stress, read_dataset(data["inside"]).stress)


@pytest.mark.parametrize("order", [1, 2])
def test_sampled_edges_are_used(order, data, tmp_path):
    """With edges the rows differ; without them, or without data of them, nothing changes."""
    found = {}
    for name, file, edges in (
        ("none", "inside", False),
        ("off", "all", False),
        ("bare", "inside", True),
        ("on", "all", True),
    ):
        scene = Scene("stretch", 0.05, elements=(4, 4, 1), edges=edges, element="trilinear")
        found[name] = solve(tmp_path / name, data=data[file], scene=scene, order=order, plots=False)["top_force"]
    assert found["off"] == found["bare"] == pytest.approx(found["none"], rel=1e-12)
    none, on = (dd.read_quadrature(tmp_path / name / "quadrature.h5") for name in ("none", "on"))
    row = none.midpoint[:, 1] < 2e-5
    a, b = (fields.cell_mean(fields.material_stress)[row] for fields in (none, on))
    assert np.linalg.norm(b - a) > 0.05 * np.linalg.norm(a)


def test_order_2_reaches_fe2_with_edges(data, tmp_path):
    scene = Scene("stretch", 0.03, elements=(3, 4, 1), graded=False, edges=True, kinematics="finite")
    exact = fe2(tmp_path / "fe2", scene=scene, tissue=Tissue(bar_force=F_B), plots=False)
    found = solve(tmp_path / "dd", data=data["all"], scene=scene, order=2, plots=False)
    adapted = solve(
        *(tmp_path / "adapt",),
        data=None,
        scene=scene,
        tissue=Tissue(bar_force=F_B),
        adaptation=dd.Adaptation(),
        plots=False,
    )
    assert found["top_force"] == pytest.approx(exact["top_force"], rel=0.2)  # 80 data a place; 0.4 % with 320
    assert found["estimated_error"] > 0.1 > 0.05 > adapted["estimated_error"]
    assert adapted["top_force"] == pytest.approx(exact["top_force"], rel=2e-3)
    # and its data are ordinary ones, to go on with
    again = {"data": tmp_path / "adapt" / "data.h5", "scene": scene, "plots": False}
    more = solve(tmp_path / "more", **again, adaptation=dd.Adaptation(budget=8))
    assert more["data_points"] > adapted["data_points"]
    assert solve(tmp_path / "same", **again, order=2)["top_force"] == pytest.approx(exact["top_force"], rel=3e-3)
    a, b = (dd.read_quadrature(tmp_path / run / "quadrature.h5") for run in ("adapt", "fe2"))
    for fields in (a, b):  # what the clamps carry is in the stress that is written
        row = fields.midpoint[:, 1] < 2e-5
        assert fields.cell_mean(fields.mechanical_stress)[row, 2].max() < -1.0
    np.testing.assert_allclose(a.cell_mean(a.mechanical_p), b.cell_mean(b.mechanical_p), rtol=0.03)


def test_bulk_tissue(tsgdd, read_summary, tmp_path):
    """Adaptive and FE2; its inside is stiffer in shear, and its free surface softens it."""
    scene = ("--elements", 3, 3, 3, "--load", "shear", "--strain", 0.002, "--bar-force", F_B, "--no-plots")
    force = {}
    for kind, edges in (("sheet", "--no-edges"), ("bulk", "--no-edges"), ("bulk", "--edges")):
        out = tmp_path / f"{kind}{edges}"
        done = tsgdd("solve", "--adapt", *scene, "--kind", kind, edges, "--clamp", "inplane", "--out", out)
        assert done.code == 0, done.err
        force[kind, edges] = read_summary(out)["top_force"]
        assert {spec.faces for spec in RVESpec.of(read_dataset(out / "data.h5"))} >= {
            RVESpec.of_kind(kind, Tissue()).faces
        }
    assert force["sheet", "--no-edges"] < force["bulk", "--edges"] < force["bulk", "--no-edges"]
    assert tsgdd("fe2", *scene, "--kind", "bulk", "--clamp", "inplane", "--out", tmp_path / "fe2").code == 0
    assert read_summary(tmp_path / "fe2")["top_force"] == pytest.approx(force["bulk", "--no-edges"], rel=1e-3)


def test_a_body_one_block_thick_is_a_sheet(tmp_path):
    """Bulk tissue with edges, free in both directions across z, is the sheet."""
    sheet = Scene("stretch", 0.01, elements=(3, 3, 1), graded=False, edges=True, clamp="inplane")
    bulk = replace(sheet, kind="bulk")
    problem = bulk.problem(MPI.COMM_SELF, rve=RVESpec.of_kind("bulk", Tissue()))
    assert problem.regions is not None
    assert {place[2] for place in problem.regions.places[1:]} == {"free twice"}
    forces = [fe2(tmp_path / str(scene.kind), scene=scene, plots=False)["top_force"] for scene in (sheet, bulk)]
    assert forces[1] == pytest.approx(forces[0], rel=1e-9)


SOLVE = ("solve", "--elements", 2, 2, 1)
BAD = {
    "bulk body": ((*SOLVE, "--data", "DATA", "--kind", "bulk"), "kind: expected that of the data, sheet, got bulk"),
    "adapt": (
        (*SOLVE, "--adapt", "--data", "DATA", "--kind", "bulk"),
        "kind: expected that of the data, sheet, got bulk",
    ),
    "two words": (("sample", *FEW, "--axes", "periodic held"), "axes: expected three words of periodic, free, held"),
    "a word": (("sample", *FEW, "--axes", "periodic fixed free"), "got 'periodic fixed free'"),
    "faces": (("sample", *FEW, "--axes", "periodic periodic periodic"), "axes: expected free along z"),
    "no kind": (("sample", *FEW, "--kind", "foam"), "foam"),
    "again": (
        ("sample", *FEW, "--axes", AXES[0], "--append", "--out", "DATA"),
        "seed: expected another than that of the data",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line(name, data, tsgdd, tmp_path):
    arguments, text = BAD[name]
    given = [data["all"] if value == "DATA" else value for value in arguments]
    done = tsgdd(*given, *(() if "--out" in given else ("--out", tmp_path / "out.h5")))
    assert done.code == 2
    assert text in done.err
    assert done.err.count("\n") == 1
