"""Meshes from practice through the command line: the right force, or one line that says what is wrong."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

CASES = Path(__file__).parents[2] / "data" / "cases"


@pytest.fixture
def stretch(tsgdd, tmp_path):
    """Stretch a mesh of the cases by 5 %."""

    def run(name, *options):
        file = name if isinstance(name, Path) else CASES / "mesh" / f"{name}.msh"
        data = ("--data", CASES / "hdf5" / "stretch_data.h5", "--strain", 0.05, "--element", "trilinear")
        return tsgdd("solve", *data, "--no-plots", "--out", tmp_path / "O", "--mesh", file, *options)

    return run


TWO, FOUR = 5.246e-8, 5.012e-8  # N, of 2 x 1 and of 2 x 2 blocks


@pytest.mark.parametrize(
    ("name", "options", "force"),
    [
        ("reference_ok", (), TWO),
        ("orphan_point", (), TWO),
        ("orphan_line", (), TWO),
        ("one_number_skipped", (), TWO),
        ("volume_in_two_groups", (), TWO / 2),
        ("glued_reference", (), FOUR),
        ("left_handed_half", (), FOUR),
        ("two_blocks", ("--merge-nodes",), FOUR),
        ("gap_1e-13", ("--merge-nodes",), FOUR),
    ],
)
def test_top_force(stretch, read_summary, tmp_path, name, options, force):
    assert stretch(name, *options).code == 0
    assert read_summary(tmp_path / "O")["top_force"] == pytest.approx(force, rel=2e-4)
    with h5py.File(tmp_path / "O" / "fields.vtkhdf") as file:
        root = file["VTKHDF"]
        x = root["Points"][()][root["Connectivity"][()].reshape(-1, 8)]
    assert np.linalg.det(x[:, [1, 3, 4]] - x[:, :1]) == pytest.approx(8e-15, rel=1e-6)  # right-handed in ParaView


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("two_blocks", "got 6 pairs of coincident nodes and 2 parts that touch"),
        ("gap_1e-13", "got 6 pairs of coincident nodes and 2 parts that touch"),
        ("island", "a part of 1 cell is not"),
        ("z_up", "expected the side called bottom across y"),
        ("top_below", "expected the side called bottom across y, at the least y of the body"),
    ],
)
def test_refused(stretch, tmp_path, name, text):
    done = stretch(name)
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert text in done.err
    assert not (tmp_path / "O" / "summary.json").exists()


def turned(tmp_path, order, scale=1.0):
    """glued_reference.msh with its coordinates in another order and unit."""
    lines = (CASES / "mesh" / "glued_reference.msh").read_text().splitlines()
    first = lines.index("$Nodes") + 2
    for i in range(first, lines.index("$EndNodes")):
        number, *x = lines[i].split()
        lines[i] = " ".join([number, *(repr(scale * float(x[k])) for k in order)])
    path = tmp_path / "turned.msh"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("order", [(1, 0, 2), (2, 0, 1), (0, 2, 1), (1, 2, 0)])
def test_a_sheet_along_another_axis(stretch, tmp_path, order):
    done = stretch(turned(tmp_path, order))
    assert done.code == 2
    assert "turn the mesh, or name its sides anew" in done.err


def test_units(stretch, read_summary, tmp_path):
    assert stretch(turned(tmp_path, (0, 1, 2), 1e3), "--mesh-unit", "mm").code == 0
    assert read_summary(tmp_path / "O")["top_force"] == pytest.approx(FOUR, rel=2e-4)
    done = stretch(turned(tmp_path, (0, 1, 2), 1e6))
    assert done.code == 2
    assert "got 40 m, its coordinates taken in m; say their unit (--mesh-unit mm or um, unit in a scene)" in done.err
    done = stretch("glued_reference", "--mesh-unit", "mm")
    assert "got 4e-08 m" in done.err
    done = stretch("glued_reference", "--mesh-unit", "inch")
    assert "unit of the mesh: expected one of m, mm, um, nm, got 'inch'" in done.err


def test_ranks_agree_on_what_is_wrong(launch, read_summary, tmp_path):
    data = (
        "solve",
        "--data",
        CASES / "hdf5" / "stretch_data.h5",
        "--no-plots",
        "--element",
        "trilinear",
        "--out",
        tmp_path / "O",
        "--mesh",
    )
    done = launch(*data, CASES / "mesh" / "island.msh", ranks=2)
    assert done.code == 2
    assert done.err.count("a part of 1 cell is not") == 1
    assert launch(*data, CASES / "mesh" / "two_blocks.msh", "--merge-nodes", ranks=2).code == 0
    assert read_summary(tmp_path / "O")["top_force"] == pytest.approx(FOUR, rel=2e-4)
