"""The bar is for people: on a terminal alone, one at a time; what a method knows of its own way is in [0, 1]."""

from __future__ import annotations

import io
import sys

import pytest
from mpi4py import MPI

import dd_macro as dd
import tsg_micro as tsg
from workflows.runs.progress import progress, tracked


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("kind", [Terminal, io.StringIO])
def test_a_bar_on_a_terminal_alone(monkeypatch, kind):
    stream = kind()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    with progress("outer [bold]", 4.0) as told:
        told(1.0)
        assert list(tracked(["a", "b"], "inner")) == ["a", "b"]
        told(4.0)
    shown = stream.getvalue()
    assert ("outer [bold]" in shown and "100%" in shown and "left" in shown) == (kind is Terminal)
    assert "inner" not in shown
    assert bool(shown) == (kind is Terminal)
    assert list(tracked(range(3), "again")) == [0, 1, 2]  # the first one is over
    assert ("again" in stream.getvalue()) == (kind is Terminal)


@pytest.mark.parametrize("name", ["FE2", "adaptive"])
def test_methods_tell_how_far_they_are(name):
    operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
    problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))])
    spec = tsg.RVESpec.of_kind("sheet", tsg.Tissue())
    newton = dd.LawMethod(steps=2), dd.Material(law=tsg.RVELaw(spec.build()))
    asked = dd.METHODS["adaptive"], dd.Material(source=tsg.RVESource(spec), measure="first_piola")
    method, material = newton if name == "FE2" else asked
    told: list[float] = []
    method.prepare(problem, material).solve(watch=dd.Watch(done=told.append))
    assert 0.0 <= min(told) < max(told) == told[-1] == pytest.approx(1.0, abs=1e-12)
    assert told == sorted(told) or name == "adaptive"  # the estimated error of a round may be above that before
