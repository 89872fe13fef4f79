"""``tsgdd paper`` and what it stands on: stages that are kept, the data-size and causes studies, the frontier."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.errors import InputError
from workflows.runs.loads import LOADS
from workflows.store.record import write_summary
from workflows.store.stages import Stages
from workflows.studies.data_size import data_size, sizes_of
from workflows.studies.one_load import Study
from workflows.studies.prerequisites import Chain as SceneOfChain
from workflows.studies.report import write_report

SMALL = ("--blocks", 4, 4, "--paths", 10, "--steps", 4)


class Runs:
    """Counts how often each stage is run; a stage writes what it was given."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.done: list[str] = []

    def chain(self, first: int, second: int) -> list[str]:
        self.done.clear()
        stages = Stages(self.folder)
        stages.run("first", {"value": first}, lambda out: self._act(out, first))
        stages.run("second", {"value": second}, lambda out: self._act(out, second), ("first",))
        assert stages.ran == self.done
        assert sorted(stages.ran + stages.skipped) == ["first", "second"]
        return list(self.done)

    def _act(self, out: Path, value: int) -> None:
        (out / "result.txt").write_text(str(value))
        self.done.append(out.name)


def test_stages_run_when_they_or_what_they_read_have_changed(tmp_path):
    runs = Runs(tmp_path)
    assert runs.chain(1, 2) == ["first", "second"]
    assert runs.chain(1, 2) == []
    assert runs.chain(1, 3) == ["second"]
    assert runs.chain(2, 3) == ["first", "second"]
    (tmp_path / "second" / "result.txt").unlink()
    assert runs.chain(2, 3) == ["second"]
    (tmp_path / "first" / "result.txt").write_text("damaged")
    assert runs.chain(2, 3) == ["first"]
    (tmp_path / "first" / "stage.json").write_text("[")
    assert runs.chain(2, 3) == ["first"]


def test_a_stage_that_fails_is_not_there(tmp_path):
    def fail(out):
        (out / "half.txt").write_text("")
        raise InputError("no")

    with pytest.raises(InputError):
        Stages(tmp_path).run("one", {}, fail)
    (tmp_path / "one" / "checkpoint.h5").write_text("kept")
    (tmp_path / "one" / ".p-12345678.png").write_text("")  # what a kill in the middle of a write leaves
    runs: list[Path] = []
    Stages(tmp_path).run("one", {}, runs.append)
    assert len(runs) == 1
    assert sorted(path.name for path in (tmp_path / "one").iterdir()) == ["checkpoint.h5", "stage.json"]
    (tmp_path / "two").write_text("a file")
    with pytest.raises(InputError, match="two"):
        Stages(tmp_path).run("two", {}, runs.append)


def test_sizes_span_three_decades():
    sizes = sizes_of(10_000, 16)
    assert len(sizes) == 16
    assert sizes[0] == 10
    assert sizes[-1] == 10_000
    np.testing.assert_allclose(np.diff(np.log10(sizes)), 0.2, atol=0.02)
    assert sizes_of(40, 16) == sorted(set(sizes_of(40, 16)))


@pytest.fixture(scope="module")
def study(chain, tmp_path_factory):
    """The data-size study on the runs of the chain: 3 sizes, 3 draws."""
    out = tmp_path_factory.mktemp("size")
    return out, run_study(chain, out)


def run_study(chain, out, draws=3):
    scene = SceneOfChain(blocks=(4, 4), strain=0.04)
    return data_size(Study(out, "stretch", scene, chain.dns, chain.data), count=3, draws=draws, plots=False)


def test_all_data_give_what_solve_and_compare_give(study, chain, tsgdd, read_summary, nameless, tmp_path):
    _, summary = study
    scene = ("--elements", 4, 4, 1, "--strain", 0.04, "--element", "trilinear", "--no-plots")
    folder = tmp_path / "dd"
    assert tsgdd("solve", "--data", nameless(chain.data, tmp_path), *scene, "--out", folder).code == 0
    assert tsgdd("compare", "--dd", folder, "--dns", chain.dns, "--out", tmp_path, "--no-plots").code == 0
    compared, solved = read_summary(tmp_path), read_summary(folder)
    assert summary["sizes"][-1] == solved["data_points"]
    for ours, theirs in (("error_mech", "error_p_mech"), ("error_mat", "error_p_mat")):
        assert summary["largest"][ours] == pytest.approx(compared[theirs]["l2"], rel=1e-9)
        assert summary["largest"][f"{ours}_all"] == pytest.approx(compared[theirs]["l2_all"], rel=1e-9)
        assert summary[ours]["std"][-1] is None  # there is one draw of all data
    assert summary["largest"]["distance_all"] == pytest.approx(solved["normalised_distance"], rel=1e-9)
    assert not compared["dns_buckled"]


def test_more_data_are_closer_and_the_tensegritys_own_are_closest(study):
    out, summary = study
    distance = summary["distance_all"]["mean"]
    assert distance[-1] < 0.6 * distance[0]
    assert summary["self_consistent"]["distance_all"] < distance[-1]
    with (out / "solves.csv").open() as stream:
        assert stream.readline().startswith("# run ")
        rows = list(csv.DictReader(stream))
    assert summary["solves"] == len(rows) == 3 * (len(summary["sizes"]) - 1) + 1
    first = [float(row["distance_all"]) for row in rows if float(row["size"]) == summary["sizes"][0]]
    assert np.mean(first) == pytest.approx(distance[0], rel=1e-12)
    assert len(set(first)) == 3  # draws differ
    assert summary["distance_all"]["std"][0] == pytest.approx(np.std(first, ddof=1), rel=1e-12)


def test_a_study_goes_on_after_its_last_draw(study, chain, tmp_path):
    out, summary = study
    lines = (out / "solves.csv").read_text().splitlines(keepends=True)
    kept = [line.replace(line.split(",")[-3], "123.0") for line in lines[2:5]]  # seconds that tell who wrote the row
    (tmp_path / "solves.csv").write_text("".join(lines[:2] + kept))
    again = run_study(chain, tmp_path)
    for name in ("error_mech", "distance_all"):
        np.testing.assert_allclose(again[name]["mean"], summary[name]["mean"], rtol=1e-9)
    assert (tmp_path / "solves.csv").read_text().count("123.0") == 3
    (tmp_path / "solves.csv").write_text("".join(lines[:2] + kept[:-1]))  # half a draw counts for nothing
    run_study(chain, tmp_path, draws=1)
    assert "123.0" not in (tmp_path / "solves.csv").read_text()
    (tmp_path / "solves.csv").write_text("".join(["# run another\n", *lines[1:2], *kept]))
    run_study(chain, tmp_path, draws=1)
    assert "123.0" not in (tmp_path / "solves.csv").read_text()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("study", "data-size", "--load", "stretch", "--blocks", 2, 2), "blocks: expected at least 3 3"),
        (("study", "data-size", "--load", "stretch", "--draws", 0), "draws: expected at least 2 and 1, got 16 and 0"),
        (("study", "data-size", "--load", "stretch", "--bar-force", -1), "bar_force"),
        (("study", "causes", "--load", "shear", "--paths", 0), "paths: expected at least 1, got 0"),
        (("study", "data-size", "--load", "stretch", "--dns", "nowhere", "--data", "no.h5"), "no.h5"),
        (("bench", "frontier", "--dns", "nowhere"), "load: expected stretch or shear"),
        (("paper", "--paths", 2, "--steps", 3), "paths * steps: expected at least 40, got 6"),
        (("paper", "--strain", 2), "strain: expected"),
        (("paper", "--strain", 0.09), "eps_yy within"),
        (("study", "sampling", "--paths", 3, "--steps", 10), "at least 40 points"),
        (("study", "rve-size", "--largest", 21), "largest: expected 2"),
    ],
)
def test_bad_input_is_one_line(arguments, text, tsgdd, tmp_path):
    done = tsgdd(*arguments, "--out", tmp_path / "out")
    assert done.code == 2
    assert text in done.err
    assert done.err.count("\n") == 1
    assert not list(tmp_path.glob("out/*/*"))


def test_reference_of_another_scene_is_refused(chain, tsgdd, tmp_path):
    given = ("--dns", chain.dns, "--data", chain.data, "--blocks", 4, 4, "--out", tmp_path)
    for command in (("study", "data-size"), ("study", "causes"), ("bench", "frontier")):
        done = tsgdd(*command, "--load", "stretch", "--strain", 0.05, *given)
        assert done.code == 2
        assert "strain: expected the same in both runs, got 0.05" in done.err
    wider = ("--dns", chain.dns, "--data", chain.data, "--blocks", 5, 4, "--out", tmp_path)
    done = tsgdd("study", "data-size", "--load", "stretch", "--strain", 0.04, *wider)
    assert done.code == 2
    assert "blocks: expected those of the run in" in done.err
    swapped = ("--load", "shear", "--strain", 0.04, "--blocks", 4, 4, "--data", chain.data, "--out", tmp_path / "new")
    done = tsgdd("study", "data-size", *swapped, "--dns", chain.dns)
    assert done.code == 2
    assert "load: expected the same" in done.err
    assert not (tmp_path / "new" / "dns-shear").exists()


def test_flat_sheet_needs_no_force_to_stay_flat(tsgdd, read_summary, tmp_path):
    """By symmetry; so it is an equilibrium of the free sheet too, and the same where that does not buckle."""
    stress = {}
    for kind in ("flat", "free"):
        scene = ("--blocks", 3, 3, "--load", "shear", "--strain", 0.04, "--steps", 2, "--no-plots")
        assert tsgdd("dns", *scene, f"--{kind}", "--out", tmp_path / kind).code == 0
        summary = read_summary(tmp_path / kind)
        assert summary["deflection"] < 1e-12
        stress[kind] = read_dataset(tmp_path / kind / "blocks.h5").stress
    np.testing.assert_allclose(stress["flat"], stress["free"], rtol=0, atol=1e-9 * np.abs(stress["free"]).max())
    assert read_summary(tmp_path / "flat")["midplane_force"] < 1e-9


def test_killed_paper_goes_on_and_reports(program, tsgdd, read_summary, is_png, tmp_path, monkeypatch):
    monkeypatch.setattr("workflows.studies.bench_frontier._REPEATS", 1)
    monkeypatch.delitem(LOADS, "shear")  # what is kept is of the first load
    arguments = ("paper", *SMALL, "--largest", 2, "--sizes", 2, "--draws", 1, "--out", tmp_path)
    process = subprocess.Popen(
        [program, *map(str, arguments)], stdout=subprocess.DEVNULL, env=os.environ | {"OMP_NUM_THREADS": "1"}
    )
    while not (tmp_path / "dns-stretch" / "stage.json").exists() and process.poll() is None:
        time.sleep(0.01)
    process.kill()
    assert process.wait(10) == -signal.SIGKILL
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/stage.json")}
    assert {path.parent.name for path in before} >= {"rve-size", "data-stretch", "dns-stretch"}

    assert tsgdd(*arguments).code == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before
    summary = read_summary(tmp_path)
    assert {"rve-size", "data-stretch", "dns-stretch"} <= set(summary["stages_kept"])
    assert "causes-stretch" in summary["stages_run"]
    report = (tmp_path / "report.md").read_text()
    for figure in (line.split("](")[1][:-1] for line in report.splitlines() if line.startswith("![")):
        assert is_png(tmp_path / figure)
    assert report.count("| stretch: ") == 13
    assert all(row["command"].startswith("tsgdd ") for row in summary["table"])
    assert "nan" not in report

    causes = read_summary(tmp_path / "causes-stretch")["rows"]
    size = read_summary(tmp_path / "data-size-stretch")
    assert causes[0]["error_mech"] == pytest.approx(size["largest"]["error_mech"], rel=1e-9)
    points = json.loads((tmp_path / "frontier-stretch" / "summary.json").read_text())["points"]
    same = [p for p in points if p["method"] == "data-driven, metric tangent" and p["data"] == 40]
    assert same[0]["error_mat"] == pytest.approx(size["largest"]["error_mat"], rel=1e-9)
    assert all(p["error_mech"] is None or 0 < p["error_mech"] < 20 for p in points)

    assert tsgdd(*arguments).code == 0
    assert read_summary(tmp_path)["stages_run"] == []

    # a load more is a section more
    monkeypatch.setitem(LOADS, "pull", LOADS["stretch"])
    for folder in tmp_path.glob("*-stretch*"):
        shutil.copytree(folder, folder.with_name(folder.name.replace("stretch", "pull")))
    assert "They were not measured here: `tsgdd bench accuracy" in report  # errors of one sheet are not those of all
    zones = [
        {"case": "a sheet", "symbol": "p", "zone": zone, "error": e} for zone, e in (("inner", 0.012), ("all", 0.2))
    ]
    family = tmp_path / "accuracy"
    family.mkdir()
    write_summary(family, command="bench accuracy", parameters={"kinematics": "small"}, figures={"rows": (zones, "1")})
    rows = write_report(tmp_path / "more.md", tmp_path, SceneOfChain((4, 4), paths=10, steps=4))
    assert sum(row["quantity"].startswith("pull: ") for row in rows) == 13
    assert "| a sheet | p | 1.2 % | 20.0 % |" in (tmp_path / "more.md").read_text()
    assert (tmp_path / "more.md").read_text().count("](compare-pull/") == report.count("](compare-stretch/") > 0
