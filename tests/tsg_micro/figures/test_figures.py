"""Figures show the numbers they were given; the file for ParaView holds them."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from matplotlib.image import imread

from tsg_micro.cells.lattice import box_cells, lattice
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import prestressed
from tsg_micro.cells.structure import from_arrays
from tsg_micro.data.errors import InputError
from tsg_micro.data.figure_style import block_outlines, limits, plot_maps, save_figure
from tsg_micro.equilibrium.members import MemberSystem
from tsg_micro.figures.data import plot_blocks, plot_curve
from tsg_micro.figures.sheet import plot_sheet
from tsg_micro.figures.vtu import write_vtu

PARAMETERS = CellParameters()


@pytest.fixture(scope="module")
def stretched():
    """A prestressed sheet of 4 x 2 blocks with 5 % of uniform stretch along y, and its members' state."""
    sheet = prestressed(lattice(box_cells(8, 4, 2), PARAMETERS), PARAMETERS, 1e-8)
    displacement = sheet.nodes * [0.0, 0.05, 0.0]
    state = MemberSystem(sheet).state(np.append(displacement.ravel(), np.zeros(9)))
    return sheet, displacement, state


def lengths(collection):
    return np.array([np.linalg.norm(np.diff(s, axis=0)) for s in collection.get_segments()])


def test_sheet_colours_are_forces(stretched, tmp_path):
    sheet, displacement, state = stretched
    figure = plot_sheet(sheet, displacement, state.force)
    whole, zoom = figure.axes
    bar = next(axes for axes in whole.figure.findobj(lambda a: getattr(a, "get_ylabel", str)() == "member force / nN"))
    top = 1e9 * np.percentile(np.abs(state.force), 98)
    assert (whole.get_xlabel(), whole.get_ylabel()) == (r"$x$ / µm", r"$y$ / µm")
    np.testing.assert_allclose(bar._colorbar.mappable.get_clim(), [-top, top], rtol=1e-12)
    expected = {(False, True): "max", (True, True): "both", (True, False): "min"}
    assert bar._colorbar.extend == expected[state.force.min() * 1e9 < -top, state.force.max() * 1e9 > top]
    segments = np.array(whole.collections[0].get_segments())
    assert len(segments) == 2 * len(sheet.members)
    assert segments[..., 1].max() == pytest.approx(1.05 * 40.0, rel=1e-12)
    colours = whole.collections[0].get_colors()[1::2, :3]
    z = (sheet.nodes[sheet.members, 2]).mean(axis=1)
    force = 1e9 * state.force[np.argsort(z)]
    np.testing.assert_allclose(colours, bar._colorbar.mappable.to_rgba(force)[:, :3], atol=1e-12)
    assert (colours[force > 1, 0] > colours[force > 1, 2]).all()  # tension red, compression blue
    assert (colours[force < -1, 0] < colours[force < -1, 2]).all()
    low, high = zoom.get_xlim()
    assert whole.get_xlim()[0] < low < high < whole.get_xlim()[1] + 1.0
    assert 0 < len(zoom.collections[0].get_segments()) < len(segments)
    save_figure(figure, tmp_path / "sheet.png")
    assert imread(tmp_path / "sheet.png")[..., :3].std() > 0.05


def test_cells_of_a_large_sheet_have_the_mean_force_of_their_tendons():
    sheet = prestressed(lattice(box_cells(40, 8, 2), PARAMETERS), PARAMETERS, 1e-8)
    force = np.where(sheet.bars, -1.0, 1e-9 * sheet.cells[sheet.member_cells[:, 0], 0])
    whole, zoom = plot_sheet(sheet, 0.1 * sheet.nodes, force).axes
    (cells,) = whole.collections
    assert len(cells.get_array()) == 40 * 8
    left = np.array([path.vertices[:4, 0].min() for path in cells.get_paths()])
    np.testing.assert_allclose(np.sort(left).reshape(40, 8)[:, 0], 11.0 * np.arange(40), atol=1e-9)
    rising = cells.get_array()[np.argsort(left, kind="stable")].reshape(40, 8).mean(axis=1)
    assert (np.diff(rising) > 0).all()
    assert np.abs(rising - np.arange(40)).max() < 1.0  # shared tendons count with the cell before
    assert zoom.collections[0].get_segments()


def test_fields_of_one_label_share_a_scale():
    outline = block_outlines(grid(3, 4))
    fields = {"a": (np.arange(12.0), "p / Pa"), "b": (np.arange(12.0) + 5, "p / Pa"), "c": (np.full(12, 3.0), "q / Pa")}
    clims = [axes.collections[0].get_clim() for axes in plot_maps(outline, fields).axes[:3]]
    assert clims[0] == clims[1] == (0.0, 16.0)
    assert clims[2] == (1.5, 4.5)
    assert limits([np.array([1.0, 1.0 + 1e-12])]) == pytest.approx((0.5, 1.5))  # round-off is no field


def test_sheet_needs_a_lattice_and_its_forces(stretched):
    sheet, displacement, state = stretched
    with pytest.raises(InputError, match=r"force: expected finite numbers of shape"):
        plot_sheet(sheet, displacement, state.force[:-1])
    rod = from_arrays(
        np.eye(3)[:2], np.array([[0, 1]]), kind=np.zeros(1, np.uint8), EA=np.ones(1), rest_length=np.ones(1)
    )
    with pytest.raises(InputError, match="expected a lattice of cells"):
        plot_sheet(rod, np.zeros((2, 3)), np.zeros(1))


def grid(nx, ny, nz=1):
    return 2e-5 * (box_cells(nx, ny, nz) + 0.5)


def test_block_maps(tmp_path):
    midpoint = np.random.default_rng(1).permutation(grid(4, 3))
    p, q = midpoint[:, 0] * 1e6, np.full(12, 3.0)
    figure = plot_blocks(midpoint, {"$p$": (p, "$p$ / Pa"), "$q$": (q, "$q$ / Pa")})
    left, right = figure.axes[:2]
    (drawn,) = left.collections
    centre = [path.vertices[:4].mean(axis=0) for path in drawn.get_paths()]
    np.testing.assert_allclose(centre, 1e6 * midpoint[:, :2], rtol=1e-12)
    np.testing.assert_array_equal(drawn.get_array(), p)
    assert drawn.get_clim() == (p.min(), p.max())
    assert right.collections[0].get_clim() == (1.5, 4.5)
    assert (left.get_title(), left.get_xlabel(), left.get_ylabel()) == ("$p$", r"$x$ / µm", r"$y$ / µm")
    assert left.get_xlim() == pytest.approx((0.0, 80.0))
    save_figure(figure, tmp_path / "maps.png")
    assert (tmp_path / "maps.png").stat().st_size > 5000


@pytest.mark.parametrize("shape", [(4, 3), (4, 1), (1, 1)])
def test_deformed_blocks_are_exact_for_a_linear_field(shape):
    midpoint = grid(*shape)
    H = np.array([[0.02, 0.1, 0.0], [-0.03, 0.05, 0.0], [0.0, 0.0, 0.0]]) * (np.array([*shape, 1]) > 1)
    values = {"$p$": (np.arange(len(midpoint)), "Pa")}
    reference, deformed = (
        np.array(
            [
                path.vertices[:4]
                for path in plot_blocks(midpoint, values, displacement=u).axes[0].collections[0].get_paths()
            ]
        )
        for u in (None, midpoint @ H.T)
    )
    np.testing.assert_allclose(deformed, reference @ (np.eye(2) + H[:2, :2]).T, atol=1e-9)
    np.testing.assert_allclose(reference.min(axis=(0, 1)), 0.0, atol=1e-9)
    np.testing.assert_allclose(reference.max(axis=(0, 1)), 20.0 * np.array(shape), rtol=1e-12)


def test_uppermost_layer_of_blocks_is_drawn():
    midpoint = grid(3, 2, 2)
    (drawn,) = plot_blocks(midpoint, {"z": (midpoint[:, 2], "m")}).axes[0].collections
    np.testing.assert_array_equal(drawn.get_array(), np.full(6, midpoint[:, 2].max()))


def test_bad_blocks_are_refused():
    midpoint = grid(4, 3)
    with pytest.raises(InputError, match=r"field \$p\$: expected finite numbers of shape \(12,\)"):
        plot_blocks(midpoint, {"$p$": (np.full(12, np.nan), "Pa")})
    with pytest.raises(InputError, match="block midpoints: expected a full regular grid, got 11"):
        plot_blocks(midpoint[:-1], {"$p$": (np.zeros(11), "Pa")})


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "Pa"), (1e4, "kPa")])
def test_curve_marks_every_step(scale, unit):
    axes = plot_curve([0.0, 0.02, 0.05], scale * np.array([0.0, 1.0, 3.0])).axes[0]
    (line,) = axes.lines
    np.testing.assert_allclose(line.get_xdata(), [0.0, 2.0, 5.0])
    np.testing.assert_allclose(line.get_ydata(), np.array([0.0, 1.0, 3.0]) * (1.0 if unit == "Pa" else 10.0))
    assert line.get_marker() == "o"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("nominal strain / %", f"nominal stress / {unit}")
    with pytest.raises(InputError, match="stress: expected finite numbers"):
        plot_curve([0.0, 1.0], [0.0, np.nan])


def test_vtu_reads_back(stretched, tmp_path):
    sheet, displacement, state = stretched
    path = tmp_path / "sheet.vtu"
    write_vtu(path, sheet, displacement, state)
    mesh = meshio.read(path)
    np.testing.assert_array_equal(mesh.points, sheet.nodes + displacement)
    np.testing.assert_array_equal(mesh.point_data["displacement"], displacement)
    (block,) = mesh.cells
    assert block.type == "line"
    np.testing.assert_array_equal(block.data, sheet.members)
    data = {name: values for name, (values,) in mesh.cell_data.items()}
    assert set(data) == {"kind", "force", "strain", "slack", "cell", "block"}
    np.testing.assert_array_equal(data["kind"], sheet.kind)
    np.testing.assert_array_equal(data["force"], state.force)
    drawn = np.linalg.norm(np.diff(mesh.points[block.data], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(data["strain"], drawn / sheet.rest_length - 1, atol=1e-14)
    np.testing.assert_allclose(data["strain"] * sheet.EA, data["force"], rtol=1e-9, atol=1e-18)
    centre = sheet.nodes[sheet.members].mean(axis=1)
    for name, index, size in (("cell", sheet.cells, 1e-5), ("block", sheet.blocks, 2e-5)):
        middle = (index[data[name]] + 0.5) * size
        assert (np.abs(centre - middle) <= 0.5 * size * (1 + 1e-9)).all()


def test_vtu_of_slack_and_periodic_members(tmp_path):
    block = lattice(box_cells(2, 2, 2), PARAMETERS, periodic=(True, False, False))
    displacement = -0.1 * block.nodes
    state = MemberSystem(block, slack=True).state(np.append(displacement.ravel(), np.zeros(9)))
    write_vtu(tmp_path / "block.vtu", block, displacement, state)
    mesh = meshio.read(tmp_path / "block.vtu")
    inside = ~block.shift.any(axis=1)
    assert 0 < inside.sum() < len(inside)
    assert len(mesh.cells[0].data) == inside.sum()
    np.testing.assert_array_equal(mesh.cell_data["slack"][0], ~block.bars[inside])
    with pytest.raises(InputError, match=r"ends in .vtu"):
        write_vtu(tmp_path / "block.vtk", block, displacement, state)


def test_vtu_without_cells(tmp_path):
    rod = from_arrays(
        np.eye(3)[:2], np.array([[0, 1]]), kind=np.zeros(1, np.uint8), EA=np.ones(1), rest_length=np.ones(1)
    )
    write_vtu(tmp_path / "rod.vtu", rod, np.zeros((2, 3)), MemberSystem(rod).state(np.zeros(15)))
    mesh = meshio.read(tmp_path / "rod.vtu")
    assert [mesh.cell_data[name][0].tolist() for name in ("cell", "block")] == [[-1], [-1]]
    assert mesh.cell_data["strain"][0][0] == pytest.approx(np.sqrt(2) - 1)
