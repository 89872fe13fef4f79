"""docs/formats.md names every figure of a summary, and every array of the files that a run writes."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import pytest

from tsg_micro.data.dataset import UNITS

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()
SCENE = {
    "body": {"blocks": [2, 1, 1]},
    "tissue": {"all": {}},
    "support": [{"side": "left"}],
    "load": [{"side": "right", "traction": ["5 Pa", 0, 0]}],
    "solve": {"steps": 2},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of an adaptive run of two steps, and its summary."""
    mpi = pytest.importorskip("mpi4py.MPI", exc_type=ImportError)
    if mpi.COMM_WORLD.size > 1:
        pytest.skip("runs in one process")
    from workflows.runs.solve_scene import solve_scene
    from workflows.scenes.read import scene_of

    folder = tmp_path_factory.mktemp("run")
    return folder, solve_scene(folder, scene_of(SCENE), plots=False)


def test_every_key_of_a_summary_is_there(run):
    assert [name for name in run[1] if f"`{name}`" not in PAGE] == []


def test_every_array_is_there(run):
    assert [name for name in UNITS if f"`{name}`" not in PAGE] == []
    for name in ("data.h5", "quadrature.h5"):
        with h5py.File(run[0] / name) as file:
            assert [one for one in (*file, *file.attrs) if f"`{one}`" not in PAGE] == []


def test_every_file_is_there(run):
    written = {re.sub(r"step-\d+", "step-N", path.name) for path in run[0].iterdir()}
    assert [name for name in written if f"`{name}`" not in PAGE] == []
