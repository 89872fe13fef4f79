"""``tsgdd spheroid`` at small size: equilibrium under both loads, the trend along the radius, a limit load, errors."""

from __future__ import annotations

import csv
import xml.etree.ElementTree as ET

import meshio
import numpy as np
import pytest

SMALL = ("spheroid", "--radius", 2)


def columns(path):
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_pressure(tsgdd, read_summary, tmp_path):
    done = tsgdd(*SMALL, "--level", 200, "--steps", 2, "--no-plots", "--out", tmp_path)
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    # 32 blocks; each face that two of the 256 cells share takes 4 nodes and 4 tendons from the sum
    shared = (6 * 256 - 288) // 2
    counts = {name: summary[name] for name in ("blocks", "cells", "bars", "nodes", "tendons", "surface_nodes", "dofs")}
    nodes = 24 * 256 - 4 * shared
    assert counts == {
        "blocks": 32,
        "cells": 256,
        "bars": 12 * 256,
        "nodes": nodes,
        "tendons": 36 * 256 - 4 * shared,
        "surface_nodes": 4 * 288,
        "dofs": 3 * nodes,
    }
    assert (summary["level"], summary["reached"], summary["reason"]) == (200.0, 200.0, "the level asked for")
    assert summary["level_history"] == [0.0, 100.0, 200.0]
    assert max(summary["residual_history"]) < 1e-9
    assert summary["negative_pivots_history"] == [0, 0, 0]
    assert summary["support_force"] < 1e-9
    np.testing.assert_allclose(summary["equivalent_pressure_history"], [0.0, 100.0, 200.0], atol=1e-6)
    volume = np.array(summary["volume_history"])
    assert (np.diff(volume) < 0.0).all()
    assert summary["volume_change"] == pytest.approx(volume[-1] / volume[0] - 1.0)
    assert -0.15 < summary["volume_change"] < -0.05
    assert summary["slack_tendons"] == summary["compressed_tendons"] == 0
    # a stiffer core bears more than the pressure, the rim about the pressure itself
    assert summary["rises_to_core"] is True
    assert 1.05 < summary["core_over_rim"] < 1.4
    core, rim = summary["sigma_rr"]["mean"]
    assert core / rim == pytest.approx(summary["core_over_rim"])
    assert rim == pytest.approx(-200.0, rel=0.1)
    assert np.abs(summary["sigma_rr_before"]["mean"]).max() < 1e-6
    assert summary["blocks_in_shell"] == [8, 24]

    blocks = columns(tmp_path / "blocks.csv")
    assert len(blocks["r_over_R"]) == 32
    np.testing.assert_allclose(blocks["bar_force_N"], 5e-8 * np.exp(-2.0 * blocks["r_over_R"]), rtol=1e-12)
    np.testing.assert_allclose(blocks["tau_rr_Pa"], blocks["sigma_rr_Pa"] * blocks["volume_ratio"], rtol=1e-12)


def test_figures_and_files(tsgdd, read_summary, is_png, tmp_path):
    done = tsgdd("spheroid", "--radius", 1.5, "--level", 100, "--steps", 2, "--out", tmp_path)
    assert done.code == 0, done.err
    for name in ("bar_force", "radial_stress", "slice", "levels", "blocks", "body"):
        assert is_png(tmp_path / f"{name}.png"), name
    series = ET.parse(tmp_path / "spheroid.pvd").getroot().findall(".//DataSet")
    assert [float(entry.attrib["timestep"]) for entry in series] == [0.0, 1.0, 2.0]
    mesh = meshio.read(tmp_path / series[-1].attrib["file"])
    assert len(mesh.points) == read_summary(tmp_path)["nodes"]
    assert np.ptp(mesh.points[:, 0]) < 0.99 * 40e-6
    assert (mesh.cell_data["slack"][0] == 0).all()


def test_rise_towards_the_core_is_that_of_the_bar_force(tsgdd, read_summary, tmp_path):
    """A body of one bar force has almost none: what the steps of its surface make in so small a body."""
    few = ("--level", 100, "--steps", 1, "--no-plots")
    assert tsgdd(*SMALL, "--profile", "constant", *few, "--out", tmp_path / "even").code == 0
    assert tsgdd(*SMALL, "--profile", "exponential", "--decay", 0, *few, "--out", tmp_path / "flat").code == 0
    assert tsgdd(*SMALL, "--decay", 3, *few, "--out", tmp_path / "steep").code == 0
    even, flat, steep = (read_summary(tmp_path / name) for name in ("even", "flat", "steep"))
    assert even["core_over_rim"] == pytest.approx(1.0, abs=0.1)
    assert steep["core_over_rim"] > 1.05 * even["core_over_rim"]
    assert flat["core_over_rim"] == pytest.approx(even["core_over_rim"], rel=1e-9)
    assert sorted(path.name for path in (tmp_path / "even").iterdir()) == ["blocks.csv", "summary.json"]


def test_displacement(tsgdd, read_summary, tmp_path):
    done = tsgdd(*SMALL, "--load", "displacement", "--level", 0.004, "--steps", 2, "--no-plots", "--out", tmp_path)
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    assert summary["reached"] == 0.004
    assert summary["units"]["reached"] == "1"
    assert max(summary["residual_history"]) < 1e-9
    assert summary["dofs"] == 3 * (summary["nodes"] - summary["surface_nodes"])
    # the surface is moved affinely, and what it encloses with it
    assert summary["volume_change"] == pytest.approx((1.0 - 0.004) ** 3 - 1.0, rel=1e-9)
    assert summary["equivalent_pressure_history"][-1] > summary["equivalent_pressure_history"][1] > 0.0


def test_limit_load_is_reported(tsgdd, read_summary, tmp_path):
    """8 blocks beyond what they bear: the run ends well, with the last equilibrium."""
    done = tsgdd("spheroid", "--radius", 1.5, "--level", 4000, "--steps", 2, "--no-plots", "--out", tmp_path)
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    assert 300.0 < summary["reached"] < 4000.0
    assert "stopped at" in summary["reason"]
    assert "stopped" in done.out
    assert summary["level_history"][-1] == summary["reached"]
    assert summary["residual_history"][-1] < 1e-9
    assert summary["negative_pivots_history"][-1] == 0
    assert 0.0 < summary["lowest_stiffness"] < 1e-3


def test_profile_from_a_file(tsgdd, read_summary, tmp_path):
    profile = tmp_path / "profile.csv"
    profile.write_text("r_over_R,f_over_fmax\n0,1\n0.5,0.6\n1,0.2\n")
    few = ("--level", 20, "--steps", 1, "--no-plots")
    assert tsgdd(*SMALL, "--profile", profile, "--f-max", 2e-8, *few, "--out", tmp_path / "csv").code == 0
    blocks = columns(tmp_path / "csv" / "blocks.csv")
    np.testing.assert_allclose(blocks["bar_force_N"], 2e-8 * (1.0 - 0.8 * blocks["r_over_R"]), rtol=1e-12)
    decay = -np.log(0.2)
    linear = ("--profile", "linear", "--decay", decay, "--f-max", 2e-8)
    assert tsgdd(*SMALL, *linear, *few, "--out", tmp_path / "linear").code == 0
    one, other = read_summary(tmp_path / "csv"), read_summary(tmp_path / "linear")
    assert one["core_over_rim"] == pytest.approx(other["core_over_rim"], rel=1e-8)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--radius", 0), "radius: expected"),
        (("--f-max", -1e-9), "f_max: expected a positive force"),
        (("--f-max", 1.0), "bar_force: expected less than the bar stiffness"),
        (("--decay", -1), "decay: expected"),
        (("--profile", "cubic"), "profile: expected one of exponential, linear, constant"),
        (("--profile", "missing.csv"), "missing.csv"),
        (("--load", "torsion"), "load: expected one of pressure, displacement"),
        (("--level", "nan"), "level: expected a positive number"),
        (("--level", -5), "level: expected a positive number"),
        (("--load", "displacement", "--level", 1.5), "level: expected a positive number below 1"),
        (("--steps", 0), "steps: expected at least 1"),
        (("--linear-solver", "abacus"), "linear solver: expected auto"),
    ],
)
def test_bad_input_is_one_line(options, text, tsgdd, tmp_path):
    out = tmp_path / "out"
    done = tsgdd(*SMALL, *options, "--out", out)
    assert done.code == 2
    assert text in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        ("r_over_R,f_over_fmax\n0,1\n0,0.5\n", "rising from line to line"),
        ("r_over_R,f_over_fmax\n0,1\n1,0\n", "f_over_fmax above 0"),
        ("r_over_R,force\n0,1\n1,0.5\n", "f_over_fmax"),
    ],
)
def test_bad_profile_file(lines, text, tsgdd, tmp_path):
    (tmp_path / "profile.csv").write_text(lines)
    done = tsgdd(*SMALL, "--profile", tmp_path / "profile.csv", "--out", tmp_path / "out")
    assert done.code == 2
    assert text in done.err
