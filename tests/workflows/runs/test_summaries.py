"""Runs as people read them: a summary printed, a sweep as CSV that holds what differs and every figure of one value."""

from __future__ import annotations

import csv
import io
import json

import pytest

from tsg_micro.data.errors import InputError
from workflows.runs.summaries import rows_of
from workflows.store.record import write_summary


def made(folder, strain, error, **more):
    folder.mkdir()
    parameters = {"strain": strain, "blocks": [4, 2], "scene": {"load": [{"side": "top", "traction": None}]}}
    figures = {
        "error_p": ({"l2": error, "mean": 0.5}, "1"),
        "force": (2e-9, "N"),
        "history": ([1.0] * 20, "Pa"),
        **more,
    }
    write_summary(folder, command="solve", parameters=parameters, figures=figures)
    return folder


def test_a_sweep_is_a_row_a_run(tmp_path, tsgdd):
    runs = [made(tmp_path / f"a{i}", 0.01 * i, 0.1 / i) for i in (1, 2)]
    runs.append(made(tmp_path / "a3", 0.03, 0.7, warning=("none; none, or 1", "")))
    expected = rows_of(runs)
    assert list(expected[0]) == ["run", "command", "strain", "error_p.l2", "error_p.mean", "force / N", "warning"]
    done = tsgdd("table", *runs)
    assert done.code == 0
    for text in (done.out, _written(tsgdd, runs, tmp_path / "t.csv")):
        rows = list(csv.DictReader(io.StringIO(text)))
        assert [float(row["strain"]) for row in rows] == [0.01, 0.02, 0.03]
        assert [float(row["error_p.l2"]) for row in rows] == [0.1, 0.05, 0.7]
        assert [row["warning"] for row in rows] == ["", "", "none; none, or 1"]


def _written(tsgdd, runs, path):
    assert tsgdd("table", *runs, "--out", path).code == 0
    return path.read_text()


def test_a_summary_is_printed_with_units(tmp_path, tsgdd):
    run = made(tmp_path / "run", 0.05, 0.031, peak_memory=(2_000_000, "B"), reason=("\x1b[31mred [bold]", ""))
    done = tsgdd("show", run)
    lines = {line.split()[0]: line.split()[1:] for line in done.out.splitlines() if line.strip()}
    assert lines["force"] == ["2e-09", "N"]
    assert lines["error_p.l2"] == ["0.031"]
    assert lines["history"] == ["20", "values,", "1", "to", "1", "Pa"]
    assert lines["scene.load.1.side"] == ["top"]
    assert lines["peak_memory"] == ["2", "MB"]
    assert lines["reason"] == ["?[31mred", "[bold]"]  # what would steer the terminal does not reach it
    assert "scene.load.1.traction" not in lines


def test_a_table_does_not_steer_the_terminal(tmp_path, tsgdd):
    run = made(tmp_path / "run", 0.05, 0.031, **{"re\x1b[2Json": ("\x1b[31mred \ud800", "")})
    done = tsgdd("table", run)
    assert done.code == 0, done
    (row,) = csv.DictReader(io.StringIO(done.out))
    assert row["re?[2Json"] == "?[31mred ?"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "it has no summary.json"),
        ("{", "cannot be read as such"),
        (f'{{"command": "solve", "parameters": {{}}, "force": 1{"0" * 400}}}', "cannot be read as such"),
        ("[]", "is another's"),
        ('{"command": 3, "parameters": {}}', "is another's"),
        ('{"command": "solve", "parameters": {}}', "it is missing"),
        ('{"command": "solve", "parameters": {}, "units": 3, "versions": {}, "machine": {}}', "got 3"),
    ],
)
@pytest.mark.parametrize("command", ["show", "table"])
def test_what_is_no_run_is_one_line(tmp_path, tsgdd, command, content, said):
    if content is not None:
        (tmp_path / "summary.json").write_text(content)
    done = tsgdd(command, tmp_path)
    assert (done.code, done.err.count("\n")) == (2, 1), done
    assert said in done.err


def test_the_summary_itself_names_its_run(tmp_path, tsgdd):
    run = made(tmp_path / "run", 0.05, 0.031)
    whole, named = tsgdd("show", run), tsgdd("show", run / "summary.json")
    assert (whole.code, named.code) == (0, 0), named
    assert named.out.splitlines()[1:] == whole.out.splitlines()[1:]


def test_a_table_needs_runs_and_a_csv_file(tmp_path, tsgdd):
    run = made(tmp_path / "run", 0.05, 0.031)
    assert "ends in .csv" in tsgdd("table", run, "--out", tmp_path / "t.txt").err
    assert tsgdd("table").code == 2
    with pytest.raises(InputError, match="at least one folder"):
        rows_of([])
    assert json.loads((run / "summary.json").read_text())["force"] == 2e-9
