"""Tests on any number of ranks: one report for all, and no rank left behind by a failure on another."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import hypothesis
import pytest

# What Open MPI wants to know of a test machine; other libraries do not read it.
OPEN_MPI = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}

try:
    from mpi4py import MPI
except (ImportError, RuntimeError):  # not installed, or no MPI library
    COMM = None
else:
    COMM = MPI.COMM_WORLD.Dup() if MPI.COMM_WORLD.size > 1 else None  # its messages never meet the tests' own

# Every rank must draw the same examples, and every run of the suite too.
hypothesis.settings.register_profile("tsgdd", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("tsgdd")


@pytest.hookimpl(trylast=True)
def pytest_configure(config):
    if COMM and COMM.rank > 0:
        config.pluginmanager.unregister(name="terminalreporter")


def pytest_collection_finish(session):
    if COMM:
        collected = COMM.allgather((session.testsfailed, [item.nodeid for item in session.items]))
        if any(other != collected[0] for other in collected):
            print(f"rank {COMM.rank} collected {collected[COMM.rank]}", file=sys.stderr, flush=True)
            pytest.exit("the ranks did not collect the same tests", returncode=1)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(item, call):
    """A test that fails on one rank fails on all, and the report shows every rank's side."""
    report = yield
    if COMM:
        if report.failed and call.excinfo:  # at once, in case the others never answer
            print(f"\nrank {COMM.rank}: {item.nodeid}: {call.excinfo.exconly()}", file=sys.stderr, flush=True)
        sides = COMM.allgather((report.outcome, report.longreprtext))
        outcomes = {outcome for outcome, _ in sides}
        if "failed" in outcomes or len(outcomes) > 1:
            report.outcome = "failed"
            report.longrepr = "\n".join(f"rank {rank} {outcome}\n{text}" for rank, (outcome, text) in enumerate(sides))
    return report


@pytest.fixture
def shared_tmp_path(tmp_path):
    """A temporary folder that is the same on all ranks."""
    return Path(COMM.bcast(str(tmp_path))) if COMM else tmp_path


@pytest.fixture
def may_mpirun(monkeypatch):
    """Programs that are started here may start mpirun themselves."""
    for name, value in OPEN_MPI.items():
        monkeypatch.setenv(name, value)


@pytest.fixture
def mpirun():
    """Start a program on n ranks: ``mpirun(n, *arguments, **run_options)`` gives the CompletedProcess."""
    program = shutil.which("mpirun", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if program is None:
        pytest.skip("no mpirun")

    def start(ranks, *arguments, **options):
        options = {"capture_output": True, "text": True, "timeout": 180, "check": False} | options
        # A copy of os.environ lacks what an MPI library has put into this process's own environment.
        options["env"] = dict(os.environ) | {"OMP_NUM_THREADS": "1"} | OPEN_MPI | options.get("env", {})
        return subprocess.run([program, "-n", str(ranks), *map(str, arguments)], **options)

    return start
