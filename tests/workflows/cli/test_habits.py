"""What people try first: the version, completion by Tab, an output that a variable of the shell was to name."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys

import pytest

import dd_macro
import tsg_micro
from workflows.cli import app


def leaves(group, before=()):
    """Names of all commands, as they are typed."""
    for command in group.registered_commands:
        yield (*before, command.name or command.callback.__name__)
    for child in group.registered_groups:
        yield from leaves(child.typer_instance, (*before, child.name) if child.name else before)


COMMANDS = sorted(leaves(app))


def test_one_version(tsgdd):
    version = importlib.metadata.version("tsgdd")
    assert tsgdd("--version").out == f"tsgdd {version}\n"
    assert dd_macro.__version__ == tsg_micro.__version__ == version


def test_an_empty_output_is_not_the_present_folder(tsgdd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert ("solve",) in COMMANDS
    assert ("bench", "scale") in COMMANDS
    for command in set(COMMANDS) - {("show",)}:
        done = tsgdd(*command, "--out", "")
        assert (done.code, done.err.count("\n")) == (2, 1), (command, done)
        assert "expected a path, got an empty one" in done.err, (command, done)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("typed", "expected"), [("tsgdd so", "solve"), ("tsgdd study me", "metric")])
def test_completion(typed, expected):
    program = "import sys; sys.argv[0] = 'tsgdd'; from workflows.cli import main; main()"
    told = {"_TSGDD_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    done = subprocess.run([sys.executable, "-c", program], env=os.environ | told, capture_output=True, text=True)
    assert (done.returncode, done.stdout.split(), done.stderr) == (0, [expected], "")
