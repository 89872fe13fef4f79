"""``tsgdd bench frontier`` at small size: its points against other routes to the same figures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import dd_macro as dd
from dd_macro.results.compare import interior_blocks
from tsg_micro.data.errors import ConvergenceError, InputError
from workflows.studies.bench_frontier import frontier
from workflows.studies.methods import entries
from workflows.studies.one_load import Study
from workflows.studies.prerequisites import Chain

FEW = tuple(method for method in entries() if not method.name.endswith(("visited", "secant", "energy law")))
MODELS = ("small strain", "finite strain, in-plane clamps")
SCENE = ("--load", "stretch", "--blocks", 4, 4, "--strain", 0.04)


@pytest.fixture(scope="module")
def run(chain, tmp_path_factory):
    """Two models of the chain's scene; its folder and summary."""
    out = tmp_path_factory.mktemp("frontier")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("workflows.studies.bench_frontier._REPEATS", 1)
        patch.setattr("workflows.studies.bench_frontier.entries", lambda: FEW)
        study = Study(out, "stretch", Chain(blocks=(4, 4), strain=0.04), chain.dns, chain.data)
        return out, frontier(study, models=MODELS, budgets=(2, 8, 32))


def points(summary, method, model=MODELS[0]):
    return [p for p in summary["points"] if p["method"] == method and p["model"] == model]


def test_every_method_is_there(run, is_png):
    out, summary = run
    for method in FEW:
        for model in MODELS[: len(method.theories)]:
            assert [p["data"] for p in points(summary, method.name, model)] == [1, 10, 100]
    for model in MODELS:
        assert len(points(summary, "FE2", model)) == 1
        assert [p["data"] for p in points(summary, "adaptive from nothing", model)] == [2, 8, 32]
    assert is_png(out / "frontier.png")
    assert len((out / "frontier.csv").read_text().splitlines()) == 1 + len(summary["points"])
    for point in summary["points"]:
        assert (point["error_mech"] is None) == point["note"].startswith("failed")
    failed = points(summary, "second-order data, estimated tangents")[0]  # one datum has no neighbours
    assert failed["note"] == "failed: neighbours: expected 3 to 0, less than there are data, got 0"


def test_what_the_data_leave(run):
    _, summary = run
    for model in MODELS:
        adapted = [p["error_fe2"] for p in points(summary, "adaptive from nothing", model)]
        assert adapted[-1] < 0.003
        assert adapted[-1] < 0.2 * points(summary, "second-order data", model)[-1]["error_fe2"]
        floor = points(summary, "FE2", model)[0]["error_mech"]
        last = points(summary, "adaptive from nothing", model)[-1]
        assert last["error_mech"] == pytest.approx(floor, abs=2 * last["error_fe2"])


def test_errors_are_those_of_solve_and_compare(run, chain, tsgdd, read_summary, nameless, tmp_path):
    out, summary = run
    solve = ("solve", "--data", nameless(chain.data, tmp_path), "--elements", 4, 4, 1, "--strain", 0.04)
    for order, folder in ((1, "points"), (2, "dd")):
        more = ("--element", "trilinear", "--order", order, "--no-plots", "--out", tmp_path / folder)
        assert tsgdd(*solve, *more).code == 0
    for folder, method in (
        (tmp_path / "points", "data-driven, metric tangent"),
        (tmp_path / "dd", "second-order data"),
    ):
        assert tsgdd("compare", "--dd", folder, "--dns", chain.dns, "--out", tmp_path / "c", "--no-plots").code == 0
        compared, point = read_summary(tmp_path / "c"), points(summary, method)[-1]
        for name in ("mech", "mat"):
            assert point[f"error_{name}"] == pytest.approx(compared[f"error_p_{name}"]["l2"], rel=1e-6)
            assert point[f"error_{name}_all"] == pytest.approx(compared[f"error_p_{name}"]["l2_all"], rel=1e-6)
    found, exact = (
        dd.read_quadrature(folder / "quadrature.h5") for folder in (tmp_path / "dd", out / "fe2-stretch-small-full")
    )
    inner = interior_blocks(exact.midpoint)
    p, q = (fields.cell_mean(fields.mechanical_p)[inner] for fields in (found, exact))
    assert point["error_fe2"] == pytest.approx(np.linalg.norm(p - q) / np.linalg.norm(q), rel=1e-6)


def test_ratios_are_of_the_times_with_sampling(run):
    _, summary = run
    reached = [p for p in summary["points"] if p["error_mech"] is not None]
    for (name, ratio), point in zip(summary["dns_over_all"].items(), reached, strict=True):
        seconds = point["seconds_solve"] + point["seconds_sampling"]
        assert ratio == pytest.approx(summary["dns_seconds"] / seconds)
        assert name.startswith(point["method"])
    near = [p for p in reached if p["error_mech"] <= 0.03 and p["error_fe2"] is not None and p["error_fe2"] <= 0.01]
    assert (summary["quickest_near"] is None) == (not near)


def test_fe2_is_taken_from_where_it_is(run, chain, tsgdd, read_summary, tmp_path, monkeypatch):
    out, summary = run
    given = ("--dns", chain.dns, "--data", chain.data, "--fe2", out / "fe2-stretch-small-full")
    done = tsgdd("bench", "frontier", *given, "--out", tmp_path / "no")
    assert done.code == 2
    assert "load: expected stretch or shear beside --dns, --data or --fe2" in done.err
    done = tsgdd("bench", "frontier", *SCENE, "--bar-force", 2e-8, *given[4:], "--out", tmp_path / "no")
    assert done.code == 2
    assert "fe2: expected bar_force 2e-08 in" in done.err
    for name, value in (("degree", 2), ("clamp", "inplane")):  # of no model
        other = tmp_path / name
        other.mkdir()
        there = read_summary(given[-1])
        there["parameters"][name] = value
        (other / "summary.json").write_text(json.dumps(there))
        done = tsgdd("bench", "frontier", *SCENE, "--fe2", other, "--out", tmp_path / "no")
        assert done.code == 2
        assert f"fe2: expected {name} " in done.err
    done = tsgdd("bench", "frontier", *SCENE, *given[4:], *given[4:], "--out", tmp_path / "no")
    assert done.code == 2
    assert "fe2: expected one folder of every model" in done.err
    assert not (tmp_path / "no").exists()

    def fail(*arguments):
        raise ConvergenceError("it left")

    # one model from the folder, and one whose FE2 fails
    monkeypatch.setattr("workflows.studies.bench_frontier._REPEATS", 1)
    monkeypatch.setattr(Chain, "fe2", fail)
    monkeypatch.setattr("workflows.studies.bench_frontier.entries", lambda: entries()[:1])
    study = Study(tmp_path / "2", "stretch", Chain(blocks=(4, 4), strain=0.04), chain.dns, chain.data)
    models = ("small strain", "finite strain")
    with pytest.raises(InputError, match="models: expected some of small strain, "):
        frontier(study, models=["large strain"])
    again = frontier(study, fe2=[Path(given[-1])], models=models, budgets=(8,), plots=False)
    assert points(again, "FE2")[0] == points(summary, "FE2")[0]
    assert points(again, "FE2", models[1])[0]["note"] == "failed: it left"
    adapted = points(again, "adaptive from nothing", models[1])[0]
    assert adapted["error_mech"] is not None
    assert adapted["error_fe2"] is None
