"""``tsgdd study rve-size`` and ``study sampling`` at small size."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tsg_micro.continuum.long_waves import COMPRESSED, negative_pivots_repeated, tensor_strain
from tsg_micro.continuum.rve import build_rve
from tsg_micro.continuum.sampling import BOXES, strain_path
from tsg_micro.data.dataset_file import read_dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import to_mandel
from workflows.studies.coverage import box_coverage, box_strain
from workflows.studies.rve_size import study_rve_size
from workflows.studies.sampling import study_sampling


@pytest.fixture(scope="module")
def sizes(tmp_path_factory):
    """The study of 1x1 to 3x3 blocks."""
    out = tmp_path_factory.mktemp("studies") / "sizes"
    study_rve_size(out, largest=3, bar_force=[1e-8])
    return out


@pytest.fixture(scope="module")
def sampled(tmp_path_factory):
    """The study of sampling for both loads, 48 data and 8 elements each."""
    out = tmp_path_factory.mktemp("studies") / "sampled"
    study_sampling(out, paths=12, steps=4, elements=(4, 2), plots=False)
    return out


def test_merged_is_flat_and_duplicated_falls_like_one_over_n(sizes, read_summary, is_png):
    summary = read_summary(sizes)
    assert summary["sizes"] == [1, 2, 3]
    assert 0.0 < summary["merged_largest_deviation"] < 1e-8
    assert summary["unstable_states"] == []
    assert summary["duplicated_slope_min"] == pytest.approx(-1.0, abs=0.15)
    assert summary["duplicated_slope_max"] == pytest.approx(-1.0, abs=0.15)
    n = np.array(summary["sizes"])
    for quantity in ("energy_change", "stress"):
        for loading, forces in summary["errors_duplicated"][quantity].items():
            for force, errors in forces.items():
                slope = np.polyfit(np.log(n), np.log(errors), 1)[0]
                assert slope == pytest.approx(summary["slopes"][quantity][loading][force], rel=1e-9)
                assert slope == pytest.approx(-1.0, abs=0.15), (quantity, loading, force)
    assert all(is_png(sizes / name) for name in ("rve_size.png", "energy.png", "buckling_shear.png"))
    assert not (sizes / "buckling_stretch.png").exists()


def test_rve_size_command(tsgdd, read_summary, tmp_path):
    done = tsgdd("study", "rve-size", "--largest", 2, "--bar-force", 5e-8, "--no-plots", "--out", tmp_path)
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    assert summary["parameters"]["bar_force"] == [5e-8]
    assert done.out.splitlines()[-2] == summary["answer"]
    assert summary["error_at_3x3"] is None
    assert not list(tmp_path.glob("*.png"))


def test_answer_holds_the_figures(sizes, read_summary):
    summary = read_summary(sizes)
    worst = np.array(summary["duplicated_largest_error"])
    everything = [
        errors
        for quantity in ("energy_change", "stress")
        for forces in summary["errors_duplicated"][quantity].values()
        for errors in forces.values()
    ]
    np.testing.assert_allclose(worst, np.max(everything, axis=0))
    assert summary["error_at_3x3"] == worst[2]
    needed = summary["blocks_for_1_percent"]
    slope = np.log(worst[2] / worst[1]) / np.log(3 / 2)
    assert worst[2] * (needed / 3) ** slope <= 0.01 < worst[2] * ((needed - 1) / 3) ** slope
    answer = summary["answer"]
    assert answer.count(". ") == 0
    assert f"{summary['merged_largest_deviation']:.0e}, nothing larger is needed" in answer
    assert f"3x3 is off by {worst[2]:.1%}" in answer
    assert f"1 % needs {needed}x{needed}" in answer


def test_energy_change_is_the_work_of_the_stress(sizes, read_summary):
    change = read_summary(sizes)["energy_change"]["duplicated"]["biaxial"]["1e-08"]
    rve = build_rve(bar_force=1e-8, blocks=(2, 2, 1), images="duplicated")
    nodes, weights = np.polynomial.legendre.leggauss(6)
    work = 0.0
    for s, w in zip(0.5 * (1.0 + nodes), 0.5 * weights, strict=True):
        P = rve.solve_strain(tensor_strain({"xx": 0.05, "yy": 0.05}, s)).first_piola
        work += w * 0.05 * (P[0, 0] + P[1, 1])
    assert work == pytest.approx(change[1], rel=1e-7)


def test_repeated_state_is_an_equilibrium_of_the_larger_rve():
    one, many = (build_rve(bar_force=1e-8, blocks=(n, n, 1)) for n in (1, 3))
    state = one.solve_strain(tensor_strain({"xx": -0.02, "yy": 0.04, "xy": 0.02}))
    assert negative_pivots_repeated(state, one, many) == 0
    system = many.solver.system
    members = system.state(many.solver.y)
    assert system.energy(members) == pytest.approx(9 * state.equilibrium.energy, rel=1e-12)
    gradient = system.gradient(members)
    force = np.abs(members.force).mean()
    inside = np.ptp(many.structure.nodes[:, 2]) / 2  # the faces carry the constraints' forces
    middle = np.abs(many.structure.nodes[:, 2] - many.structure.nodes[:, 2].mean()) < 0.99 * inside
    assert np.abs(gradient[:-9].reshape(-1, 3)[middle]).max() < 1e-10 * force
    np.testing.assert_allclose(gradient[-9:], 9 * state.equilibrium.macro_force.ravel(), rtol=0, atol=1e-6 * force)


def test_buckling_that_is_found_lowers_the_energy(sizes, read_summary):
    buckling = read_summary(sizes)["buckling"]
    assert all(onset == [None, None] for onset in buckling["stretch"]["onset"].values())
    onset = buckling["shear"]["onset"]["1e-08"]
    assert 0.3 < onset[1] < onset[0] < 1.0  # a larger RVE holds the longer wave
    one, two = (build_rve(bar_force=1e-8, blocks=(n, n, 1)) for n in (1, 2))
    for fraction, buckles in ((0.95 * onset[0], False), (1.05 * onset[0], True)):
        strain = tensor_strain(COMPRESSED["shear"], fraction)
        periodic = one.solve_strain(strain).energy
        two.reset()
        stable = two.solve_strain(strain)
        assert stable.equilibrium.negative_pivots == 0
        assert (stable.energy < periodic * (1 - 1e-6)) == buckles
        if not buckles:
            assert stable.energy == pytest.approx(periodic, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("rve-size", "--largest", 0), "largest: expected 2"),
        (("rve-size", "--bar-force", -1e-9), "bar_force: expected positive"),
        (("rve-size", "--bar-force", 1e-9, "--bar-force", 1e-9), "bar_force: expected different forces"),
        (("sampling", "--data", "missing.h5"), "missing.h5: no such file"),
        (("sampling", "--dd", "missing"), "missing: expected a folder made by 'tsgdd solve'"),
        (("sampling", "--paths", 0), "expected at least 40 points"),
        (("sampling", "--bar-force", 0), "bar_force: expected positive"),
        (("sampling", "--elements", 0, 3), "elements: expected at least 1"),
        (("sampling", "--load", "twist"), "twist"),
    ],
)
def test_bad_input_is_one_line(arguments, message, tsgdd, tmp_path):
    done = tsgdd("study", *arguments, "--out", tmp_path / "out")
    assert done.code == 2
    assert len(done.err.strip().splitlines()) == 1
    assert message in done.err
    assert not (tmp_path / "out").exists()


def test_sampling_of_both_loads(sampled, read_summary):
    summary = read_summary(sampled)
    assert summary["loads"] == ["stretch", "shear"]
    for load in summary["loads"]:
        data = read_dataset(sampled / f"data-{load}.h5")
        assert summary[f"{load}_points"] == len(data) == 48
        least, mean, most = summary[f"{load}_counts_min_mean_max"]
        assert least <= mean <= most
        assert mean * 100 == len(data) - summary[f"{load}_points_outside_box"]
        assert summary[f"{load}_quadrature_points"] == 64
        assert 0 < summary[f"{load}_share_of_data_used"] <= 1
        rms = {name: np.array(list(v.values())) for name, v in summary[f"{load}_strain_rms"].items()}
        # the gap is a difference of the two states, component by component
        assert (np.abs(rms["mechanical"] - rms["material"]) <= rms["gap"] + 1e-15).all()
        assert (rms["gap"] <= rms["mechanical"] + rms["material"] + 1e-15).all()
        zero = rms["data"] < 1e-12
        square = rms["mechanical"] ** 2
        assert summary[f"{load}_strain_not_spanned"] == pytest.approx(square[zero].sum() / square.sum())
    # stretch holds gamma_xy, shear holds eps_xx
    assert summary["stretch_strain_rms"]["data"]["xy"] == 0 == summary["shear_strain_rms"]["data"]["xx"]


def test_sampling_of_given_files(tsgdd, sampled, read_summary, is_png, chain, tmp_path):
    files = ("--data", sampled / "data-shear.h5", "--dd", sampled / "dd-shear")
    assert tsgdd("study", "sampling", *files[2:], "--out", tmp_path / "1").code == 0  # the folder tells its data
    summary, first = read_summary(tmp_path / "1"), read_summary(sampled)
    names = [name for name in first if name.startswith("shear_")]
    assert len(names) > 10
    assert {name: summary[name] for name in names} == {name: first[name] for name in names}
    assert all(is_png(tmp_path / "1" / f"{name}.png") for name in ("pq_paths", "coverage_shear", "visited_shear"))
    other = tsgdd("study", "sampling", "--load", "stretch", *files[2:], "--out", tmp_path / "2")
    assert other.code == 2
    assert "load: expected stretch" in other.err
    mixed = tsgdd("study", "sampling", *files[:2], "--load", "stretch", "--out", tmp_path / "2")
    assert mixed.code == 2
    assert "were sampled for 'shear'" in mixed.err
    undecided = tsgdd("study", "sampling", "--data", chain.data, "--out", tmp_path / "3")
    assert undecided.code == 2
    assert "load: expected stretch or shear" in undecided.err


def test_solution_with_other_data_is_refused(tsgdd, chain, tmp_path):
    data = read_dataset(chain.data)
    write_dataset(tmp_path / "d.h5", dataclasses.replace(data, strain=1.01 * data.strain))
    done = tsgdd(
        *("study", "sampling", "--load", "stretch", "--data", tmp_path / "d.h5", "--dd", chain.dd, "--out", tmp_path)
    )
    assert done.code == 2
    assert "expected a solution made with these data" in done.err


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 2**31))
def test_gaps_fall_like_the_square_root_of_the_number_of_points(seed):
    points = np.random.default_rng(seed).uniform(size=(1500, 2))
    cover = box_coverage(points, seed=seed)
    assert cover.counts.sum() == 1500
    assert cover.outside == 0
    assert cover.sizes[-1] == 1500
    assert (np.diff(cover.gap_by_size) < 0).all()
    assert cover.fill_by_size[-1] < 0.4 * cover.fill_by_size[0]
    assert cover.slope(cover.gap_by_size) == pytest.approx(-0.5, abs=0.06)
    assert -0.6 < cover.slope(cover.fill_by_size) < -0.3
    assert 2 * cover.mean_neighbour * np.sqrt(1500) == pytest.approx(1.0, abs=0.1)  # Poisson points


def test_gaps_of_a_square_grid():
    a = (np.arange(20) + 0.5) / 20
    points = np.stack(np.meshgrid(a, a), axis=-1).reshape(-1, 2)
    cover = box_coverage(points)
    assert cover.fill_distance == pytest.approx(np.sqrt(0.5) / 20)  # a corner of a cell
    assert cover.mean_neighbour == pytest.approx(1 / 20)
    # mean distance in a square of side a from its centre: a (sqrt 2 + asinh 1) / 6
    assert cover.mean_gap == pytest.approx((np.sqrt(2) + np.arcsinh(1)) / 6 / 20, rel=0.03)
    assert (cover.counts == 4).all()
    assert box_coverage(points + np.array([0.05, 0.0])).outside == 20


@pytest.mark.parametrize("load", ["stretch", "shear"])
def test_box_strain_puts_the_ends_of_paths_on_the_boundary(load):
    ranges = BOXES[load].ranges.values()
    tensors = np.zeros((2, 3, 3))
    for name, (low, high) in BOXES[load].ranges.items():
        a, b = ("xyz".index(axis) for axis in name)
        tensors[:, a, b] = tensors[:, b, a] = low, high
    np.testing.assert_allclose(box_strain(to_mandel(tensors), load), [[0, 0], [1, 1]], atol=1e-14)
    points = np.concatenate([strain_path(BOXES[load], steps=6, seed=1, path=k) for k in range(40)])
    inside = box_strain(points, load)
    assert len(ranges) == 2
    assert inside.min() >= -1e-12
    assert inside.max() <= 1 + 1e-12


def test_too_few_points_for_a_study():
    with pytest.raises(InputError, match="expected at least 40 points"):
        box_coverage(np.random.default_rng(0).uniform(size=(39, 2)))
