"""The study of trust: its scenes, how it counts, and a small run of it."""

from __future__ import annotations

import pytest

from workflows.studies.trust import score
from workflows.studies.trust_scenes import CUBE, METHODS, draw_scene


def row(true, estimate, name="a", method="order 1"):
    return {"true": true, "estimate": estimate, "name": name, "method": method}


def test_how_estimates_are_counted():
    rows = [
        row(0.10, 0.19),
        row(0.10, 0.21),
        row(0.10, 0.049, "low"),
        row(0.01, 0.001, method="order 2"),
        row(0.01, 0.006),
    ]
    found = score([*rows, row(0.06, None, "none"), row(None, None)])
    assert (found["solved"], found["not_solved"]) == (6, 1)
    assert found["within_factor_two"] == pytest.approx(2 / 6)
    assert (found["large_errors"], found["large_errors_missed"], found["missed"]) == (4, 2, ["low", "none"])
    assert found["within_by_method"] == {"order 1": [2, 5], "order 2": [0, 1]}


def test_scenes_are_random_and_can_be_drawn_again():
    scenes = [draw_scene(number) for number in range(60)]
    assert scenes[7] == draw_scene(7)
    assert {scene.method for scene in scenes} == set(METHODS)
    assert {scene.kind for scene in scenes} == {"sheet", "bulk"}
    assert {scene.load for scene in scenes} == {"stretch", "shear"}
    assert min(scene.strain for scene in scenes) < 0 < max(scene.strain for scene in scenes)
    assert all(scene.elements[2] == 1 for scene in scenes if scene.kind == "sheet")
    assert min(scene.data for scene in scenes) < 30 < 1000 < max(scene.data for scene in scenes) <= 3000


def test_a_small_study_catches_the_cube(tsgdd, read_summary, is_png, tmp_path, monkeypatch):
    from dataclasses import replace

    import workflows.studies.trust as study

    monkeypatch.setattr(study, "CUBE", replace(CUBE, elements=(2, 2, 2), data=90))
    run = ("study", "trust", "--scenes", 1, "--first", 2, "--largest", 3, "--most", 30, "--out", tmp_path)
    done = tsgdd(*run)
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    cube, other = summary["rows"]
    assert cube["true"] > 0.4
    assert cube["true"] / 2 < cube["estimate"] < 2 * cube["true"]
    assert other["true"] is not None or other["reason"]
    assert is_png(tmp_path / "trust.png")
    assert (tmp_path / "trust.csv").read_text().count("\n") == 3
    again = read_summary(tmp_path)["rows"]
    assert tsgdd(*run, "--no-plots").code == 0
    assert read_summary(tmp_path)["rows"] == again


def test_what_is_refused(tsgdd, tmp_path):
    done = tsgdd("study", "trust", "--scenes", 0, "--out", tmp_path / "out")
    assert done.code == 2
    assert "scenes: expected at least 1, got 0" in done.err
