"""``tsgdd study metric``, ``convergence`` and ``data-error`` at small size."""

from __future__ import annotations

import csv
import dataclasses

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.dataset import read_dataset
from workflows.chain import Chain
from workflows.methods import CLASSICAL, SECOND_ORDER, SecondOrder
from workflows.reference import read_blocks, solution_errors
from workflows.scene import Scene
from workflows.study_convergence import STATES, check, convergence
from workflows.study_metric import metric
from workflows.trial import Study, make_bench

SHEET = Chain(blocks=(4, 4), strain=0.04)


@pytest.fixture(scope="module")
def scaled(chain, tmp_path_factory):
    """The study of the metric on the runs of the chain."""
    out = tmp_path_factory.mktemp("metric")
    return out, metric(Study(out, "stretch", SHEET, chain.dns, chain.data), factors=(0.3, 1.0, 3.0))


def errors(summary, method, size):
    return {
        row["factor"]: row["error_mech"] for row in summary["rows"] if (row["method"], row["data"]) == (method, size)
    }


def test_the_metric_matters_to_points_and_not_to_tangent_spaces(scaled, chain, is_png):
    out, summary = scaled
    assert is_png(out / "metric.png")
    first, second = (errors(summary, method, 100) for method in ("classical", "second order"))
    assert list(first) == list(second) == [0.3, 1.0, 3.0]
    assert np.ptp(list(second.values())) < np.ptp(list(first.values()))  # though 100 data are few
    spread = {(row["method"], row["data"]): row["error_mech"] for row in summary["spread"]["0.3_to_3"]}
    assert spread["classical", 100] == pytest.approx(np.ptp(list(first.values())), rel=1e-12)
    assert spread["second order", 100] == pytest.approx(np.ptp(list(second.values())), rel=1e-12)

    data = read_dataset(chain.data)
    C = dd.Metric(3.0 * np.array(summary["metric"]), "3 times")
    bench = make_bench(Scene("stretch", 0.04, elements=(4, 4, 1)), C, data, read_blocks(chain.dns, "first_piola"))
    assert bench.solve(data)[0]["error_mech"] == pytest.approx(first[3.0], rel=1e-9)
    result = dd.solve_second_order(bench.projection, dd.TangentSearch(data, C))
    found = solution_errors(bench.operator, C, result, bench.blocks).row("p")
    assert found["error_mech"] == pytest.approx(second[3.0], rel=1e-9)


def test_a_metric_that_does_not_converge_is_a_row_that_says_why(chain, tmp_path, monkeypatch, is_png):
    monkeypatch.setattr("workflows.methods._PATIENT", 1)
    study = Study(tmp_path, "stretch", SHEET, chain.dns, chain.data)
    summary = metric(study, factors=(1.0, 10.0), sizes=(100,))
    with (tmp_path / "metric.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["method"] == "classical"]
    assert [row["converged"] for row in rows] == ["False", "False"]
    assert all("expected convergence within 1 iterations" in row["reason"] for row in rows)
    assert len(summary["not_converged"]) == 2
    assert [row["error_mech"] is None for row in summary["spread"]["0.1_to_10"]] == [True, False]
    assert is_png(tmp_path / "metric.png")


@pytest.fixture(scope="module")
def grid(chain, tmp_path_factory):
    """The grid of convergence with 10 and 100 data on 4 x 4 elements."""
    out = tmp_path_factory.mktemp("convergence")
    runs = [
        convergence(out / load, chain=SHEET, loads=[load], data=chain.data, sizes=(10, 100), plots=False)
        for load in ("stretch", "shear")
    ]
    return [row for run in runs for row in run["rows"]]


def test_every_cell_of_the_grid_converges_or_says_why(grid):
    assert len(grid) == 2 * 5 * 2 * 6
    for row in grid:
        assert row["state"] in STATES[:5], row
        assert row["iterations"] > 0, row
        assert (row["held"] or 0) == 0 or f"{row['held']} points held" in row["reason"], row
    states = [row["state"] for row in grid]
    assert states.count("fixed point") > 0.7 * len(grid)
    classical = [row for row in grid if row["method"].startswith("classical")]
    assert {row["state"] for row in classical} <= {"fixed point", "distance settled"}


@pytest.mark.parametrize("name", ["classical", "second order", "second order, 2 % noise, averages"])
def test_a_false_claim_is_found(name, chain):
    data = read_dataset(chain.data)
    method = (CLASSICAL | SECOND_ORDER)[name]
    scene = Scene("shear", 0.04, elements=(4, 3, 1))
    domain = scene.build(MPI.COMM_SELF)
    C = dd.metric_from_dataset(data)
    C = dd.Metric(5 * C.C, "far too stiff")  # many iterations
    projection = dd.Projection(dd.StrainOperator(domain), C, scene.conditions(domain))
    search = method.search(data, C)
    result = method.solve(projection, search)
    assert result.iterations > 1
    assert check(projection, method, search, result)["state"] in STATES[:4]
    unfinished = claim(method, projection, search, projection.elastic(), result)
    assert check(projection, method, search, unfinished)["state"] == "not verified"
    z = result.mechanical
    crooked = dataclasses.replace(result, mechanical=dataclasses.replace(z, stress=1.01 * z.stress + 1.0))
    assert check(projection, method, search, crooked)["state"] == "not verified"


def claim(method, projection, search, z, result):
    """The first iterate, called converged."""
    z = method.once(projection, search, z)
    index, _ = search.nearest(search.metric.whiten(z.strain, z.stress))
    held = {"held": 0} if isinstance(method, SecondOrder) else {}
    return dataclasses.replace(result, mechanical=z, index=index, **held)


def test_cells_that_fail_say_why(chain, tmp_path, monkeypatch, is_png):
    monkeypatch.setattr("workflows.methods._PATIENT", 1)
    summary = convergence(tmp_path, chain=SHEET, loads=["stretch"], data=chain.data, sizes=(50,))
    failed = [row for row in summary["not_at_rest"] if row["method"] == "classical"]
    assert len(failed) == summary["counts_by_method"]["classical"]["not converged"] > 0
    assert all("expected convergence within 1 iterations" in row["reason"] for row in failed)
    assert all(row["iterations"] == 1 for row in failed)
    assert is_png(tmp_path / "convergence.png")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("metric", "--load", "stretch", "--data", "no.h5"), "no.h5"),
        (("metric", "--load", "stretch", "--blocks", 2, 2), "blocks: expected at least 3 3"),
        (("convergence", "--size", 3), "sizes: expected numbers of at least 4"),
        (("convergence", "--data", "no.h5"), "loads: expected one beside data"),
        (("convergence", "--data", "no.h5", "--load", "shear"), "no.h5"),
    ],
)
def test_bad_input_is_one_line(arguments, text, tsgdd, tmp_path):
    done = tsgdd("study", *arguments, "--out", tmp_path / "out")
    assert done.code == 2
    assert text in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out" / "summary.json").exists()
