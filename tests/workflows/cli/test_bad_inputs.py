"""A few of the bad inputs of bad_inputs.py, in this process; that file is a script which runs hundreds."""

from __future__ import annotations

from pathlib import Path

import pytest

SLOW = ("study", "bench", "demo", "paper", "fe2", "compare")
"""Commands that take seconds where the input is right after all; the script runs them."""
COUNT = 25
OTHERS = "eps_xx,eps_zz,eps_yz,eps_xz,eps_xy,sigma_xx,sigma_yy,sigma_zz,sigma_yz,sigma_xz,sigma_xy"


@pytest.fixture(scope="module")
def made(script, command_line, tmp_path_factory):

    bad_inputs = script(Path(__file__).with_name("bad_inputs.py"))
    folder = tmp_path_factory.mktemp("bad")
    return bad_inputs, bad_inputs.make_sources(folder / "sources", command_line), folder


def test_bad_inputs_end_in_one_line(made, tsgdd, monkeypatch):
    bad_inputs, sources, folder = made
    monkeypatch.chdir(folder)
    some = [bad for bad in bad_inputs.bad_inputs(sources, folder / "inputs", 140, seed=3) if not bad.may_pass]
    some = [bad for bad in some if bad.arguments[0] not in SLOW][:COUNT]
    assert len(some) == COUNT
    for bad in some:
        done = tsgdd(*bad.arguments)
        assert not bad_inputs.judge(bad, done.code, done.err).fault, (bad, done)


def test_the_script_sees_faults(made):
    bad_inputs, _, _ = made
    bad = bad_inputs.BadInput("", ())
    for code, err, fault in (
        (None, "", "hang"),
        (-11, "", "crash"),
        (0, "", "accepted"),
        (1, "tsgdd: unexpected KeyError: 3 (this is a defect; ...)\n", "traceback"),
        (2, "", "not one line"),
        (2, "tsgdd: one\ntsgdd: two\n", "not one line"),
        (2, "tsgdd: one\nand more\n", "not one line"),
        (2, "tsgdd: one\n", ""),
        (1, "sampling 3/4\rtsgdd: one\n", ""),
    ):
        assert bad_inputs.judge(bad, code, err).fault == fault
    assert not bad_inputs.judge(bad_inputs.BadInput("", (), may_pass=True), 0, "").fault


def test_the_same_seed_gives_the_same_inputs(made, tmp_path):
    bad_inputs, sources, _ = made
    one, two = ([(b.what, b.may_pass) for b in bad_inputs.bad_inputs(sources, tmp_path / n, 30, seed=5)] for n in "ab")
    assert one == two
    assert len(set(one)) > 20


@pytest.mark.parametrize("kind", ["pipe", "device"])
@pytest.mark.parametrize(
    "arguments",
    [
        ("structure", "--cells", 1, 1, 1, "--no-plots", "--tissue", "FILE"),
        ("calibrate", "--data", "FILE", "--fit", "bar-force"),
        ("import-csv", "FILE", "--column", "eps_yy=a:%", "--zero", OTHERS),
        ("solve", "--data", "FILE", "--elements", 1, 1, 1),
        ("spheroid", "--profile", "FILE"),
        ("solve", "FILE"),
    ],
)
def test_what_never_ends_is_not_read(tsgdd, tmp_path, arguments, kind):
    import os

    path = tmp_path / "file.csv"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    out = tmp_path / ("out.h5" if arguments[0] == "import-csv" else "out")
    done = tsgdd(*(path if word == "FILE" else word for word in arguments), "--out", out)
    assert (done.code, done.err.count("\n")) == (2, 1), done.err
    assert "file.csv" in done.err


@pytest.mark.parametrize(("option", "value"), [("--d-tendon", 1e30), ("--d-bar", 1e-300), ("--e-bar", 1e308)])
@pytest.mark.parametrize("command", ["structure", "sample", "spheroid"])
def test_members_that_nothing_has(tsgdd, tmp_path, command, option, value):
    more = ("--cells", 1, 1, 1) if command == "structure" else ()
    done = tsgdd(command, *more, option, value, "--out", tmp_path / ("o.h5" if command == "sample" else "o"))
    assert (done.code, done.err.count("\n")) == (2, 1), done.err
    assert "expected 1e-" in done.err
