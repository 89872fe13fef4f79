"""Counts that no machine can do, and numbers that are none: refused in one line, at once."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

CASES = Path(__file__).parents[2] / "data" / "cases"
DATA = CASES / "hdf5" / "stretch_data.h5"
MEMORY = "GB are available"


def refused(done, *texts):
    assert (done.code, done.err.count("\n")) == (2, 1), done.err
    for text in texts:
        assert text in done.err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("demo", "--blocks", 0, 0), "blocks, paths: expected at least 1, got 0 0 and 400"),
        (("demo", "--blocks", 3, 3, "--paths", 0), "blocks, paths: expected at least 1, got 3 3 and 0"),
        (("structure", "--cells", 100_000, 100_000, 100_000), MEMORY),
        (("structure", "--shape", "spheroid", "--radius", 1e9), MEMORY),
        (("structure", "--shape", "spheroid", "--radius", "inf"), "radius: expected at least 0.866 blocks, got inf"),
        (("solve", "--data", DATA, "--elements", 10**6, 10**5, 100), MEMORY),
        (("solve", "--data", DATA, "--elements", 10**9, 10**9, 10**9), MEMORY),
        (("solve", "--data", DATA, "--elements", 1, 1, 1, "--order", 0), "order: expected 1 or 2, got 0"),
        (("fe2", "--elements", 10**6, 10**5, 100), MEMORY),
        (("monolayer", "--blocks", 100_000, 100_000), MEMORY),
        (("monolayer", "--steps", 10**9), "steps: expected at most 1000000, got 1000000000"),
        (("spheroid", "--radius", 1e5), MEMORY),
        (("spheroid", "--steps", 10**9), "steps: expected at most 1000000"),
        (("cell", "--steps", 10**9), "steps: expected at most 1000000"),
        (("dns", "--blocks", 1, 1, "--steps", 10**9), "steps: expected at most 1000000"),
        (("sample", "--paths", 10**12), MEMORY),
        (("sample", "--paths", 10, "--steps", 10**11), MEMORY),
        (("sample", "--blocks", 1000, 1000, 1000), MEMORY),
    ],
)
def test_absurd_counts(tsgdd, tmp_path, arguments, text):
    begin = time.perf_counter()
    refused(tsgdd(*arguments, "--out", tmp_path / ("O.h5" if arguments[0] == "sample" else "O")), text)
    assert time.perf_counter() - begin < 10
    assert not (tmp_path / "O" / "summary.json").exists()


@pytest.mark.parametrize("force", ["1e-8", [1e-8], None, -1.0])
def test_text_for_a_number_in_a_data_set(tsgdd, tmp_path, force):
    shutil.copy(DATA, tmp_path / "d.h5")
    with h5py.File(tmp_path / "d.h5", "a") as file:
        parameters = json.loads(file.attrs["parameters"])
        file.attrs["parameters"] = json.dumps({**parameters, "bar_force": force})
    solve = ("solve", "--elements", 1, 1, 1, "--no-plots", "--out", tmp_path / "O", "--data", tmp_path / "d.h5")
    done = tsgdd(*solve, "--adapt", "--rve-budget", 1)
    assert done.code in (1, 2)
    assert "unexpected" not in done.err, done.err
    append = ("sample", "--append", "--paths", 1, "--steps", 1, "--processes", 1, "--no-plots", "--seed", 77)
    done = tsgdd(*append, "--out", tmp_path / "d.h5")
    assert "unexpected" not in done.err, done.err


def test_values_beyond_numbers_in_a_data_set(tsgdd, tmp_path):
    shutil.copy(DATA, tmp_path / "d.h5")
    with h5py.File(tmp_path / "d.h5", "a") as file:
        file["stress"][7, 1] = 1e160
    solve = ("solve", "--elements", 1, 1, 1, "--no-plots", "--out", tmp_path / "O", "--data", tmp_path / "d.h5")
    refused(tsgdd(*solve), "data set, stress: expected numbers below 1e+60, got 1e+160 at index 7")
    assert np.isfinite(h5py.File(DATA)["stress"][()]).all()


def test_options_that_solve_nothing(launch, tmp_path):
    solve = ("solve", "--data", DATA, "--elements", 2, 2, 1, "--no-plots", "--out", tmp_path / "O")
    for ranks in (None, 2):
        done = launch(*solve, ranks=ranks, env={"PETSC_OPTIONS": "-dd_ksp_type preonly -dd_pc_type jacobi"})
        assert done.code == 1
        assert done.err.count("linear solver preonly + jacobi: expected a residual below 1e-06") == 1
    assert not (tmp_path / "O" / "summary.json").exists()
