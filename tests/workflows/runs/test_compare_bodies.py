"""``compare`` on bodies that are no sheets: a cube against a solution that is known, shells of a ball."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.bodies.voxel_body import build_block_body
from tsg_micro.cells.lattice import spheroid_cells
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.radial_profiles import ball_radius, shell_count
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.mandel import pressure
from workflows.runs.body_dns import body_dns
from workflows.runs.compare import compare
from workflows.runs.compare_bodies import body_figures, draw_body
from workflows.runs.tensegrity import read_blocks
from workflows.store.record import write_summary

TISSUE = Tissue()
EDGE = TISSUE.block


def middles(blocks):
    return EDGE * (blocks + 0.5)


def test_a_cube_under_pressure_against_the_continuum(is_png, tmp_path):
    """A linear law answers with the pressure everywhere, in elements of half a block: errors by hand."""
    cube = np.argwhere(np.ones((3, 3, 3), dtype=bool))
    loads = [dd.Pressure("surface", 5.0)]
    mesh = dd.voxel_mesh(MPI.COMM_SELF, cube, edge=EDGE)
    body_dns(
        tmp_path / "dns",
        domain=mesh,
        tissue=TISSUE,
        bar_force=np.full(27, 1e-8),
        supports=[],
        loads=loads,
        free=True,
        factors=(1.0,),
        plots=False,
    )
    fine = dd.StrainOperator(dd.voxel_mesh(MPI.COMM_SELF, cube, edge=EDGE, refine=2))
    problem = dd.Problem(fine, [], loads, free=True)
    law = dd.LinearLaw(dd.isotropic(young=1e3, poisson=0.3).C, np.zeros(6))
    solution = dd.LawMethod().prepare(problem, dd.Material(law=law)).solve()
    (tmp_path / "fe").mkdir()
    dd.write_solution(tmp_path / "fe", solution, stress_measure="cauchy")
    figures = {"normalised_distance": (0.0, "1"), "stress_measure": ("cauchy", ""), "seconds": (1.0, "s")}
    write_summary(tmp_path / "fe", command="fe2", parameters=TISSUE.as_dict(), figures=figures)
    summary = compare(tmp_path / "out", dd=tmp_path / "fe", dns=tmp_path / "dns")
    p = pressure(read_blocks(tmp_path / "dns", "cauchy").stress)
    expected = {"l2": np.linalg.norm(5.0 - p) / np.linalg.norm(p), "mean": np.mean(np.abs(5.0 - p) / np.abs(p))}
    assert summary["errors_mech"]["p"] == pytest.approx(expected, rel=1e-6)
    assert expected["l2"] < 0.1
    assert summary["errors_mech_inner"]["p"]["l2"] == pytest.approx(abs(5.0 / p[13] - 1.0), rel=1e-6)
    assert (summary["blocks"], summary["interior_blocks"], summary["round"]) == (27, 1, False)
    assert summary["stress_measure"] == "cauchy"
    assert all(is_png(tmp_path / "out" / f"{name}.png") for name in ("p", "q", "errors"))


def test_shells_of_a_ball(is_png, tmp_path):
    """Hydrostatic stress that falls with the radius: 10 % more everywhere, and a shear that no radius sees."""
    blocks = np.unique(spheroid_cells(3) // 2, axis=0)
    midpoint = middles(blocks)
    radius = ball_radius(midpoint, EDGE)
    assert radius is not None
    assert radius == pytest.approx(EDGE * np.cbrt(136 * 0.75 / np.pi))
    r = np.linalg.norm(midpoint - midpoint.mean(axis=0), axis=1)
    stress = -(200.0 - 1e6 * r)[:, None] * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    reference = Dataset(
        strain=np.zeros((136, 6)),
        stress=stress,
        stress_measure="cauchy",
        path=np.arange(136),
        step=np.zeros(136, dtype=np.int64),
        midpoint=midpoint,
        parameters={"tissue": TISSUE.as_dict()},
    )
    found = {name: value for name, (value, _) in body_figures({"mech": 1.1 * stress}, reference).items()}
    assert found["round"]
    assert found["error_sigma_rr_mech"] == pytest.approx({"l2": 0.1, "mean": 0.1})
    np.testing.assert_allclose(found["error_shells_mech"], 0.1)
    shell = np.minimum((r / radius * shell_count(radius, EDGE)).astype(int), shell_count(radius, EDGE) - 1)
    np.testing.assert_allclose(found["sigma_rr"], [stress[shell == k, 0].mean() for k in np.unique(shell)])
    assert found["error_share_outer_mech"] == pytest.approx((stress[~_inside(blocks)] ** 2).sum() / (stress**2).sum())
    draw_body(tmp_path, {"mech": 1.1 * stress}, reference, {"mech": "mechanical"})
    assert is_png(tmp_path / "shells.png")


def _inside(blocks):
    there = {tuple(block) for block in blocks}
    steps = [tuple(sign * row) for row in np.eye(3, dtype=int) for sign in (1, -1)]
    return np.array([all(tuple(np.add(block, step)) in there for step in steps) for block in blocks])


@pytest.mark.parametrize(("count", "rounded"), [((3, 3, 3), False), ((6, 6, 6), False), ((6, 5, 1), False)])
def test_boxes_are_no_balls(count, rounded):
    midpoint = middles(np.argwhere(np.ones(count, dtype=bool)))
    assert (ball_radius(midpoint, EDGE) is not None) == rounded


def test_blocks_know_their_prestress():
    """Bar force of every block as it was given, whatever the order of the blocks."""
    blocks = np.array([[2, 0, 0], [0, 0, 0], [1, 0, 0]])
    found = build_block_body(TISSUE, blocks, np.array([3e-8, 1e-8, 2e-8]))
    np.testing.assert_array_equal(found.structure.blocks[:, 0], [0, 1, 2])
    np.testing.assert_allclose(found.bar_force, [1e-8, 2e-8, 3e-8])
    bars = found.structure.bars
    block = found.structure.cell_block[found.structure.member_cells[bars, 0]]
    np.testing.assert_allclose(found.prestress[bars, 0], -found.bar_force[block], rtol=1e-12)
