"""Errors of default answers on a family of scenes, and what they are made of."""

from __future__ import annotations

import numpy as np
import pytest

from workflows.studies.accuracy_cases import CASES, ZONES, BodyCase, SheetCase
from workflows.studies.bench_accuracy import accuracy


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    out = tmp_path_factory.mktemp("accuracy")
    case = SheetCase((5, 4), "stretch", 1e-8)
    plain = {"element": "trilinear", "edges": False}
    return out, {edges: accuracy(out, cases=[case], options={} if edges else plain) for edges in (False, True)}


def test_parts_of_the_error_bound_it(bench):
    for summary in bench[1].values():
        assert [row["zone"] for row in summary["rows"]] == list(ZONES)
        for row in summary["rows"]:
            assert row["error"] <= (row["element"] + row["rest"]) * (1 + 1e-9)
            assert row["data"] < 0.02  # what adaptive sampling leaves


def test_zones_are_all_blocks(bench):
    for summary in bench[1].values():
        errors = {row["zone"]: row["error"] for row in summary["rows"]}
        assert errors["all"] <= max(errors[zone] for zone in ("inner", "rows", "columns"))
        assert summary["worst"] == errors


def test_edges_of_their_own_take_most_of_the_error(bench):
    plain, edged = ({row["zone"]: row["error"] for row in bench[1][e]["rows"]} for e in (False, True))
    assert edged["all"] < 0.5 * plain["all"]
    assert edged["columns"] < 0.5 * plain["columns"]


def test_full_tensegrities_are_kept(bench, is_png):
    out, summaries = bench
    seconds = {summary["rows"][0]["dns_seconds"] for summary in summaries.values()}
    assert len(seconds) == 1
    assert is_png(out / "accuracy.png")


def test_the_family_has_many_shapes():
    assert len({case.name for case in CASES}) == len(CASES) >= 12
    sheets = [case for case in CASES if isinstance(case, SheetCase)]
    assert {case.load for case in sheets} == {"stretch", "shear"}
    assert np.ptp([np.log10(case.bar_force) for case in sheets]) > 1.3
    assert {case.symbol for case in CASES if isinstance(case, BodyCase)} == {"p", "q"}


def test_a_body(tmp_path):
    """A small spheroid has no clamp; what its zones hold is all of it."""
    load = (("side", "surface"), ("pressure", 5.0))
    case = BodyCase("ball", "p", (("spheroid", 1.5),), 1e-8, (load,))
    errors = {row["zone"]: row["error"] for row in accuracy(tmp_path, cases=[case], parts=False)["rows"]}
    assert errors["rows"] is None
    assert errors["inner"] is None  # every block of it has an outer face
    assert errors["all"] == errors["columns"] < 0.1


def test_bad_cases_are_one_line(tsgdd, tmp_path):
    done = tsgdd("bench", "accuracy", "--case", "99", "--out", tmp_path)
    assert done.code == 2
    assert "case: expected numbers from 1 to" in done.err
