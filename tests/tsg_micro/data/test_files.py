"""Files that reach the disk whole: a full disk, a kill, and several writers at once leave nothing broken."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import append_dataset, read_dataset, write_dataset
from tsg_micro.data.errors import OutputError
from tsg_micro.data.files import atomic_path, locked, output_folder

ROOT = Path(__file__).parents[3]


def numbered(i, n=3):
    strain = np.full((n, 6), float(i + 1))
    return Dataset(strain, strain, "cauchy", path=np.zeros(n, dtype=np.int64), step=np.arange(n))


def in_process(script, *arguments, **options):
    return subprocess.Popen(
        [sys.executable, "-c", script, *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=-1,
        stderr=-1,
        text=True,
        **options,
    )


FULL = """
import resource, signal, sys
import numpy as np
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import write_dataset
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
n = 2000
strain = np.ones((n, 6))
try:
    write_dataset(sys.argv[1], Dataset(strain, strain, "cauchy", path=np.zeros(n, dtype=int), step=np.arange(n)))
except OSError as error:
    print(type(error).__name__, error)
"""


@pytest.mark.parametrize("room", [0, 1000, 100_000, 220_000, 226_000])
def test_a_full_disk_leaves_the_old_file(tmp_path, room):
    """Whether the disk is full at once, in the middle of the arrays, or only when the seal is written."""
    path = tmp_path / "d.h5"
    write_dataset(path, numbered(1))
    before = path.read_bytes()
    process = in_process(FULL, path, room)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    assert out.startswith("OutputError output ")
    assert "d.h5: cannot be written (File too large); what was there is as before" in out
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["d.h5"]


def test_an_error_of_the_block_is_an_output_error_and_leaves_nothing(tmp_path):
    def write():
        with atomic_path(tmp_path / "a.txt") as temporary:
            temporary.write_text("half")
            raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match=r"a\.txt: cannot be written \(No space left on device\)"):
        write()
    assert not os.listdir(tmp_path)


def test_leftovers_of_killed_runs_are_removed_at_the_next_start(tmp_path):
    script = """
import os, sys
from tsg_micro.data.files import atomic_path
with atomic_path(sys.argv[1]) as temporary:
    temporary.write_text("half")
    print(temporary.name, flush=True)
    if sys.argv[2] == "stay":
        sys.stdin.read()
    os.kill(os.getpid(), 9)
"""
    process = in_process(script, tmp_path / "d.h5", "die")
    dead = process.communicate(timeout=60)[0].strip()
    assert (tmp_path / dead).exists()
    (tmp_path / ".mine-of-no-run.h5").touch()
    with in_process(script, tmp_path / "d.h5", "stay", stdin=-1) as running, atomic_path(tmp_path / "own.h5") as own:
        assert running.stdout is not None
        alive = running.stdout.readline().strip()
        output_folder(tmp_path)
        assert set(os.listdir(tmp_path)) == {alive, own.name, ".mine-of-no-run.h5"}
        running.kill()


def test_several_writers_at_once_lose_nothing(tmp_path):
    script = """
import sys
sys.path.insert(0, sys.argv[3])
from test_files import numbered
from tsg_micro.data.dataset_file import append_dataset
for i in range(4):
    append_dataset(sys.argv[1], numbered(4 * int(sys.argv[2]) + i))
"""
    path = tmp_path / "d.h5"
    writers = [in_process(script, path, i, Path(__file__).parent) for i in range(4)]
    for writer in writers:
        _, err = writer.communicate(timeout=120)
        assert writer.returncode == 0, err
    data = read_dataset(path)
    assert sorted(data.strain[:, 0]) == sorted(np.repeat(np.arange(1.0, 17.0), 3))
    assert len(np.unique(data.path)) == 16


def test_a_lock_may_be_taken_again_by_its_owner(tmp_path):
    with locked(tmp_path / "d.h5"):
        assert len(append_dataset(tmp_path / "d.h5", numbered(0))) == 3
