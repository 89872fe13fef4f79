"""What a solve says of itself: the estimated error and its line, the limit, and cautions about body and elements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_law import RVELaw
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES, join_paths, sample_paths
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import read_dataset, write_dataset
from workflows.runs.cautions import body_cautions, scatter_caution
from workflows.runs.checks import estimate_error
from workflows.runs.rest import with_rest
from workflows.runs.scene import Scene

SCENE = ("--elements", 4, 4, 1, "--strain", 0.04, "--no-plots")
TISSUE = Tissue()


@pytest.mark.parametrize("order", [1, 2])
def test_every_solve_has_its_error(chain, tsgdd, read_summary, tmp_path, order):
    done = tsgdd("solve", "--data", chain.data, *SCENE, "--order", order, "--out", tmp_path)
    assert done.code == 0, done.err
    summary = read_summary(tmp_path)
    assert 0.002 < summary["estimated_error"] < 1.0
    assert (summary["error_kind"], summary["checks"], summary["failed_checks"]) == ("check RVEs", 12, 0)
    assert summary["within_max_error"] is None
    line = next(line for line in done.out.splitlines() if line.startswith("estimated error"))
    assert f"{summary['estimated_error']:.2%} (check RVEs)" in line
    assert f"outside the data {summary['outside_data']:.1%}" in line
    assert ("extrapolated" in line) == ("held" in line) == (order == 2)
    assert any("--adapt" in text for text in summary["warnings"]) == (summary["estimated_error"] > 0.05)


@pytest.mark.parametrize("limit", [1e-4, 2.0])
def test_a_limit_of_the_error(chain, tsgdd, read_summary, tmp_path, limit):
    done = tsgdd("solve", "--data", chain.data, *SCENE, "--max-error", limit, "--out", tmp_path)
    assert done.code == (limit < 1)
    assert ("expected at most 0.0% (--max-error), got" in done.err) == (limit < 1)
    summary = read_summary(tmp_path)
    assert (summary["within_max_error"], summary["parameters"]["max_error"]) == (limit > 1, limit)
    assert dd.read_quadrature(tmp_path / "quadrature.h5").weight.shape == (64, 8)


def test_a_limit_that_is_none(chain, tsgdd, tmp_path):
    done = tsgdd("solve", "--data", chain.data, *SCENE, "--max-error", -1, "--out", tmp_path / "out")
    assert done.code == 2
    assert "max_error: expected a positive number, got -1.0" in done.err
    assert not (tmp_path / "out" / "summary.json").exists()


def test_measured_data_answer_each_other(chain, tsgdd, read_summary, tmp_path):
    data = replace(read_dataset(chain.data), parameters={}, tangent=None)
    write_dataset(tmp_path / "measured.h5", data)
    done = tsgdd("solve", "--data", tmp_path / "measured.h5", *SCENE, "--order", 2, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    summary = read_summary(tmp_path / "out")
    assert summary["error_kind"] == "data without their own"
    assert 0.001 < summary["estimated_error"] < 2.0
    assert summary["data_points"] == len(data)


def test_ranks_do_not_matter(chain, launch, read_summary, tmp_path):
    errors = []
    for ranks in (1, 2):
        done = launch("solve", "--data", chain.data, *SCENE, "--order", 2, "--out", tmp_path / f"{ranks}", ranks=ranks)
        assert done.code == 0, done.err
        errors.append(read_summary(tmp_path / f"{ranks}")["estimated_error"])
    assert errors[1] == pytest.approx(errors[0], rel=1e-6)


def cautions(rve, elements, **more):
    scene = Scene(load="stretch", strain=0.02, elements=elements, **more)
    problem = scene.problem(MPI.COMM_SELF, TISSUE)
    return " / ".join(body_cautions(problem, rve, bends=scene.bends, trilinear=scene.trilinear))


SHEET, BULK = RVESpec(TISSUE), RVESpec.of_kind("bulk", TISSUE)


@pytest.mark.parametrize(
    ("rve", "elements", "said"),
    [
        (SHEET, (4, 3, 1), ""),
        (BULK, (4, 3, 2), ""),
        (replace(SHEET, blocks=(1, 1, 2)), (4, 3, 2), ""),
        (SHEET, (4, 3, 2), "sheet data, with free faces across z, for a body 2 blocks thick"),
        (BULK, (4, 3, 1), "bulk data for a body one block thick across z"),
        (SHEET, (1, 3, 1), "the body is 1 block across x, no more than an RVE"),
        (replace(SHEET, blocks=(3, 1, 1)), (2, 3, 1), "the body is 2 blocks across x, no more than an RVE"),
        (None, (1, 1, 1), ""),
    ],
)
def test_a_body_and_the_tissue_of_its_data(rve, elements, said):
    found = cautions(rve, elements)
    assert said in found
    assert bool(found) == bool(said)


def test_one_trilinear_element_across():
    assert "one trilinear element across x" in cautions(SHEET, (1, 4, 1), element="trilinear")
    assert "element" not in cautions(SHEET, (1, 4, 1))
    assert "element" not in cautions(SHEET, (4, 4, 1), element="trilinear")
    assert "element across z" in cautions(SHEET, (4, 4, 1), element="trilinear", kinematics="finite")
    assert "element" not in cautions(SHEET, (4, 4, 1), element="trilinear", kinematics="finite", flat=True)


def test_strains_within_elements_and_between_them():
    """Elements that bend each by itself, and a body that bends as one."""
    operator = dd.StrainOperator(dd.box(MPI.COMM_SELF, elements=(4, 4, 1), size=(8e-5, 8e-5, 2e-5)))
    problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top")])
    law = dd.isotropic(young=1e3, poisson=0.3)
    solution = dd.METHODS["classical"].prepare(problem, dd.Material(_points(law), law)).solve()
    y = operator.points[:, 1]
    for wave, warned in ((8e-5, False), (2e-5, True)):
        strain = np.zeros((len(y), 6))
        strain[:, 1] = 0.01 * np.sin(2 * np.pi * y / wave)
        z = replace(solution.mechanical, strain=strain)
        found = scatter_caution(replace(solution, mechanical=z))
        assert bool(found) == warned


def _points(law):
    strain, step = np.random.default_rng(0).uniform(-0.02, 0.02, (20, 6)), np.arange(20)
    return Dataset(strain, strain @ law.C, "cauchy", path=0 * step, step=step)


def test_data_of_another_load_are_caught():
    """A strip pulled along x with the data of a stretch along y, as points: it moves the wrong way, and converges."""
    done = sample_paths(SHEET.build(), BOXES["stretch"], paths=range(20), steps=5, seed=0)
    data = with_rest(join_paths(done, seed=0, parameters=SHEET.parameters(), versions={}))
    operator = dd.EnhancedStrainOperator(dd.box(MPI.COMM_SELF, elements=(6, 2, 1), size=(12e-5, 4e-5, 2e-5)))
    problem = dd.Problem(operator, [dd.Displacement("left")], [dd.Traction("right", (30.0, 0.0, 0.0))])
    solution = dd.METHODS["classical"].prepare(problem, dd.Material(data)).solve()
    law = RVELaw(replace(SHEET, free=()).build())
    exact = dd.equilibrium(problem, law).mechanical
    tip = [z.u[: 3 * operator.owned_nodes].reshape(-1, 3)[:, 0].max() for z in (solution.mechanical, exact)]
    assert tip[0] < 0.3 * tip[1]
    estimate = estimate_error(solution, [SHEET]).error
    assert estimate is not None
    assert estimate > 0.4
