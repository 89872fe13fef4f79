"""Files of runs: whole or as before, of one run, and one line for what is damaged."""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
from pathlib import Path

import h5py
import pytest

from dd_macro import read_quadrature
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.errors import InputError

CASES = Path(__file__).parents[2] / "data" / "cases"


def one_line(done, code, *texts):
    assert (done.code, done.err.count("\n")) == (code, 1), done.err
    for text in texts:
        assert text in done.err


@pytest.fixture
def full_disk(program):
    """Run a command that may write ``room`` kB into a file."""

    def run(room, *arguments):
        script = f'ulimit -f {2 * room}; exec "$0" "$@"'
        done = subprocess.run(
            ["sh", "-c", script, program, *map(str, arguments)], capture_output=True, text=True, timeout=60, check=False
        )
        return done.returncode, done.stderr

    return run


def solved(chain, out, *options):
    return (
        "solve",
        "--data",
        chain.data,
        "--elements",
        4,
        4,
        1,
        "--strain",
        0.04,
        "--no-plots",
        "--out",
        out,
        *options,
    )


@pytest.mark.parametrize("room", [1, 50, 100])
def test_a_full_disk_ends_a_solve_in_one_line(tsgdd, chain, tmp_path, room):
    assert tsgdd(*solved(chain, tmp_path / "O")).code == 0
    before = read_quadrature(tmp_path / "O" / "quadrature.h5")
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024 * room, old[1]))  # here, as MPI needs large files at its start
    try:
        done = tsgdd(*solved(chain, tmp_path / "O", "--metric", "secant"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
    one_line(done, 1, "quadrature.h5: cannot be written (File too large); what was there is as before")
    assert read_quadrature(tmp_path / "O" / "quadrature.h5").normalised_distance == before.normalised_distance
    assert not list((tmp_path / "O").glob(".*"))


def test_a_full_disk_ends_an_import_in_one_line(full_disk, tmp_path):
    csv = tmp_path / "m.csv"
    csv.write_text("e,s\n" + "".join(f"{i * 1e-6},{i}\n" for i in range(3000)))
    zero = "eps_xx,eps_zz,eps_yz,eps_xz,eps_xy,sigma_xx,sigma_zz,sigma_yz,sigma_xz,sigma_xy"
    columns = ("--column", "eps_yy=e:1", "--column", "sigma_yy=s:Pa", "--zero", zero)
    code, err = full_disk(100, "import-csv", csv, *columns, "--out", tmp_path / "m.h5")
    assert (code, err.count("\n")) == (1, 1), err
    assert "m.h5: cannot be written (File too large)" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.csv"]


def test_files_of_different_runs_are_not_compared(tsgdd, chain, tmp_path):
    """A killed solve leaves new fields without a summary; older versions, beside the old one."""
    shutil.copytree(chain.dd, tmp_path / "O")
    old = json.loads((tmp_path / "O" / "summary.json").read_text())
    assert tsgdd(*solved(chain, tmp_path / "O", "--metric", "secant")).code == 0
    (tmp_path / "O" / "summary.json").write_text(json.dumps(old))
    compare = ("compare", "--dd", tmp_path / "O", "--dns", chain.dns, "--no-plots", "--out", tmp_path / "C")
    one_line(tsgdd(*compare), 2, "expected the files of one run, got summary.json and quadrature.h5 of different ones")


def test_the_old_summary_goes_first(tsgdd, chain, tmp_path, monkeypatch):
    shutil.copytree(chain.dd, tmp_path / "O")

    def killed(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("dd_macro.results.write.write_cells", killed)
    assert tsgdd(*solved(chain, tmp_path / "O")).code == 130
    assert (tmp_path / "O" / "quadrature.h5").exists()
    assert not (tmp_path / "O" / "summary.json").exists()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda s: s.pop("stress_measure"), "damaged (expected 'stress_measure', it is missing)"),
        (lambda s: s.pop("seconds"), "damaged (expected 'seconds', it is missing)"),
        (lambda s: s.update(seconds="long"), "damaged (expected a number for seconds, got 'long')"),
        (lambda s: s.update(normalised_distance=None), "expected a number for normalised_distance, got None"),
        (lambda s: s["parameters"].pop("load"), "load: expected the same in both runs, got None"),
        (lambda s: s.update(parameters=3), "is another's"),
        (lambda s: s.update(stress_measure=["p"]), "stress measure"),
    ],
)
def test_a_damaged_summary(tsgdd, chain, tmp_path, change, text):
    shutil.copytree(chain.dd, tmp_path / "O")
    path = tmp_path / "O" / "summary.json"
    summary = json.loads(path.read_text())
    change(summary)
    path.write_text(json.dumps(summary))
    compare = ("compare", "--dd", tmp_path / "O", "--dns", chain.dns, "--no-plots", "--out", tmp_path / "C")
    one_line(tsgdd(*compare), 2, text)


def no_weight(file):
    del file["weight"]


def short_weight(file):
    unit, data = file["weight"].attrs["unit"], file["weight"][:3]
    del file["weight"]
    file.create_dataset("weight", data=data).attrs["unit"] = unit


def no_distance(file):
    del file.attrs["normalised_distance"]


def linked(file):
    del file["weight"]
    file["weight"] = h5py.ExternalLink("/etc/hostname", "/")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (no_weight, "expected the array weight, it is missing"),
        (short_weight, "expected shape (3, "),
        (no_distance, "damaged"),
        (linked, "weight: expected an array in the file itself, got a link to elsewhere"),
    ],
)
def test_a_damaged_quadrature_file(tsgdd, chain, tmp_path, change, text):
    shutil.copytree(chain.dd, tmp_path / "O")
    path = tmp_path / "O" / "quadrature.h5"
    with h5py.File(path, "a") as file:
        change(file)
    compare = ("compare", "--dd", tmp_path / "O", "--dns", chain.dns, "--no-plots", "--out", tmp_path / "C")
    one_line(tsgdd(*compare), 2, "quadrature.h5: ", text)


def test_flipped_bits_of_a_quadrature_file_are_seen(chain, tmp_path):
    content = (chain.dd / "quadrature.h5").read_bytes()
    for k in range(0, len(content), len(content) // 40):
        flipped = bytearray(content)
        flipped[k] ^= 4
        (tmp_path / "q.h5").write_bytes(bytes(flipped))
        with pytest.raises(InputError, match=r"q\.h5: (damaged|expected an HDF5 file)"):
            read_quadrature(tmp_path / "q.h5")


def test_damaged_results_of_tsgfem(tsgdd, tmp_path):
    (tmp_path / "cases").mkdir()
    whole = (CASES.parent / "tsgfem" / "dbar_s1_slack0.npz").read_bytes()
    for content in (b"", b"PK\x03\x04 no zip", whole[: len(whole) // 2], whole[:2000] + b"x" * 50 + whole[2050:]):
        (tmp_path / "cases" / "bad.npz").write_bytes(content)
        done = tsgdd("bench", "tsgfem", "--cases", tmp_path / "cases", "--out", tmp_path / "O")
        one_line(done, 2, "bad.npz")


def test_append_at_once_and_of_another_bar_force(program, tsgdd, tmp_path, read_summary):
    data = tmp_path / "d.h5"
    sample = ("--paths", 1, "--steps", 2, "--processes", 1, "--no-plots", "--append", "--out", data)
    runs = [
        subprocess.Popen([program, "sample", *map(str, sample), "--seed", str(seed)], stdout=-1, stderr=-1)
        for seed in range(4)
    ]
    for run in runs:
        assert run.wait(120) == 0, run.communicate()[1]
    stored = read_dataset(data)
    assert len(set(stored.path)) == 4
    assert sorted(source["seed"] for source in stored.sources) == [0, 1, 2, 3]
    assert read_summary(data)["points_in_file"] == len(stored)
    done = tsgdd("sample", *sample, "--seed", 9, "--bar-force", 2e-8)
    one_line(done, 2, "bar_force: expected that of the data in", "1e-08 N, got 2e-08")
