"""Examples in the docstrings of public names give what they show; fifty names and more have one."""

from __future__ import annotations

import doctest
import inspect

import numpy as np
import pytest

import dd_macro
import meshes
import tsg_micro

PACKAGES = (tsg_micro, dd_macro, meshes)


def examples():
    """Every example of the public names: those of their docstrings and of their public methods."""
    finder = doctest.DocTestFinder(recurse=False)
    for package in PACKAGES:
        for name in package.__all__:
            one = getattr(package, name)
            inside = vars(one).items() if inspect.isclass(one) else ()
            methods = ((f"{name}.{part}", value) for part, value in inside if inspect.isfunction(value))
            for title, thing in ((name, one), *methods):
                if ">>>" in (getattr(thing, "__doc__", None) or ""):
                    yield from finder.find(thing, f"{package.__name__}.{title}", globs={})


EXAMPLES = list(examples())


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_it_gives_what_it_shows(example, tmp_path, monkeypatch):
    mpi = pytest.importorskip("mpi4py.MPI", exc_type=ImportError)
    if mpi.COMM_WORLD.size > 1:
        pytest.skip("runs in one process")
    monkeypatch.chdir(tmp_path)
    example.globs |= {"np": np, "tsg": tsg_micro, "dd": dd_macro, "meshes": meshes, "MPI": mpi}
    printed: list[str] = []
    failed = doctest.DocTestRunner().run(example, out=printed.append, clear_globs=True).failed
    assert not failed, "".join(printed)


def test_fifty_have_one():
    assert len(EXAMPLES) >= 50
