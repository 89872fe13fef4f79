"""Adaptive sampling: clusters of the strains of a scene, and data from nothing that reach the answer of FE2."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from dd_macro.methods.clusters import cluster
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve import build_rve
from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset import take
from tsg_micro.data.dataset_file import read_dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import to_mandel
from workflows.runs.fe2 import fe2
from workflows.runs.scene import Scene
from workflows.runs.solve import solve

ROOT = Path(__file__).parents[3]
F_B = 1e-8
TISSUE = Tissue(bar_force=F_B)
SCENE = Scene("shear", 0.06, elements=(4, 4, 1), element="trilinear", edges=False)
BUDGETS = (1, 4, 16, 64)


def run(out, *, data=None, measure=None, tissue=TISSUE, **plan):
    asked = {"adaptation": dd.Adaptation(**{"tolerance": 0.0, **plan}), "tissue": tissue}
    return solve(out, data=data, scene=SCENE, **asked, stress_measure=measure, plots=False)


def error(out, reference):
    """Relative l2 errors of p and q of the blocks."""
    a, b = (dd.read_quadrature(folder / "quadrature.h5") for folder in (out, reference))
    pairs = [[fields.cell_mean(getattr(fields, f"mechanical_{name}")) for fields in (a, b)] for name in "pq"]
    return np.array([np.linalg.norm(x - y) / np.linalg.norm(y) for x, y in pairs])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """FE2, and adaptive runs from nothing with ever more RVEs."""
    folder = tmp_path_factory.mktemp("adapt")
    fe2(folder / "fe2", scene=SCENE, tissue=TISSUE, plots=False)
    for budget in BUDGETS:
        run(folder / f"{budget}", budget=budget)
    return folder


def test_from_nothing_to_fe2(folder):
    errors = np.array([error(folder / f"{budget}", folder / "fe2") for budget in BUDGETS])
    assert errors[0].min() > 0.1  # linear elasticity of the reference state
    assert (errors[1:] < 0.6 * errors[:-1]).all()
    assert errors[-1].max() < 0.01
    slope = np.polyfit(np.log(BUDGETS), np.log(errors.mean(axis=1)), 1)[0]
    assert slope < -0.6


def test_a_tissue_that_stiffens_manyfold(tmp_path):
    """At 15 % and 3 nN the tangent is ten times that of the reference state, and so of the metric.

    By strain and stress no point would leave the reference datum: 69 % off, converged, estimated error 1e-14.
    """
    scene, tissue = replace(SCENE, load="stretch", strain=0.15), Tissue(bar_force=3e-9)
    exact = fe2(tmp_path / "fe2", scene=scene, tissue=tissue, steps=4, plots=False)
    found = solve(
        *(tmp_path / "adapt",), data=None, scene=scene, tissue=tissue, adaptation=dd.Adaptation(), plots=False
    )
    assert found["top_force"] == pytest.approx(exact["top_force"], rel=0.01)
    assert error(tmp_path / "adapt", tmp_path / "fe2").max() < 0.02
    assert found["surprise_rounds"][-1] < 0.2 * found["surprise_rounds"][1]


def test_a_large_error_is_a_warning(tsgdd, read_summary, tmp_path):
    scene = ("--elements", 3, 3, 1, "--load", "shear", "--bar-force", F_B, "--no-plots", "--out", tmp_path)
    for budget, strain, warned in ((5, 0.15, True), (64, 0.01, False)):
        done = tsgdd("solve", "--adapt", *scene, "--strain", strain, "--rve-budget", budget)
        assert done.code == 0, done.err
        summary = read_summary(tmp_path)
        assert (summary["estimated_error"] > 0.05) == warned
        assert ("--rve-budget" in " ".join(summary["warnings"])) == ("--rve-budget lowers it" in done.out) == warned


def test_the_summary_tells_how_it_went(folder, read_summary):
    summary = read_summary(folder / "64")
    assert summary["parameters"]["order"] == 2
    assert summary["parameters"]["bar_force"] == F_B
    assert summary["rves_rounds"] == summary["data_rounds"] == [1, 4, 16, 64]
    assert summary["iterations_rounds"][:-1] == [0, 1, 1]
    assert summary["iterations_rounds"][-1] == 1 + summary["iterations"]
    assert summary["rves"] == summary["data_points"] == 64
    assert summary["failed_rves"] == 0
    assert summary["adapt_reason"] == "RVE budget used"
    assert summary["change_rounds"][0] is None
    assert summary["change_rounds"][-1] < 0.2 * summary["change_rounds"][1]
    assert summary["surprise_rounds"][-1] < 0.2 * summary["surprise_rounds"][1]
    assert summary["normalised_distance"] < 1e-12
    assert summary["error_rounds"][-1] < 0.2 * summary["error_rounds"][1]
    assert summary["error_kind"] == "check RVEs"


def test_the_estimated_error_is_about_that_against_fe2(folder, read_summary):
    for budget in (16, 64):
        found = error(folder / f"{budget}", folder / "fe2").mean()
        estimate = read_summary(folder / f"{budget}")["estimated_error"]
        assert found / 3 < estimate < 4 * found  # stresses of blocks against strains and stresses of points


def test_it_ends_where_the_error_is_small(tmp_path, read_summary):
    assert run(tmp_path / "a", tolerance=0.05)["adapt_reason"] == "estimated error reached"
    summary = read_summary(tmp_path / "a")
    assert summary["rves"] < 64
    assert summary["error_rounds"][-1] <= 0.05 < summary["error_rounds"][-2]


def test_the_data_are_ordinary_ones(folder, read_summary, tmp_path):
    data = read_dataset(folder / "64" / "data.h5")
    assert data.tangent is not None
    assert data.deformation_gradient is not None
    np.testing.assert_array_equal(data.strain[0], 0.0)
    np.testing.assert_array_equal(np.bincount(data.path), [1, 3, 12, 48])
    np.testing.assert_allclose(to_mandel(data.deformation_gradient - np.eye(3)), data.strain, atol=1e-15)
    state = build_rve(bar_force=F_B, free=()).solve_strain(data.strain[40])
    assert state.tangent is not None
    assert data.energy is not None
    np.testing.assert_allclose(data.stress[40], to_mandel(state.first_piola), atol=1e-9 * np.abs(data.stress).max())
    np.testing.assert_allclose(data.tangent[40], state.tangent, atol=1e-9 * np.abs(data.tangent).max())
    assert data.energy[40] == pytest.approx(state.energy)

    again = solve(tmp_path / "again", data=folder / "64" / "data.h5", scene=SCENE, order=2, plots=False)
    assert error(tmp_path / "again", folder / "64").max() < 2e-3  # it starts elsewhere
    assert again["top_force"] == pytest.approx(read_summary(folder / "64")["top_force"], rel=1e-3)


def test_it_goes_on_with_data_that_are_there(folder, tmp_path):
    start = folder / "16" / "data.h5"
    summary = run(tmp_path / "more", data=start, budget=24, tissue=None)
    assert summary["rves_rounds"] == [0, 24]
    data, old = read_dataset(tmp_path / "more" / "data.h5"), read_dataset(start)
    np.testing.assert_array_equal(data.strain[:16], old.strain)
    assert len(data) == 40
    assert [source["bar_force"] for source in data.parameters["joined"]] == [F_B, F_B]
    assert (error(tmp_path / "more", folder / "fe2") < error(folder / "16", folder / "fe2")).all()
    # and with those, as another stress
    summary = run(tmp_path / "cauchy", data=tmp_path / "more" / "data.h5", measure="cauchy", budget=4)
    assert summary["stress_measure"] == read_dataset(tmp_path / "cauchy" / "data.h5").stress_measure == "cauchy"
    assert summary["data_rounds"] == [40, 44]


def test_ranks_do_not_change_the_answer(mpirun, folder, tmp_path):
    scene = ("--elements", 4, 4, 1, "--load", "shear", "--strain", 0.06, "--bar-force", F_B)
    plan = (
        "--element",
        "trilinear",
        "--no-edges",
        "--adapt",
        "--rve-budget",
        16,
        "--adapt-tolerance",
        0,
        "--no-plots",
        "--out",
        tmp_path / "two",
    )
    env = {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = mpirun(2, sys.executable, "-c", "from workflows.cli import main; main()", "solve", *scene, *plan, env=env)
    assert done.returncode == 0, done.stderr
    a, b = (read_dataset(path / "data.h5") for path in (folder / "16", tmp_path / "two"))
    np.testing.assert_allclose(b.strain, a.strain, atol=1e-9)
    assert error(tmp_path / "two", folder / "16").max() < 1e-8


def test_figures(tsgdd, is_png, tmp_path):
    done = tsgdd(
        *("solve", "--adapt", "--bar-force", F_B, "--elements", 2, 2, 1, "--rve-budget", 4, "--metric", "visited"),
        *("--out", tmp_path / "out"),
    )
    assert done.code == 0, done.err
    assert "data.h5" in done.out
    assert is_png(tmp_path / "out" / "adaptation.png")
    assert is_png(tmp_path / "out" / "fields.png")


def test_clusters_are_where_the_error_is():
    rng = np.random.default_rng(1)
    near = 0.1 * rng.standard_normal((500, 6))
    blobs = np.concatenate([near, near[:50] + 5 * np.eye(6)[0], near[50:100] - 4 * np.eye(6)[3]])
    strains, parents = cluster(MPI.COMM_SELF, blobs, np.ones(600), np.zeros((1, 6)), count=2)
    found = strains[np.argsort(strains[:, 3])]
    np.testing.assert_allclose(found, [blobs[550:].mean(axis=0), blobs[500:550].mean(axis=0)], atol=0.05)
    np.testing.assert_array_equal(parents, 0)
    # where there are data already, no more are asked for
    data = np.concatenate([np.zeros((1, 6)), found])
    further, parents = cluster(MPI.COMM_SELF, blobs, np.ones(600), data, count=3)
    assert np.linalg.norm(further[:, None] - data, axis=2).min() > 0.01
    assert len(parents) == 3


def test_clusters_lower_the_error_and_the_order_of_points_does_not_matter():
    rng = np.random.default_rng(2)
    strain, volume = rng.standard_normal((2000, 6)) * [3, 2, 1, 0.1, 0.1, 0.1], rng.uniform(1, 2, 2000)
    old, last = strain[:4], np.inf
    order = rng.permutation(2000)
    for count in (0, 4, 16, 64):
        new, _ = cluster(MPI.COMM_SELF, strain, volume, old, count=count)
        assert len(new) == count
        r = np.linalg.norm(strain[:, None] - np.concatenate([old, new]), axis=2).min(axis=1)
        assert volume @ r**4 < 0.7 * last
        last = volume @ r**4
        again, _ = cluster(MPI.COMM_SELF, strain[order], volume[order], old, count=count)
        np.testing.assert_allclose(again, new, atol=1e-9)


def test_a_few_strains_get_a_datum_each_and_no_more():
    points = np.repeat(np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), 3, axis=0)
    strains, _ = cluster(MPI.COMM_SELF, points, np.ones(18), np.zeros((1, 6)), count=50)
    assert len(strains) == 6
    np.testing.assert_allclose(strains[np.argsort(strains.sum(axis=1))], points[::3], atol=1e-9)


def test_where_an_rve_fails_it_is_tried_nearer():
    good, far = np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.0]), np.array([-1.2, 0.1, 0.0, 0.0, 0.0, 0.0])
    beyond = np.array([-9.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    source = RVESource(RVESpec(TISSUE))
    states = source.reach(np.array([good, far, beyond]), np.zeros((3, 6)))
    assert len(source.known) == 3
    assert states[0] is not None
    np.testing.assert_allclose(states[0].strain[0], good, atol=1e-15)
    assert states[1] is not None
    part = states[1].strain[0, 0] / far[0]
    assert part in (0.5, 0.25)
    np.testing.assert_allclose(states[1].strain[0], part * far, atol=1e-15)
    assert states[2] is None


def test_where_a_state_starts_does_not_change_it():
    rng = np.random.default_rng(4)
    strains = 0.06 * rng.uniform(-1, 1, (6, 6))
    source = RVESource(RVESpec(TISSUE))
    source.reach(strains[:3], np.zeros((3, 6)))
    for state in source.reach(strains[3:], np.zeros((3, 6))):
        assert state is not None
        own = build_rve(bar_force=F_B, free=()).solve_strain(state.strain[0])
        assert own.tangent is not None
        np.testing.assert_allclose(state.first_piola[0], own.first_piola, atol=1e-8 * np.abs(own.first_piola).max())
        np.testing.assert_allclose(state.tangent[0], own.tangent, atol=1e-7 * np.abs(own.tangent).max())


def test_growth_is_more_than_one():
    with pytest.raises(InputError, match="growth: expected more than 1, got 1"):
        dd.Adaptation(growth=1.0)


BAD = {
    "neither": ((), "data: expected a file"),
    "no bar force": (("--adapt",), "bar_force: expected a force in N, since there are no data, got none"),
    "first order": (("--adapt", "--bar-force", F_B, "--order", 1), "order: expected 2 with --adapt, got 1"),
    "no adapt": (("--rve-budget", 5), "expected --adapt"),
    "budget": (("--adapt", "--bar-force", F_B, "--rve-budget", 0), "rve_budget: expected at least 1, got 0"),
    "tolerance": (("--adapt", "--bar-force", F_B, "--adapt-tolerance", 1), "adapt_tolerance: expected"),
    "secant": (("--adapt", "--bar-force", F_B, "--metric", "secant"), "metric: expected auto, tangent or visited"),
    "force": (("--adapt", "--bar-force", -1), "bar_force: expected"),
    "no file": (("--adapt", "--bar-force", F_B, "--data", "nowhere.h5"), "no such file"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line(name, tsgdd, tmp_path):
    arguments, text = BAD[name]
    done = tsgdd("solve", "--elements", 2, 2, 1, *arguments, "--out", tmp_path / "out")
    assert done.code == 2
    assert text in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_data_that_do_not_fit(folder, tsgdd, tmp_path):
    data, out = folder / "16" / "data.h5", ("--out", tmp_path / "out")
    done = tsgdd("solve", "--elements", 2, 2, 1, "--adapt", "--bar-force", 2e-8, "--data", data, *out)
    assert done.code == 2
    assert "bar_force: expected that of the data, 1e-08 N, got 2e-08" in done.err
    bare = take(read_dataset(data), np.arange(3))
    object.__setattr__(bare, "tangent", None)
    write_dataset(tmp_path / "bare.h5", bare)
    done = tsgdd("solve", "--elements", 2, 2, 1, "--adapt", "--data", tmp_path / "bare.h5", *out)
    assert done.code == 2
    assert "data: expected tangents for --adapt, got none" in done.err
    # made for shear up to 0.06: another load, or more of it, has to be within their range
    for other in (("--load", "shear", "--strain", 0.07), ("--load", "stretch", "--strain", 0.3)):
        done = tsgdd("solve", "--elements", 2, 2, 1, *other, "--data", data, *out)
        assert done.code == 2
        assert "within the data's range" in done.err
