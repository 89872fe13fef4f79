"""A kill and a full disk, of which the script kills.py makes hundreds; sampled paths are gone on from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tsg_micro.data.dataset_file import read_dataset


@pytest.fixture
def kills(script):
    return script(Path(__file__).with_name("kills.py"))


@pytest.fixture
def importing(kills, tmp_path, tsgdd):
    """The scene of import-csv, and the folder that it writes over."""
    (scene,) = [one for one in kills.SCENES if one.name == "import-csv"]
    (tmp_path / "start").mkdir()
    assert tsgdd(*scene.first(tmp_path / "start")).code == 0
    return scene, tmp_path / "start"


def test_a_kill_leaves_what_was_there_or_what_was_to_be(kills, importing, tmp_path):
    scene, start = importing
    assert kills.kill_once(scene, start, tmp_path / "killed", 0.6, 0) == ""


def test_a_full_disk_is_one_line(kills, importing, tmp_path):
    scene, start = importing
    assert kills.full_disk(scene, start, tmp_path / "full", 5000, 0) == ""
    assert len(read_dataset(tmp_path / "full" / "m.h5")) == 40


def test_the_script_sees_faults(kills, importing, tmp_path):
    scene, start = importing
    good = (start / "m.h5").read_bytes()
    (start / "m.h5").write_bytes(good[: len(good) // 2])
    assert scene.check(start, start).startswith("corrupt m.h5")
    (start / "m.h5").write_bytes(good)
    summary = start / "m.summary.json"
    summary.write_text(summary.read_text().replace('"points": 40', '"points": 41'))
    assert scene.check(start, start).startswith("mixed")


@pytest.mark.parametrize("append", [False, True])
def test_sampling_goes_on_where_it_was_cut(tsgdd, tmp_path, monkeypatch, append):
    import workflows.runs.sample_kept as kept
    import workflows.runs.sample_plan as plan_module
    from workflows.runs.sample_plan import Plan

    more = ("--append",) if append else ()
    sample = ("sample", "--paths", 5, "--steps", 2, "--processes", 1, "--no-plots", "--seed", 4, *more)
    assert tsgdd(*sample, "--out", tmp_path / "whole.h5").code == 0
    monkeypatch.setattr(kept, "_EVERY", 0.0)
    monkeypatch.setattr(kept, "_SHARE", 1e9)
    monkeypatch.setattr(plan_module, "_TOGETHER", 2)
    run, followed = Plan.run, []

    def cut(plan, rve, paths, progress=None):
        followed.extend(paths)
        if len(followed) == 4:
            raise KeyboardInterrupt
        return run(plan, rve, paths, progress)

    monkeypatch.setattr(Plan, "run", cut)
    assert tsgdd(*sample, "--out", tmp_path / "cut.h5").code == 130
    assert not (tmp_path / "cut.h5").exists()
    (file,) = tmp_path.glob(".cut-*.paths.h5")
    other = file.with_name(".cut-0123456789abcdef-0.paths.h5")
    other.write_bytes(b"of other parameters")
    assert tsgdd(*sample, "--out", tmp_path / "cut.h5").code == 0
    assert followed == [0, 1, 2, 3, 2, 3, 4]
    assert not file.exists()
    assert other.exists() == append  # another run may be adding to the same file
    whole, found = (read_dataset(tmp_path / f"{name}.h5") for name in ("whole", "cut"))
    for name, array in whole.arrays().items():
        np.testing.assert_array_equal(array, found.arrays()[name])


def test_damaged_kept_paths_are_sampled_anew(tsgdd, tmp_path, monkeypatch):
    import workflows.runs.sample_kept as kept

    sample = ("sample", "--paths", 2, "--steps", 1, "--processes", 1, "--no-plots", "--out", tmp_path / "d.h5")
    monkeypatch.setattr(kept.KeptPaths, "remove", lambda self, others: self.write())
    assert tsgdd(*sample).code == 0
    (file,) = tmp_path.glob(".d-*.paths.h5")
    first = read_dataset(tmp_path / "d.h5").strain
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    assert tsgdd(*sample).code == 0
    np.testing.assert_array_equal(read_dataset(tmp_path / "d.h5").strain, first)
