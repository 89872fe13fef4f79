"""``tsgdd structure`` and ``tsgdd sample``: counts of the lattice, data that do not depend on who made them."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

from tsg_micro.cells.unit_cell import KINDS
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.mandel import from_mandel, to_mandel

SMALL = ("--load", "inplane", "--paths", 6, "--steps", 2, "--no-plots")


def test_structure_of_a_block(tsgdd, read_summary, is_png, tmp_path):
    assert tsgdd("structure", "--cells", 2, 2, 2, "--out", tmp_path).code == 0
    summary = read_summary(tmp_path)
    counts = {name: summary[name] for name in ("nodes", "bars", "tendons", "cells", "self_stress_states", "mechanisms")}
    # 3 * 144 - 6 rigid motions - 336 members + 8 states of self-stress = 98 mechanisms
    expected = {"nodes": 144, "bars": 96, "tendons": 240, "cells": 8, "self_stress_states": 8, "mechanisms": 98}
    assert counts == expected
    assert summary["equilibrium_residual"] < 1e-12
    assert is_png(tmp_path / "structure.png")
    mesh = meshio.read(tmp_path / "structure.vtu")
    kind, force = (mesh.cell_data[name][0] for name in ("kind", "force"))
    assert np.bincount(kind).tolist()[KINDS.index("bar")] == 96
    assert (force[kind == KINDS.index("bar")] < 0).all()
    assert (force[kind != KINDS.index("bar")] > 0).all()


def test_structure_of_a_spheroid(tsgdd, read_summary, tmp_path):
    done = tsgdd("structure", "--shape", "spheroid", "--radius", 2, "--no-plots", "--out", tmp_path)
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    # blocks whose midpoint, at half-integers, is within 2 of the centre: 32 of 64
    assert summary["cells"] == 8 * 32
    assert summary["self_stress_states"] == summary["cells"]
    members = summary["bars"] + summary["tendons"]
    assert summary["mechanisms"] == 3 * summary["nodes"] - 6 - members + summary["self_stress_states"]
    assert summary["equilibrium_residual"] < 1e-12


def test_data_do_not_depend_on_the_processes(tsgdd, launch, read_summary, tmp_path):
    assert tsgdd("sample", *SMALL, "--processes", 1, "--out", tmp_path / "one.h5").code == 0
    assert tsgdd("sample", *SMALL, "--processes", 2, "--out", tmp_path / "two.h5").code == 0
    done = launch("sample", *SMALL, "--out", tmp_path / "ranks.h5", ranks=2)
    assert done.code == 0, done.err
    assert done.out.count("points") == 1  # one rank speaks
    one = read_dataset(tmp_path / "one.h5").arrays()
    for name in ("two", "ranks"):
        assert read_summary(tmp_path / f"{name}.h5")["processes"] == 2
        other = read_dataset(tmp_path / f"{name}.h5").arrays()
        assert other.keys() == one.keys()
        for key, array in one.items():
            np.testing.assert_allclose(other[key], array, rtol=1e-12, atol=1e-12 * np.abs(array).max(), err_msg=key)


def test_more_ranks_than_paths(launch, tmp_path):
    done = launch("sample", "--paths", 1, "--steps", 1, "--no-plots", "--out", tmp_path / "d.h5", ranks=3)
    assert done.code == 0, done.err
    assert len(read_dataset(tmp_path / "d.h5")) == 1


def test_sample_summary_figure_and_append(tsgdd, read_summary, is_png, tmp_path):
    out = tmp_path / "d.h5"
    few = ("sample", "--paths", 3, "--steps", 2, "--processes", 1, "--out", out)
    assert tsgdd(*few).code == 0
    first, summary = read_dataset(out), read_summary(out)
    assert (summary["points"], summary["paths"], summary["failed_paths"]) == (6, 3, 0)
    assert summary["seconds"] > 0
    assert summary["units"]["seconds"] == "s"
    assert is_png(tmp_path / "d.png")
    assert RVESpec.of(first) == (RVESpec(),)
    again = tsgdd(*few, "--append", "--no-plots")
    assert again.code == 2
    assert "seed: expected another" in again.err
    assert tsgdd(*few, "--append", "--seed", 1, "--no-plots").code == 0
    both, summary = read_dataset(out), read_summary(out)
    assert (summary["points"], summary["points_in_file"]) == (6, 12)
    np.testing.assert_array_equal(both.stress[:6], first.stress)
    assert both.path.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    assert not np.isclose(both.strain[6:], first.strain).all()


@pytest.mark.parametrize("measure", ["cauchy", "kirchhoff", "second_piola"])
def test_stress_measure_that_was_asked_for(measure, tsgdd, chain, tmp_path):
    out = tmp_path / "d.h5"
    few = ("--load", "inplane", "--paths", 1, "--steps", 5, "--processes", 1, "--no-plots")
    assert tsgdd("sample", *few, "--stress-measure", measure, "--out", out).code == 0
    P, other = read_dataset(chain.data), read_dataset(out)
    assert P.deformation_gradient is not None
    assert other.deformation_gradient is not None
    assert other.stress_measure == measure
    F, stress = P.deformation_gradient[:5], from_mandel(other.stress)
    np.testing.assert_allclose(other.deformation_gradient, F, atol=1e-12)
    inverse = np.linalg.inv(F).transpose(0, 2, 1)
    J = np.linalg.det(F)[:, None, None]
    back = {"cauchy": J * stress @ inverse, "kirchhoff": stress @ inverse, "second_piola": F @ stress}[measure]
    # the files hold the symmetric part of P
    np.testing.assert_allclose(to_mandel(back), P.stress[:5], atol=1e-6 * np.abs(P.stress[:5]).max())


def children_at_work(process):
    """Worker processes that have started to work: they no longer listen to Ctrl-C."""
    found = []
    for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split():
        status = Path(f"/proc/{pid}/status").read_text()
        command = Path(f"/proc/{pid}/cmdline").read_text()
        ignored = int(status.split("SigIgn:")[1].split()[0], 16)
        if "spawn_main" in command and ignored >> (signal.SIGINT - 1) & 1:
            found.append(int(pid))
    return found


def gone(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(")")[-1].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="looks into /proc")
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_a_run_that_is_ended_leaves_the_old_file_and_no_process(end, program, chain, tmp_path):
    out = tmp_path / "d.h5"
    old = chain.data.read_bytes()
    out.write_bytes(old)
    command = [program, "sample", "--paths", "100000", "--processes", "2", "--no-plots", "--out", out]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True
    ) as run:
        try:
            deadline = time.monotonic() + 30
            while len(workers := children_at_work(run)) < 2:
                assert time.monotonic() < deadline
                assert run.poll() is None
                time.sleep(0.05)
            if end == signal.SIGINT:
                os.killpg(run.pid, end)  # as a terminal does on Ctrl-C
            else:
                run.kill()
            _, err = run.communicate(timeout=30)
        finally:
            run.kill()
    if end == signal.SIGINT:
        assert run.returncode == 130
        assert err.strip().splitlines()[-1] == "tsgdd: interrupted"
        assert "Traceback" not in err
    while not all(gone(pid) for pid in workers):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert out.read_bytes() == old
    # beside what was sampled until then, from which the same command goes on
    assert [name for name in os.listdir(tmp_path) if not name.endswith(".paths.h5")] == ["d.h5"]
    with h5py.File(out) as file:
        assert len(file["strain"]) == 100
