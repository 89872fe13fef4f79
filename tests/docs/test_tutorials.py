"""Every tutorial runs to its end, checks a number and has a picture; the reference has all public names."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import sys
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import dd_macro
import meshes
import tsg_micro

DOCS = Path(__file__).parents[2] / "docs"
BIN = Path(sys.executable).parent
TUTORIALS = sorted((DOCS / "tutorials").glob("*.py"))


@pytest.mark.usefixtures("may_mpirun")
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_it_runs_and_draws(path, tmp_path, monkeypatch):
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is not None and mpi.COMM_WORLD.size > 1:
        pytest.skip("runs in one process")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    if "import tifffile" in path.read_text():
        pytest.importorskip("tifffile", exc_type=ImportError)
    if '"mpirun"' in path.read_text() and shutil.which("mpirun", path=f"{BIN}{os.pathsep}{os.environ['PATH']}") is None:
        pytest.skip("no mpirun")
    assert "\nassert " in path.read_text()
    figure = runpy.run_path(str(path))["figure"]
    assert isinstance(figure, Figure)
    assert figure.axes


def test_the_readme_leads_to_each():
    readme = (DOCS.parent / "README.md").read_text()
    links = set(re.findall(r"\]\(([^):]+)\)", readme))
    assert {f"docs/tutorials/{path.name}" for path in TUTORIALS} <= links
    assert [link for link in links if not (DOCS.parent / link).exists()] == []
    assert len(readme.splitlines()) <= 100


@pytest.mark.parametrize("package", [tsg_micro, dd_macro, meshes], ids=lambda package: package.__name__)
def test_the_reference_has_every_public_name(package):
    page = (DOCS / "reference" / f"{package.__name__}.rst").read_text()
    listed = re.findall(r"^   (\w+)$|^\.\. data:: (\w+)$", page, re.MULTILINE)
    names = [one or other for one, other in listed]
    assert sorted(names) == sorted(package.__all__)
