"""The command line, called in this process or started as a user does, and one small chain of runs."""

from __future__ import annotations

import importlib.util
import json
import logging
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest

from tsg_micro.data.dataset_file import read_dataset, write_dataset


class Done(NamedTuple):
    code: int
    out: str
    err: str


class Chain(NamedTuple):
    data: Path
    dns: Path
    dd: Path


@pytest.fixture(autouse=True)
def _one_process():
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is not None and mpi.COMM_WORLD.size > 1:
        pytest.skip("starts mpirun itself")


def call(*arguments):
    """Run the command line in this process; its exit code."""
    from workflows.cli import main

    old = sys.argv
    sys.argv = ["tsgdd", *map(str, arguments)]
    try:
        main()
    except SystemExit as end:
        return end.code
    finally:
        sys.argv = old
        logging.captureWarnings(False)
    return 0


@pytest.fixture(scope="session")
def command_line():
    """``command_line(*arguments)`` in this process: the exit code, where what is printed does not matter."""
    return call


@pytest.fixture
def tsgdd(capsys):
    """``tsgdd(*arguments)`` in this process: exit code and what was printed."""

    def run(*arguments):
        capsys.readouterr()
        code = call(*arguments)
        printed = capsys.readouterr()
        return Done(code, printed.out, printed.err)

    return run


@pytest.fixture(scope="session")
def script():
    """``script(path)``: the module in a file beside the tests, which is a program of its own too."""

    def load(path):
        name = f"tests_script_{path.stem}"
        if name not in sys.modules:
            spec = importlib.util.spec_from_file_location(name, path)
            assert spec is not None
            assert spec.loader is not None
            sys.modules[name] = importlib.util.module_from_spec(spec)  # dataclasses look there
            spec.loader.exec_module(sys.modules[name])
        return sys.modules[name]

    return load


@pytest.fixture
def program():
    """The installed command."""
    return Path(sys.executable).with_name("tsgdd")


@pytest.fixture
def launch(mpirun, program):
    """``launch(*arguments, ranks=n, env={...})``: the same in a process of its own, under mpirun if ranks is given."""

    def run(*arguments, ranks=None, env=None):
        if ranks is None:
            done = subprocess.run(
                [program, *map(str, arguments)],
                env=os.environ | {"OMP_NUM_THREADS": "1"} | (env or {}),
                capture_output=True,
                text=True,
                timeout=60,
                check=False,
            )
        else:
            done = mpirun(ranks, program, *arguments, env=env or {}, timeout=60)
        return Done(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def chain(tmp_path_factory):
    """In-plane data of 20 paths, the full tensegrity of 4 x 4 blocks, and the data-driven solution; no figures."""
    folder = tmp_path_factory.mktemp("chain")
    runs = Chain(folder / "data.h5", folder / "dns", folder / "dd")
    scene = ("--strain", 0.04, "--no-plots")
    steps = (
        (
            *("sample", "--load", "inplane", "--paths", 20, "--steps", 5, "--processes", 1),
            *("--no-plots", "--out", runs.data),
        ),
        ("dns", "--blocks", 4, 4, "--steps", 2, *scene, "--out", runs.dns),
        ("solve", "--data", runs.data, "--elements", 4, 4, 1, "--element", "trilinear", *scene, "--out", runs.dd),
    )
    for step in steps:
        assert call(*step) == 0
    return runs


@pytest.fixture
def read_summary():
    """The summary.json of a folder, or NAME.summary.json of a file; it must be JSON without NaN."""

    def refuse(name):
        raise AssertionError(f"summary.json holds {name}")

    def read(path):
        file = path / "summary.json" if path.is_dir() else path.with_name(f"{path.stem}.summary.json")
        return json.loads(file.read_text(), parse_constant=refuse)

    return read


@pytest.fixture
def is_png():
    """Whether a file is a PNG with something in it."""
    return lambda path: path.read_bytes().startswith(b"\x89PNG\r\n") and path.stat().st_size > 5000


@pytest.fixture
def nameless():
    """A copy of a data set that does not say which tissue it is from, so that a solve adds no state at rest to it."""

    def copy(path, folder):
        write_dataset(folder / "nameless.h5", replace(read_dataset(path), parameters={}))
        return folder / "nameless.h5"

    return copy
