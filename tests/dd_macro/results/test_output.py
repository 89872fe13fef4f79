"""Files read back, comparison by blocks, figures."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import dd_macro as dd
from dd_macro import (
    BlockStress,
    Displacement,
    MaterialSearch,
    Projection,
    StrainOperator,
    box,
    compare_blocks,
    isotropic,
    read_quadrature,
    solve,
    write_quadrature,
    write_vtkhdf,
)
from dd_macro.results.compare import error_map, ring_index
from dd_macro.results.figures import plot_boundary, plot_comparison, plot_convergence
from tsg_micro.data.errors import InputError
from tsg_micro.data.figure_style import block_outlines, plot_maps, save_figure
from tsg_micro.data.mandel import pressure, von_mises

pytestmark = pytest.mark.mpi

METRIC = isotropic(young=1e3, poisson=0.3)


@pytest.fixture
def solved(comm, make_dataset):
    operator = StrainOperator(box(comm, elements=(5, 4, 2), size=(5e-5, 4e-5, 2e-5)))
    scene = Projection(operator, METRIC, [Displacement("bottom"), Displacement("top", (0.0, 2e-6, 0.0))])
    strain = np.random.default_rng(0).uniform(-0.06, 0.06, (400, 6))
    return scene, solve(scene, MaterialSearch(make_dataset(strain, strain @ METRIC.C), METRIC))


def test_quadrature_file_is_ordered_by_input_cell(comm, folder, solved):
    scene, result = solved
    path = folder / "fields.h5"
    write_quadrature(path, scene.operator, result, stress_measure="cauchy")
    read = read_quadrature(path)
    k, j, i = np.unravel_index(np.arange(40), (2, 4, 5))  # cells of the box in its own order
    np.testing.assert_allclose(read.midpoint, 1e-5 * (np.column_stack([i, j, k]) + 0.5), atol=1e-18)
    assert read.weight.sum() == pytest.approx(4e-14, rel=1e-12)
    np.testing.assert_allclose(read.cell_mean(read.coordinates), read.midpoint, atol=1e-18)
    mine = scene.operator.domain.mesh.topology.original_cell_index[: scene.operator.domain.owned_cells]
    for name, values in (("mechanical_stress", result.mechanical.stress), ("material_strain", result.material_strain)):
        np.testing.assert_array_equal(getattr(read, name)[mine].reshape(-1, 6), values)
    np.testing.assert_allclose(read.mechanical_p, pressure(read.mechanical_stress))
    np.testing.assert_allclose(read.material_q, von_mises(read.material_stress))
    distance = np.linalg.norm(
        METRIC.whiten(read.mechanical_strain - read.material_strain, read.mechanical_stress - read.material_stress),
        axis=-1,
    )
    np.testing.assert_allclose(read.local_distance, distance, rtol=1e-8)
    assert (read.stress_measure, read.normalised_distance) == ("cauchy", result.normalised_distance)
    comm.barrier()
    assert [p.name for p in folder.iterdir()] == ["fields.h5"]


def test_files_that_cannot_be_written_or_read(comm, folder, solved):
    scene, result = solved
    if comm.rank == 0:
        (folder / "taken.vtkhdf").mkdir()
    comm.barrier()
    with pytest.raises(InputError, match=r"taken\.vtkhdf: cannot be written"):  # found only at the last rename
        write_vtkhdf(folder / "taken.vtkhdf", scene, result)
    with pytest.raises(InputError, match="its folder cannot be written"):
        write_quadrature(folder / "none" / "fields.h5", scene.operator, result, stress_measure="cauchy")
    with pytest.raises(InputError, match=r"expected a name that ends in \.vtkhdf"):
        write_vtkhdf(folder / "fields.vtu", scene, result)
    with pytest.raises(InputError, match="no such file"):
        read_quadrature(folder / "fields.h5")
    if comm.rank == 0:
        (folder / "text.h5").write_text("text")
    comm.barrier()
    with pytest.raises(InputError, match="expected an HDF5 file"):
        read_quadrature(folder / "text.h5")


def test_vtkhdf_file_opens_with_vtk(comm, folder, solved):
    pv = pytest.importorskip("pyvista")
    scene, result = solved
    write_vtkhdf(folder / "fields.vtkhdf", scene, result)
    write_quadrature(folder / "fields.h5", scene.operator, result, stress_measure="cauchy")
    read = read_quadrature(folder / "fields.h5")
    grid = pv.read(folder / "fields.vtkhdf")
    parts = [grid] if isinstance(grid, pv.UnstructuredGrid) else [grid[i] for i in range(len(grid))]
    assert sum(part.n_cells for part in parts) == 40
    for part in parts:
        sizes = part.compute_cell_sizes(length=False, area=False)["Volume"]
        np.testing.assert_allclose(sizes, 1e-15, rtol=1e-9)  # a wrong order of corners has another volume
        centre = part.cell_centers().points
        cell = np.abs(centre[:, None] - read.midpoint[None]).max(axis=2).argmin(axis=1)
        assert np.abs(centre - read.midpoint[cell]).max() < 1e-11
        np.testing.assert_allclose(part["mechanical_p"], read.cell_mean(read.mechanical_p)[cell], rtol=1e-9)
        xy = read.cell_mean(read.material_stress)[cell, 5] / np.sqrt(2)
        np.testing.assert_allclose(part["material_stress_xy"], xy, rtol=1e-9)
        clamped = part.points[:, 1] == 0
        np.testing.assert_array_equal(part["u"][clamped], 0)
        top = part.points[:, 1] > 3.99e-5
        np.testing.assert_allclose(part["u"][top], np.broadcast_to([0, 2e-6, 0], (top.sum(), 3)), atol=1e-18)
    comm.barrier()


def blocks(nx, ny, measure="cauchy", seed=0):
    y, x = np.divmod(np.arange(nx * ny), nx)
    midpoint = 2e-5 * np.column_stack([x + 0.5, y + 0.5, np.full(nx * ny, 0.5)])
    return BlockStress(midpoint, np.random.default_rng(seed).normal(size=(nx * ny, 6)) + 3.0, measure)


def test_comparison_of_known_errors():
    """10 % too much inside and 50 % on the outer ring, in blocks of another order."""
    reference = blocks(6, 5)
    edge = np.isin(np.arange(30) % 6, (0, 5)) | np.isin(np.arange(30) // 6, (0, 4))
    factor = np.where(edge, 1.5, 1.1)
    mix = np.random.default_rng(1).permutation(30)
    mechanical = BlockStress(reference.midpoint[mix], (factor[:, None] * reference.stress)[mix], "cauchy")
    found = compare_blocks(mechanical, reference, reference)
    assert (found.blocks, found.interior_blocks) == (30, 12)
    assert found.error_p_mech.l2 == pytest.approx(0.1)
    assert found.error_q_mech.mean == pytest.approx(0.1)
    assert found.error_p_mech.mean_all == pytest.approx((18 * 0.5 + 12 * 0.1) / 30)
    p = pressure(reference.stress)
    assert found.error_p_mech.l2_all == pytest.approx(np.linalg.norm((factor - 1) * p) / np.linalg.norm(p))
    assert found.error_p_mat.l2_all == 0
    assert json.loads(json.dumps(found.as_dict()))["error_q_mat"]["mean"] == 0


def test_map_of_errors_put_in_known_blocks():
    """p of the reference is 1 everywhere; an error of 0.2 in a corner and next to it, 0.1 at a side, 0.3 in ring 1."""
    nx, ny = 7, 6
    p = np.ones(nx * ny)
    reference = dataclasses.replace(blocks(nx, ny), stress=-np.outer(p, [1, 1, 1, 0, 0, 0]))
    place = {"corner": 0, "top": nx * (ny - 1) + 3, "side": 2 * nx + (nx - 1), "ring 1": nx + 2}
    for name, error in (("corner", 0.2), ("top", 0.2), ("side", 0.1), ("ring 1", 0.3)):
        p[place[name]] += error
    mix = np.random.default_rng(1).permutation(nx * ny)
    stress = -np.outer(p, [1, 1, 1, 0, 0, 0])
    found = error_map(BlockStress(reference.midpoint[mix], stress[mix], "cauchy"), reference, pressure)
    total = 2 * 0.2**2 + 0.1**2 + 0.3**2
    np.testing.assert_allclose(found.rings, [(2 * 0.2**2 + 0.1**2) / total, 0.3**2 / total, 0], atol=1e-14)
    assert found.clamped_rows == pytest.approx(2 * 0.2**2 / total)
    assert found.free_sides == pytest.approx(0.1**2 / total)
    np.testing.assert_allclose(found.error, [np.sqrt(total / 42), 0.3 / np.sqrt(20), 0], atol=1e-14)
    share = np.empty(nx * ny)
    share[mix] = found.share
    np.testing.assert_allclose(share[list(place.values())], np.array([0.04, 0.04, 0.01, 0.09]) / total)
    assert share.sum() == pytest.approx(1)
    np.testing.assert_array_equal(np.bincount(ring_index(reference.midpoint)), [22, 14, 6])
    nothing = error_map(reference, reference, pressure)
    assert not nothing.share.any()
    assert not nothing.error.any()
    assert json.loads(json.dumps(found.as_dict()))["clamped_rows"] == found.clamped_rows
    with pytest.raises(InputError, match="other than zero"):
        error_map(reference, dataclasses.replace(reference, stress=0 * reference.stress), pressure)


def test_blocks_that_do_not_fit():
    a = blocks(6, 5)
    with pytest.raises(InputError, match="got kirchhoff and cauchy"):
        compare_blocks(blocks(6, 5, "kirchhoff"), a, a)
    with pytest.raises(InputError, match="got 6 x 4 x 1 and 6 x 5 x 1"):
        compare_blocks(blocks(6, 4), a, a)
    with pytest.raises(InputError, match="at least 3 x 3"):
        compare_blocks(blocks(6, 2), blocks(6, 2), blocks(6, 2))
    with pytest.raises(InputError, match="quarter of their size apart"):
        compare_blocks(BlockStress(a.midpoint + 1e-5, a.stress, "cauchy"), a, a)
    with pytest.raises(InputError, match="one block per place"):
        compare_blocks(a, a, BlockStress(a.midpoint[1:], a.stress[1:], "cauchy"))
    with pytest.raises(InputError, match="block stress: expected finite numbers"):
        BlockStress(a.midpoint, np.full((30, 6), np.nan), "cauchy")


def test_figures(comm, folder):
    if comm.rank:
        return
    a = blocks(6, 5)
    outline = block_outlines(a.midpoint)
    np.testing.assert_allclose(outline[7], 2e-5 * np.array([[1, 1], [2, 1], [2, 2], [1, 2]]))
    p = pressure(a.stress)
    inner = np.ones(len(p), dtype=bool)
    figure = plot_comparison(outline, material=1.02 * p, mechanical=1.05 * p, tensegrity=p, inner=inner, symbol="p")
    maps = [axes.collections[0] for axes in figure.axes[:4]]
    assert len({m.get_clim() for m in maps[:3]}) == 1
    np.testing.assert_allclose(maps[3].get_array(), 5.0)
    save_figure(figure, folder / "compare.png")
    alone = plot_comparison(outline, material=None, mechanical=1.05 * p, tensegrity=p, inner=inner, symbol="p")
    assert [axes.get_title() for axes in alone.axes[:2]] == ["FE2 $p$", "tensegrity $p$"]
    assert not any("data-driven" in axes.get_title() for axes in alone.axes)
    found = error_map(dataclasses.replace(a, stress=1.1 * a.stress), a, pressure)
    boundary = plot_boundary(outline, {"FE2 $p$": found, "FE2 $q$": found})
    np.testing.assert_allclose(boundary.axes[0].collections[0].get_array(), 100 * found.share, rtol=1e-9)
    np.testing.assert_allclose(boundary.axes[2].lines[0].get_ydata(), 10.0)
    save_figure(boundary, folder / "boundary.png")
    save_figure(
        plot_maps(outline, {"p": (p, "Pa"), "q": (von_mises(a.stress), "Pa"), "d": (p, "1")}), folder / "maps.png"
    )
    save_figure(plot_convergence([3.0, 2.0, 1.5], [40, 10, 0], [1.7, 1.7, 1.0]), folder / "history.png")
    assert all((folder / f"{name}.png").stat().st_size > 10_000 for name in ("compare", "maps", "history"))
    with pytest.raises(InputError, match="field to draw: expected 30 finite numbers"):
        plot_maps(outline, {"p": (p[1:], "Pa")})


def test_the_distance_is_drawn_as_it_is_and_round_off_as_zero(comm):
    if comm.rank:
        return
    upper, lower = plot_convergence([0.0620, 0.0619, 0.0619], [40, 10, 0], [1.8, 1.0, 1.0]).axes
    np.testing.assert_allclose(upper.lines[0].get_ydata(), [6.20, 6.19, 6.19])
    np.testing.assert_array_equal(lower.lines[0].get_ydata(), [40, 10, 0])
    assert upper.get_yscale() == "linear"
    falling = plot_convergence([0.04, 3e-17], [40, 0], [1.0, 1.0]).axes[0]
    np.testing.assert_array_equal(falling.lines[0].get_ydata(), [4.0, 0.0])
    assert falling.get_ylim()[0] == 0.0


def test_few_blocks_are_drawn_one_by_one_and_many_as_a_histogram(comm):
    if comm.rank:
        return
    for size, many in ((6, False), (12, True)):
        a = blocks(size, size)
        p, inner = pressure(a.stress), dd.interior_blocks(a.midpoint)
        outline = block_outlines(a.midpoint)
        figure = plot_comparison(outline, material=None, mechanical=1.1 * p, tensegrity=p, inner=inner, symbol="p")
        last = figure.axes[-1]
        assert bool(last.patches) == many
        if not many:
            dots = last.lines[-1]
            np.testing.assert_allclose(dots.get_ydata(), 1.1 * np.asarray(dots.get_xdata()))
            assert len(dots.get_xdata()) == inner.sum()


def test_the_deformed_body_is_in_the_file(comm, folder):
    operator = dd.StrainOperator(dd.box(comm, elements=(3, 2, 1), size=(3e-5, 2e-5, 1e-5)))
    problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (1e-6, 2e-6, 0.0))])
    law = dd.LinearLaw(1e3 * np.eye(6), np.zeros(6))
    solution = dd.LawMethod().prepare(problem, dd.Material(law=law)).solve()
    path = folder / "quadrature.h5"
    write_quadrature(path, operator, solution, stress_measure="first_piola")
    fields = read_quadrature(path)
    moved = fields.deformed_corners - fields.corners
    y = fields.corners[..., 1]
    np.testing.assert_allclose(moved[y > 1.9e-5], np.tile([1e-6, 2e-6, 0.0], (len(moved[y > 1.9e-5]), 1)), atol=1e-18)
    np.testing.assert_allclose(moved[y < 1e-7], 0.0, atol=1e-18)
    old = dataclasses.replace(fields, corner_displacement=None)  # as of a file of an older version
    np.testing.assert_array_equal(old.deformed_corners, fields.corners)
