"""``tsgdd study metric``, ``convergence`` and ``data-error`` at small size."""

from __future__ import annotations

import csv
import dataclasses

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_law import RVELaw
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset import convert_dataset, take
from tsg_micro.data.dataset_file import read_dataset, write_dataset
from tsg_micro.data.errors import ConvergenceError, InputError
from workflows.runs.scene import Scene
from workflows.runs.tensegrity import read_blocks, solution_errors
from workflows.studies.convergence import STATES, check, convergence
from workflows.studies.data_error import SIX, data_error
from workflows.studies.data_error import _rows as all_rows
from workflows.studies.data_error import _sources as sources
from workflows.studies.data_error_fits import ADAPTIVE, fitted_slope, states_needed
from workflows.studies.fe2_reference import read_exact
from workflows.studies.methods import grid_methods
from workflows.studies.metric import metric
from workflows.studies.one_load import Study, make_bench
from workflows.studies.prerequisites import Chain

SHEET, SMALL = Chain(blocks=(4, 4), strain=0.04), Chain(blocks=(3, 3), strain=0.04)


def plain(load, strain, *, elements):
    """A scene as the studies of the paper have it."""
    return Scene(load, strain, elements=elements, element="trilinear", edges=False)


@pytest.fixture(scope="module")
def scaled(chain, tmp_path_factory):
    """The study of the metric on the runs of the chain."""
    out = tmp_path_factory.mktemp("metric")
    return out, metric(Study(out, "stretch", SHEET, chain.dns, chain.data), factors=(0.3, 1.0, 3.0))


def impatient(monkeypatch):
    """Data as points get a single iteration."""
    for name in ("classical", "classical, omega 1"):
        monkeypatch.setitem(dd.METHODS, name, dd.METHODS[name].tuned(max_iterations=1))


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
    C = dd.Metric(3.0 * np.array(summary["metric"]["classical"]), "3 times")
    bench = make_bench(plain("stretch", 0.04, elements=(4, 4, 1)), C, data, read_blocks(chain.dns, "first_piola"))
    assert bench.solve(data)[0]["error_mech"] == pytest.approx(first[3.0], rel=1e-9)
    C = dd.Metric(3.0 * np.array(summary["metric"]["second order"]), "3 times")
    projection = dd.project(bench.projection.problem, C)
    result = dd.solve_second_order(projection, dd.TangentSearch(data, C))
    found = solution_errors(result, bench.blocks).row("p")
    assert found["error_mech"] == pytest.approx(second[3.0], rel=1e-9)


def test_a_metric_that_does_not_converge_is_a_row_that_says_why(chain, tmp_path, monkeypatch, is_png):
    impatient(monkeypatch)
    study = Study(tmp_path, "stretch", SHEET, chain.dns, chain.data)
    summary = metric(study, factors=(1.0, 10.0), sizes=(100,))
    with (tmp_path / "metric.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["method"] == "classical"]
    assert [row["converged"] for row in rows] == ["False", "False"]
    assert all("expected convergence within 1 iterations" in row["reason"] for row in rows)
    assert len(summary["not_converged"]) == 2
    assert [row["error_mech"] is None for row in summary["spread"]["0.1_to_10"]] == [True, False]
    assert is_png(tmp_path / "metric.png")


def test_measured_data_have_sizes_of_which_tangents_are_estimated(chain, tmp_path):
    """A hundredth of them would be a single one."""
    write_dataset(tmp_path / "m.h5", dataclasses.replace(read_dataset(chain.data), tangent=None))
    study = Study(tmp_path, "stretch", SHEET, chain.dns, tmp_path / "m.h5")
    summary = metric(study, factors=(1.0, 2.0), plots=False)
    assert {row["data"] for row in summary["rows"]} == {4, 100}
    with pytest.raises(InputError, match="sizes: expected numbers of at least 4"):
        metric(study, sizes=(3,))


@pytest.fixture(scope="module")
def grid(chain, tmp_path_factory):
    """The grid of convergence with 10 and 100 data on 3 x 3 elements."""
    out = tmp_path_factory.mktemp("convergence")
    runs = [
        convergence(out / load, chain=SMALL, loads=[load], data=chain.data, sizes=sizes, plots=False)
        for load, sizes in (("stretch", (100,)), ("shear", (10, 100)))
    ]
    return [row for run in runs for row in run["rows"]]


def test_every_cell_of_the_grid_converges_or_says_why(grid):
    assert len(grid) == 3 * 5 * 6
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
    method = grid_methods()[name]
    data = method.given(read_dataset(chain.data))
    scene = plain("shear", 0.04, elements=(4, 3, 1))
    C = dd.metric_from_dataset(data)
    C = dd.Metric(5 * C.C, "far too stiff")  # many iterations
    projection = dd.project(scene.problem(MPI.COMM_SELF), C)
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
    held = {"held": 0} if method.order == 2 else {}
    return dataclasses.replace(result, mechanical=z, index=index, **held)


def test_cells_that_fail_say_why(chain, tmp_path, monkeypatch, is_png):
    impatient(monkeypatch)
    monkeypatch.setattr(
        "workflows.studies.convergence.METRICS", {"default": ("auto", 1.0), "0.1 default": ("auto", 0.1)}
    )
    summary = convergence(tmp_path, chain=SMALL, loads=["stretch"], data=chain.data, sizes=(50,))
    failed = [row for row in summary["not_at_rest"] if row["method"] == "classical"]
    assert len(failed) == summary["counts_by_method"]["classical"]["not converged"] > 0
    assert all("expected convergence within 1 iterations" in row["reason"] for row in failed)
    assert all(row["iterations"] == 1 for row in failed)
    assert is_png(tmp_path / "convergence.png")


def test_slopes_and_states_of_a_power_law():
    sizes = np.array([16.0, 64.0, 256.0, 1024.0])
    errors = 3.0 * sizes**-0.5
    assert fitted_slope(sizes, errors, floor=0.0) == pytest.approx((-0.5, 3.0))
    assert states_needed(sizes, errors, 0.1) == pytest.approx(900.0)
    assert states_needed(sizes, errors, 1.0) == 16.0
    assert states_needed(sizes, errors, 0.09) is None
    up_again = np.array([0.4, 0.09, 0.2, 0.05])
    assert states_needed(sizes, up_again, 0.1) == pytest.approx(256 * 4**0.5)  # from then on for good
    sizes = np.array([16.0, 64.0, 256.0, 1024.0, 4096.0, 16384.0])
    errors = np.hypot(3.0 * sizes**-0.5, 0.05)
    assert fitted_slope(sizes, errors, floor=0.05) == pytest.approx((-0.5, 3.0))
    slope, _ = fitted_slope(sizes, errors, floor=0.0)
    assert slope is not None
    assert slope > -0.45
    assert fitted_slope(sizes[:2], errors[:2], floor=0.0) == fitted_slope(sizes, errors, floor=0.4) == (None, None)


@pytest.fixture(scope="module")
def left(chain, tmp_path_factory):
    """The study of the data error on 3 x 3 blocks."""
    out = tmp_path_factory.mktemp("data-error")
    sheet = Chain(blocks=(3, 3), strain=0.03)
    return out, data_error(out, load="shear", chain=sheet, data=[chain.data], states=128, draws=1, budgets=(4, 32))


def test_tangents_and_adaptive_data_leave_less_error(left, chain, is_png):
    out, summary = left
    assert is_png(out / "data_error.png")
    assert summary["symbol"] == "q"
    sources = [SIX, "box inplane, along paths", ADAPTIVE]
    fits = {(fit["source"], fit["method"]): fit for fit in summary["fits"]}
    assert list(dict.fromkeys(source for source, _ in fits)) == sources
    one, two = (fits[SIX, name] for name in ("classical", "second order"))
    assert two["slope_state"] < 1.4 * one["slope_state"] < 0
    assert summary["slope_ratio"][SIX]["state"] == pytest.approx(two["slope_state"] / one["slope_state"])
    with (out / "data_error.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 3 * (4 + 4) + 2  # 16, 32, 64, and 128 or 100 states
    best = {row["source"]: float(row["state"]) for row in rows if row["method"] == "second order"}  # the most states
    assert best[ADAPTIVE] < best[SIX] < best["box inplane, along paths"]
    assert best[ADAPTIVE] < 0.02
    assert [row["states"] for row in rows if row["source"] == ADAPTIVE] == ["4", "32"]
    assert all(times["at_least"] > 1 for times in summary["random_over_adaptive"] if times["method"] == "classical")


def test_fe2_has_no_error_against_itself(left):
    out, _ = left
    scene = plain("shear", 0.03, elements=(3, 3, 1))
    exact = read_exact(out / "fe2-shear-small-full", scene, Tissue())
    law = RVELaw(RVESpec(free=()).build())
    result = dd.equilibrium(exact.problem, law)
    errors = exact.errors(result)
    assert max(errors[name] or 0.0 for name in errors) < 1e-8
    # 10 % too much stress
    z = dataclasses.replace(result.mechanical, stress=1.1 * result.mechanical.stress)
    errors = exact.errors(dataclasses.replace(result, mechanical=z))
    assert errors["p"] == pytest.approx(0.1)
    assert errors["q"] == pytest.approx(0.1)
    assert errors["state"] is not None
    assert 0 < errors["state"] < 0.1
    box = read_dataset(out / "six-strains-shear" / "data.h5")
    assert box.tangent is not None
    stress, tangent = law.stress_and_tangent(box.strain[:1])
    np.testing.assert_allclose(stress, box.stress[:1], atol=1e-6 * np.abs(stress).max())
    np.testing.assert_allclose(tangent, box.tangent[:1], atol=1e-6 * np.abs(tangent).max())
    assert (box.strain >= exact.strain.min(axis=0)).all()
    assert (box.strain <= exact.strain.max(axis=0)).all()
    for name, other in (
        ("strain", {"strain": 0.04}),
        ("elements", {"elements": (3, 4, 1)}),
        ("load", {"load": "stretch"}),
    ):
        with pytest.raises(InputError, match=f"fe2: expected {name} "):
            read_exact(out / "fe2-shear-small-full", dataclasses.replace(scene, **other), Tissue())
    with pytest.raises(InputError, match="fe2: expected bar_force 2e-08 in"):
        read_exact(out / "fe2-shear-small-full", scene, Tissue(bar_force=2e-8))


def test_data_are_in_the_stress_of_fe2_and_of_its_rve(chain, tmp_path):
    scene, sheet = plain("shear", 0.03, elements=(3, 3, 1)), Chain(blocks=(3, 3), strain=0.03)
    data = read_dataset(chain.data)
    write_dataset(tmp_path / "cauchy.h5", convert_dataset(data, "cauchy"))
    one, two = sources([chain.data, tmp_path / "cauchy.h5"], scene, sheet).values()  # files alike are two sources
    assert one.stress_measure == two.stress_measure == "first_piola"
    np.testing.assert_allclose(two.stress, one.stress, atol=1e-9 * np.abs(one.stress).max())
    with pytest.raises(InputError, match=r"bar_force: expected 2e-08 N in .*data\.h5, got 1e-08 N"):
        sources([chain.data], scene, dataclasses.replace(sheet, bar_force=2e-8))
    few = np.argsort(data.strain[:, 5])[np.linspace(0, len(data) - 1, 9, dtype=int)]
    write_dataset(tmp_path / "few.h5", take(data, few))
    with pytest.raises(InputError, match="expected at least 16 points in"):
        sources([tmp_path / "few.h5"], scene, sheet)


def test_an_adaptive_run_that_fails_is_a_row_that_says_why(left, monkeypatch):
    out, _ = left
    exact = read_exact(out / "fe2-shear-small-full", plain("shear", 0.03, elements=(3, 3, 1)), Tissue())

    def fail(*arguments, **more):
        raise ConvergenceError("it left")

    monkeypatch.setattr("workflows.studies.fe2_reference.adaptive", fail)
    (row,) = all_rows(exact, {}, 1, (4,), Tissue())
    assert (row["states"], row["state"], row["reason"]) == (4, None, "it left")
    assert set(row) == set(left[1]["rows"][0])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("metric", "--load", "stretch", "--data", "no.h5"), "no.h5"),
        (("metric", "--load", "stretch", "--blocks", 2, 2), "blocks: expected at least 3 3"),
        (("convergence", "--size", 3), "sizes: expected numbers of at least 4"),
        (("convergence", "--data", "no.h5"), "loads: expected one beside data"),
        (("convergence", "--data", "no.h5", "--load", "shear"), "no.h5"),
        (("data-error", "--load", "shear", "--data", "no.h5"), "no.h5"),
        (("data-error", "--load", "shear", "--fe2", "nowhere"), "nowhere: expected a folder made by 'tsgdd fe2'"),
        (("data-error", "--load", "shear", "--states", 3), "states, draws, budgets: expected at least 32, 1 and 1"),
    ],
)
def test_bad_input_is_one_line(arguments, text, tsgdd, tmp_path):
    done = tsgdd("study", *arguments, "--out", tmp_path / "out")
    assert done.code == 2
    assert text in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out" / "summary.json").exists()
