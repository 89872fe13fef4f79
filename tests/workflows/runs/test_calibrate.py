"""``tsgdd calibrate`` finds what it did not see: parameters behind noisy curves at loads of their own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tsg_micro.bodies.curve_fit import PARAMETERS, Model, fit_curve
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.tissue import Tissue
from workflows.runs.calibrate import parameter_names

TRUTH = Model("cell", Tissue(CellParameters(E_tendon=6e6), 4e-9))


def curve(model, loads, noise, seed):
    rng = np.random.default_rng(seed)
    load = rng.permutation(loads) * rng.uniform(0.97, 1.0, len(loads))
    return load, model.answer(load) + noise * rng.standard_normal(len(load))


@pytest.fixture
def indentation(tmp_path):
    """20 points up to 3 nN with 15 nm of noise, as a file in nN and um."""
    force, depth = curve(TRUTH, np.linspace(0.1e-9, 3e-9, 20), 15e-9, seed=5)
    path = tmp_path / "indentation.csv"
    rows = [f"{1e9 * f:.5f},{1e6 * d:.5f}" for f, d in zip(force, depth, strict=True)]
    path.write_text("\n".join(["force_nN,displacement_um", *rows]) + "\n")
    return path


def test_cell_as_printed(indentation, tsgdd, read_summary, is_png, tmp_path):
    out = tmp_path / "D"
    done = tsgdd("calibrate", "--data", indentation, "--scene", "cell", "--fit", "bar-force", "E-tendon", "--out", out)
    assert done.code == 0, done.err
    summary = read_summary(out)
    for name, truth, unit in (("bar_force", 4e-9, "N"), ("E_tendon", 6e6, "Pa")):
        row = summary["fitted"][name]
        low, high = row["interval"]
        assert low < truth < high
        assert low < row["value"] < high < 2.0 * low
        assert row["unit"] == unit
    assert 0.6 * 15e-9 < summary["rms"] < 1.4 * 15e-9
    (one, across), (again, other) = summary["correlation"]
    assert (one, other) == pytest.approx((1.0, 1.0))
    assert across == again
    assert -0.95 < across < -0.5
    assert summary["warnings"] == []
    assert summary["points"] == 20
    assert is_png(out / "fit.png")
    assert "bar_force" in done.out


def test_declared_columns_and_any_case(indentation, tsgdd, read_summary, tmp_path):
    """Semicolons, headers that tell nothing, metres and newtons: the same fit."""
    _, *rows = indentation.read_text().splitlines()
    numbers = [[float(cell) for cell in row.split(",")] for row in rows]
    other = tmp_path / "other.csv"
    other.write_text("\n".join(["d;note;F", *(f"{d * 1e-6:.11e};7;{f * 1e-9:.11e}" for f, d in numbers)]))
    fit = ("--fit", "BAR_FORCE", "--e-tendon", 6e6, "--no-plots")
    assert tsgdd("calibrate", "--data", indentation, *fit, "--out", tmp_path / "a").code == 0
    columns = ("--column", "force=F:N", "--column", "displacement=d:m")
    assert tsgdd("calibrate", "--data", other, *columns, *fit, "--out", tmp_path / "b").code == 0
    a, b = (read_summary(tmp_path / name)["fitted"]["bar_force"] for name in "ab")
    assert a["value"] == pytest.approx(b["value"], rel=1e-4)


def test_intervals_cover_the_truth():
    """The 95 % interval of the bar force holds the truth in most of 12 noisy curves, and not by being endless."""
    loads = np.linspace(0.3e-9, 3e-9, 6)
    inside = 0
    for seed in range(12):
        force, depth = curve(TRUTH, loads, 20e-9, seed=100 + seed)
        model = dataclasses.replace(TRUTH, tissue=dataclasses.replace(TRUTH.tissue, bar_force=5e-9))
        interval = fit_curve(model, ("bar_force",), force, depth).interval
        assert interval is not None
        low, high = interval[0]
        inside += bool(low < TRUTH.tissue.bar_force < high)
        assert high < 2.0 * low
    assert inside >= 9


def test_warnings_of_what_the_data_cannot_tell():
    """In one cell, softer bars look like softer tendons."""
    force, depth = curve(TRUTH, np.linspace(0.2e-9, 3e-9, 8), 5e-9, seed=2)
    fit = fit_curve(TRUTH, ("E_tendon", "E_bar"), force, depth)
    assert abs(fit.correlation[0, 1]) > 0.95
    assert any("badly told apart" in warning for warning in fit.warnings)
    assert any("badly determined" in warning or "at its bound" in warning for warning in fit.warnings)
    assert fit.interval is not None
    for name, (low, high) in zip(fit.names, fit.interval, strict=True):
        assert PARAMETERS[name].low * 0.999 <= low <= high <= PARAMETERS[name].high * 1.001


def test_half_diagonal_from_exact_data():
    truth = Model("cell", Tissue(CellParameters(half_diagonal=0.42), 5e-9))
    force, depth = curve(truth, np.linspace(0.2e-9, 3e-9, 8), 0.0, seed=1)
    fit = fit_curve(dataclasses.replace(truth, tissue=Tissue(bar_force=5e-9)), ("half_diagonal",), force, depth)
    assert fit.values[0] == pytest.approx(0.42, rel=1e-3)
    assert fit.rms < 1e-3 * depth.max()


def test_monolayer(tsgdd, read_summary, tmp_path):
    truth = Model("monolayer", Tissue(bar_force=2e-8), blocks=(2, 1))
    strain, stress = curve(truth, np.linspace(0.03, 0.24, 6), 2.0, seed=4)
    path = tmp_path / "sheet.csv"
    path.write_text(
        "\n".join(["strain (%),stress [Pa]", *(f"{100 * e},{s}" for e, s in zip(strain, stress, strict=True))])
    )
    options = ("--scene", "monolayer", "--blocks", 2, 1, "--fit", "bar-force", "--no-plots")
    done = tsgdd("calibrate", "--data", path, *options, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    row = read_summary(tmp_path / "out")["fitted"]["bar_force"]
    low, high = row["interval"]
    assert low < 2e-8 < high < 1.5 * low


def test_parameter_names():
    assert parameter_names(["Bar-Force", "e_tendon", "E-bar", "half-diagonal", "contact-point"]) == tuple(PARAMETERS)


HEADER = "force_nN,displacement_um\n"


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (HEADER + "1,1\n", ("--fit", "r"), "fit: expected parameters among bar-force, E-tendon"),
        (
            HEADER + "1,1\n",
            ("--fit", "E-bar", "e_bar"),
            "fit: expected at least one parameter, each once",
        ),
        (
            HEADER + "1,1\n",
            ("--fit", "E-bar"),
            "data: expected more than 1 distinct loads for 1 param",
        ),
        ("force,displacement_um\n1,1\n", ("--fit", "E-bar"), "expected one header with the unit of force, as force_pN"),
        ("force_kg,displacement_um\n1,1\n", ("--fit", "E-bar"), "unit of force: expected one of N, mN, uN, nN, pN"),
        (HEADER + "-1,1\n", ("--fit", "E-bar"), "expected numbers from 0 upwards"),
        (HEADER + "1,0\n", ("--fit", "E-bar"), "displacement: expected numbers other than 0"),
        (HEADER + "1,x\n", ("--fit", "E-bar"), "expected a finite number, got 'x'"),
        (
            HEADER + "1,1\n",
            ("--fit", "E-bar", "--scene", "organ"),
            "scene: expected cell or monolayer",
        ),
        (HEADER + "1,1\n", ("--fit", "E-bar", "--column", "force=a:nN"), "column: expected force and"),
        ("strain_1,stress_Pa\n25,1\n", ("--fit", "E-bar", "--scene", "monolayer"), "is its unit %?"),
        ("", ("--fit", "E-bar"), "expected column headers in line 1"),
    ],
)
def test_bad_input(text, options, message, tsgdd, tmp_path):
    path = tmp_path / "data.csv"
    path.write_text(text)
    done = tsgdd("calibrate", "--data", path, *options, "--out", tmp_path / "out")
    assert done.code == 2, done.err
    assert message in done.err
    assert done.err.count("\n") == 1


CASES = Path(__file__).parents[2] / "data" / "cases" / "calibrate"


@pytest.fixture
def fitted(tsgdd, read_summary, tmp_path):
    """Fit a curve of the cases: what is printed, and the summary."""

    def run(name, *names, plots=False):
        out = tmp_path / "C"
        done = tsgdd(
            *("calibrate", "--data", CASES / f"{name}.csv", "--out", out, "--fit", *names),
            *(() if plots else ("--no-plots",)),
        )
        assert done.code == 0, done.err
        return done.out, read_summary(out)

    return run


def test_a_contact_point_that_is_off_is_seen_and_can_be_fitted(fitted, is_png, tmp_path):
    """The exact curve of 10 nN, measured from 100 nm before the contact."""
    _, alone = fitted("offset_100nm", "bar-force")
    assert alone["fitted"]["bar_force"]["value"] < 8e-9
    (warning,) = alone["warnings"]
    assert "the residuals are systematic" in warning
    assert "is the contact point off? (--fit contact-point)" in warning
    _, both = fitted("offset_100nm", "bar-force", "contact-point", plots=True)
    assert both["fitted"]["bar_force"]["value"] == pytest.approx(1e-8, rel=1e-4)
    assert both["fitted"]["contact_point"]["value"] == pytest.approx(1e-7, rel=1e-4)
    assert both["fitted"]["contact_point"]["unit"] == "m"
    assert both["warnings"] == []
    assert is_png(tmp_path / "C" / "fit.png")


@pytest.mark.parametrize("contact", [-3e-7, 2e-7])
def test_contact_points_of_noisy_curves(contact):
    force, depth = curve(TRUTH, np.linspace(0.1e-9, 3e-9, 30), 5e-9, seed=3)
    model = dataclasses.replace(TRUTH, tissue=Tissue(TRUTH.tissue.cell, bar_force=1e-8))
    fit = fit_curve(model, ("bar_force", "contact_point"), force, depth + contact)
    assert fit.interval is not None
    (low, high), (least, most) = fit.interval
    assert low < 4e-9 < high
    assert least < contact < most
    assert most - least < 1e-7
    assert not any("systematic" in warning for warning in fit.warnings)


def test_no_interval_where_the_model_does_not_describe_the_curve(fitted, is_png, tmp_path):
    out, summary = fitted("thirty_times_softer", "bar-force", plots=True)
    assert summary["fitted"]["bar_force"]["interval"] is None
    assert "(no interval)" in out
    assert any("the model does not describe the curve: misfit 59%" in warning for warning in summary["warnings"])
    assert is_png(tmp_path / "C" / "fit.png")


def test_a_bound_is_named_where_the_curve_is_out_of_reach(fitted):
    """A cell much stiffer than any tendon makes it: the equilibrium was never lost."""
    _, summary = fitted("stiff_cell", "E-tendon")
    assert summary["fitted"]["E_tendon"]["value"] == pytest.approx(1e9, rel=1e-3)
    assert any(warning.startswith("E_tendon ended at its bound, 1e+09: a misfit of") for warning in summary["warnings"])


def test_a_contact_point_is_of_the_cell(tsgdd, tmp_path):
    (tmp_path / "m.csv").write_text("strain_%,stress_Pa\n1,10\n2,21\n3,33\n")
    fit = ("--scene", "monolayer", "--fit", "contact-point", "--out", tmp_path / "C")
    done = tsgdd("calibrate", "--data", tmp_path / "m.csv", *fit)
    assert done.code == 2
    assert "fit: expected no contact point in the scene monolayer, got one" in done.err


def test_curves_with_a_decimal_comma(tsgdd, tmp_path):
    text = (CASES / "offset_100nm.csv").read_text().replace(",", ";").replace(".", ",")
    (tmp_path / "c.csv").write_text("sep=;\n" + text)
    fit = ("--fit", "bar-force", "contact-point", "--no-plots", "--out", tmp_path / "C")
    assert tsgdd("calibrate", "--data", tmp_path / "c.csv", "--decimal", ",", *fit).code == 0
    done = tsgdd("calibrate", "--data", tmp_path / "c.csv", *fit)
    assert done.code == 2
    assert "is its decimal sign a comma? (--decimal ,)" in done.err
