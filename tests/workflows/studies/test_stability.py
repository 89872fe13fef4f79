"""The stability benchmark: its check of balance by closed forms, its design, how ends are named, and a small run."""

from __future__ import annotations

import csv
import time
from typing import Any

import numpy as np
import pytest

from tsg_micro.cells.structure import from_arrays
from tsg_micro.data.errors import ConvergenceError, InputError
from workflows.studies.bench_stability import run_case
from workflows.studies.latin import latin_hypercube
from workflows.studies.rebalance import brick_imbalance, imbalance
from workflows.studies.stability_macro import draw_macro
from workflows.studies.stability_micro import SCENES, draw_micro


def test_a_member_of_known_force_is_out_of_balance_by_it():
    """Two bars in a line, the middle node moved by 0.1: forces 2 * 0.1 and -2 * 0.1, 0.4 out of balance, mean 0.2."""
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    two = np.ones(2)
    structure = from_arrays(
        nodes, np.array([[0, 1], [1, 2]]), kind=np.array([2, 2], dtype=np.uint8), EA=2 * two, rest_length=two
    )
    u = np.zeros((3, 3))
    u[1, 0] = 0.1
    held = np.array([[True] * 3, [False] * 3, [True] * 3])
    assert imbalance(structure, u, np.zeros((3, 3)), held=held) == pytest.approx(2.0, rel=1e-12)
    assert imbalance(structure, u, np.zeros((3, 3)), held=np.ones((3, 3), dtype=bool)) == 0.0


@pytest.mark.parametrize("scene", ["in-plane RVE", "bulk"])
def test_a_state_that_is_off_is_seen(scene):
    """In balance as solved, not with one node moved by a nanometre, not under another mean strain."""
    from tsg_micro.continuum.rve_spec import SHEET, RVESpec

    case = draw_micro(scene, 8, 3)[5]
    free = SHEET if scene != "bulk" else ()
    rve = RVESpec.of_kind("bulk" if scene == "bulk" else "sheet", case.tissue, free=free).build()
    state = rve.solve_strain(case.load * np.array(case.direction)).equilibrium
    held = np.zeros(rve.structure.nodes.shape, dtype=bool)
    given: dict[str, Any] = {"held": held, "free": (2, 3, 4) if free else ()}
    assert imbalance(rve.structure, state.displacement, state.H, **given) < 1e-9
    moved = state.displacement.copy()
    moved[7, 1] += 1e-9
    assert imbalance(rve.structure, moved, state.H, **given) > 1e-6
    assert imbalance(rve.structure, state.displacement, state.H + 1e-4 * np.eye(3), **given) > 1e-6


def test_bricks_in_homogeneous_stress_are_in_balance():
    """Stress that grows along y by 1 Pa/m pulls at the node between two bricks with half of each, 1 N in all."""
    unit = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
    up = np.array([0.0, 1.0, 0.0])
    corners = np.stack([unit, unit + up])
    gauss = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
    local = np.array([[x, y, z] for z in gauss for y in gauss for x in gauss])
    points, weights = np.stack([local, local + up]), np.full((2, 8), 0.125)
    stress = np.zeros((2, 8, 6))
    stress[..., 1] = 3.0
    assert brick_imbalance(corners, points, weights, stress) < 1e-15
    stress[..., 1] = 3.0 + points[..., 1]
    # middle nodes: difference of the mean stresses 3.5 and 4.5 of the bricks over 4 nodes; largest force 4.5 / 4
    assert brick_imbalance(corners, points, weights, stress) == pytest.approx((4.5 - 3.5) / 4.5, rel=1e-12)


def test_every_slice_of_a_latin_hypercube_has_one_point():
    points = latin_hypercube(np.random.default_rng(0), 50, 4)
    np.testing.assert_array_equal(np.sort(np.floor(50 * points), axis=0), np.arange(50)[:, None] * np.ones(4))


def test_the_design_covers_what_it_should():
    for scene in SCENES:
        cases = draw_micro(scene, 200, 0)
        for name, low, high in (("bar_force", 1e-11, 1e-6), ("E_ratio", 1e-2, 1e4)):
            values = np.log10([getattr(case, name) for case in cases])
            assert np.log10(low) <= values.min() < np.log10(low) + 0.1
            assert np.log10(high) - 0.1 < values.max() <= np.log10(high)
        assert 0.2 <= min(case.half_diagonal for case in cases) < max(case.half_diagonal for case in cases) <= 0.8
        assert max(case.load for case in cases) <= 0.25
        assert all(np.abs(case.direction).max() == 1.0 for case in cases)
        assert cases == draw_micro(scene, 200, 0) != draw_micro(scene, 200, 1)
    solves = draw_macro("points", 200, 0)
    assert min(case.data for case in solves) <= 2 < 1900 < max(case.data for case in solves) <= 2000
    assert min(case.noise for case in solves) == 0.0 < 0.29 < max(case.noise for case in solves)
    assert sum(case.collinear for case in solves) == 50
    assert max(case.aspect for case in solves) > 900


@pytest.mark.parametrize(
    ("happens", "state", "reason"),
    [
        (ConvergenceError("stopped at 12.5% of the load"), "not converged", "stopped at N of the load"),
        (InputError("bar_force: expected less than 3 N, got 1e-08 N"), "refused", "bar_force: expected less than N N"),
        (ZeroDivisionError("division"), "unnamed", "ZeroDivisionError: division"),
        (None, "time limit", "more than N s"),
    ],
)
def test_every_end_has_a_name(monkeypatch, happens, state, reason):
    case = draw_micro("cell", 1, 0)[0]

    def solve(self):
        if happens is None:
            time.sleep(5)
        raise happens

    monkeypatch.setattr(type(case), "solve", solve)
    row = run_case(case, 0.2 if happens is None else 5.0)
    assert row["state"] == state
    assert row["reason"].startswith(reason)


def test_a_wrong_answer_is_silent(monkeypatch):
    case = draw_micro("cell", 1, 0)[0]
    right = {"iterations": 3, "residual": 1e-11, "rounding": 1e-13, "negative_pivots": 0, "detail": ""}
    for change, state in (({}, "converged"), ({"residual": 1e-6}, "silent"), ({"negative_pivots": 2}, "silent")):
        monkeypatch.setattr(type(case), "solve", lambda self, change=change: right | change)
        assert run_case(case, 5.0)["state"] == state


def test_a_small_run(tsgdd, read_summary, is_png, tmp_path, monkeypatch):
    import workflows.studies.stability_macro as macro

    monkeypatch.setattr(macro, "_PATHS", 3)
    macro.sampled.cache_clear()
    sizes = ("--micro", 2, "--sheets", 0, "--macro", 1, "--processes", 1)
    done = tsgdd("bench", "stability", *sizes, "--out", tmp_path)
    macro.sampled.cache_clear()
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    assert summary["silent"] == summary["unnamed"] == summary["time_limit"] == 0
    assert summary["converged"] + summary["refused"] + summary["not_converged"] == 10
    assert summary["converged"] >= 6
    assert is_png(tmp_path / "stability.png")
    rows = list(csv.DictReader((tmp_path / "micro.csv").open()))
    assert [row["scene"] for row in rows] == [s for s in SCENES if "sheet" not in s for _ in range(2)]
    assert all(row["text"] for row in rows if row["state"] != "converged")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--micro", -1), "micro: expected at least 0, got -1"),
        (("--micro", 0, "--sheets", 0, "--macro", 0), "expected cases, got none"),
        (("--limit", "nan"), "limit: expected a positive number of seconds, got nan"),
        (("--processes", 0), "processes: expected at least 1, got 0"),
    ],
)
def test_what_is_refused(tsgdd, tmp_path, options, text):
    done = tsgdd("bench", "stability", *options, "--out", tmp_path / "O")
    assert done.code == 2
    assert text in done.err
