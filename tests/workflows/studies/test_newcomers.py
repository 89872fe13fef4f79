"""A method and a load that nobody knew: runs, studies and figures take them as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.errors import InputError
from workflows.runs.compare import compare
from workflows.runs.dns import dns
from workflows.runs.fe2 import fe2
from workflows.runs.loads import LOADS
from workflows.runs.scene import Scene
from workflows.runs.solve import solve
from workflows.studies.convergence import STATES, convergence
from workflows.studies.data_error_figure import plot_data_error
from workflows.studies.methods import entries
from workflows.studies.metric import metric
from workflows.studies.metric_figure import plot_metric
from workflows.studies.one_load import Study
from workflows.studies.prerequisites import Chain

SCENE = Scene("stretch", 0.04, elements=(3, 3, 1))


class Again(dd.PointMethod):
    """Data as points, solved once more from where the first solve ended."""

    def solve(self, projection, search, start=None):
        return super().solve(projection, search, super().solve(projection, search, start).mechanical)


@pytest.fixture
def again(monkeypatch):
    monkeypatch.setitem(dd.METHODS, "again", Again())


def test_a_method_is_solved_with_by_its_name(again, chain, tmp_path):
    summary = solve(tmp_path / "again", data=chain.data, scene=SCENE, method="again")
    once = solve(tmp_path / "once", data=chain.data, scene=SCENE, max_iterations=1000, plots=False)
    assert summary["distance"] <= once["distance"] * (1 + 1e-12)
    assert (tmp_path / "again" / "convergence.png").exists()
    with pytest.raises(InputError, match=r"method: expected one of classical; .*; again, got 'twice'"):
        solve(tmp_path / "twice", data=chain.data, scene=SCENE, method="twice")


def test_a_law_is_a_method_too(chain, tmp_path):
    """Its summary has the figures of Newton's method, and the files are the same."""
    summary = solve(tmp_path, data=chain.data, scene=SCENE, method="linear elastic law")
    assert summary["residual"] < 1e-9
    assert summary["data_points"] == 101
    fields = dd.read_quadrature(tmp_path / "quadrature.h5")
    np.testing.assert_array_equal(fields.material_stress, fields.mechanical_stress)


def test_studies_and_their_figures_have_a_new_method(again, chain, tmp_path, monkeypatch):
    assert entries()[-1].name == "again"
    monkeypatch.setattr("workflows.studies.convergence.METRICS", {"default": ("auto", 1.0)})
    found = convergence(
        tmp_path / "c", chain=Chain(blocks=(3, 3), strain=0.04), loads=["stretch"], data=chain.data, sizes=(50,)
    )
    (row,) = [row for row in found["rows"] if row["method"] == "again"]
    assert row["state"] in STATES[:2]
    assert found["counts_by_method"]["again"][row["state"]] == 1

    study = Study(tmp_path / "m", "stretch", Chain(blocks=(4, 4), strain=0.04), chain.dns, chain.data)
    summary = metric(study, factors=(0.5, 1.0), sizes=(50,), plots=False)
    new = [row | {"method": f"new {k}"} for row in summary["rows"] for k in range(3)]
    figure = plot_metric(summary | {"rows": [*summary["rows"], *new]})
    assert len(figure.axes[0].lines) >= 5

    names = [f"method {k}" for k in range(5)]
    rows = [
        {"source": f"source {s}", "method": name, "states": n, "p": 1 / n, "state": 2 / n}
        for s in range(7)
        for name in names
        for n in (16, 32, 64)
    ]
    nothing = {"slope_p": None, "slope_state": None}
    fits = [{"source": f"source {s}", "method": name, **nothing} for s in range(7) for name in names]
    figure = plot_data_error({"symbol": "p", "rows": rows, "fits": fits})
    assert len(figure.axes[0].get_legend_handles_labels()[0]) == 35


def test_a_load_goes_from_the_tensegrity_to_the_comparison(tmp_path, monkeypatch):
    """A shear across the sheet: a line in the table, and every run knows it."""
    across = replace(LOADS["shear"], axis=2, component="yz", box="full")
    monkeypatch.setitem(LOADS, "across", across)
    scene, tissue = Scene("across", 0.02, elements=(3, 3, 1)), Tissue()
    exact = fe2(tmp_path / "fe2", scene=scene, tissue=tissue, plots=False)
    plan = dd.Adaptation(32, tolerance=0.0)
    found = solve(tmp_path / "dd", data=None, scene=scene, tissue=tissue, adaptation=plan, plots=False)
    assert found["top_force"] == pytest.approx(exact["top_force"], rel=0.02)
    dns(tmp_path / "dns", blocks=(3, 3), load="across", strain=0.02, tissue=tissue, plots=False)
    compared = compare(tmp_path / "compare", dd=tmp_path / "dd", dns=tmp_path / "dns", plots=False)
    assert compared["parameters"]["load"] == "across"
    again = solve(tmp_path / "again", data=tmp_path / "dd" / "data.h5", scene=scene, order=2, plots=False)
    assert again["top_force"] == pytest.approx(found["top_force"], rel=0.01)
    Chain(blocks=(3, 3), strain=0.02).check_reach("across")
    with pytest.raises(InputError, match="within the data's range"):
        Chain(blocks=(3, 3), strain=0.9).check_reach("across")
