"""Structures in space: to scale in both renderers, coloured by what they were given; the time series for ParaView."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from matplotlib.image import imread

from tsg_micro.cells.lattice import box_cells, lattice
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.structure import from_arrays
from tsg_micro.data.errors import InputError
from tsg_micro.data.figure_style import save_figure
from tsg_micro.data.series import write_pvd
from tsg_micro.data.voxels import voxel_body
from tsg_micro.figures.parts import middle_layer
from tsg_micro.figures.sheet import BAR_WIDTH, FORCE
from tsg_micro.figures.space import View, choose_renderer, plot_body, plot_structure, plot_views
from tsg_micro.figures.voxels import plot_voxels

PARAMETERS = CellParameters()
needs_pyvista = pytest.mark.skipif(choose_renderer() != "pyvista", reason="no pyvista that renders here")
RENDERERS = ["matplotlib", pytest.param("pyvista", marks=needs_pyvista)]


@pytest.fixture
def cell():
    return lattice(box_cells(1, 1, 1), PARAMETERS)


def lengths(collection):
    return np.array([np.linalg.norm(np.diff(s, axis=0)) for s in collection.get_segments()])


def lines_of(figure, panel=0):
    (lines,) = figure.axes[panel].collections
    return lines


def test_deep_bodies_are_drawn_as_their_middle_layer():
    deep = lattice(box_cells(4, 4, 5), PARAMETERS)
    force = 1e-12 * np.arange(len(deep.members), dtype=np.float64)
    figure = plot_body(deep, [View("now", None, force)], renderer="matplotlib")
    shown = middle_layer(deep)
    cells = deep.cells[deep.member_cells[shown]][..., 2]
    assert (cells == 2).any(axis=1).all()
    assert 0 < shown.sum() < 0.5 * len(deep.members)
    drawn = np.asarray(lines_of(figure).get_segments())[1::2]
    assert len(drawn) == shown.sum()
    low, high = 1e6 * deep.nodes.min(axis=0), 1e6 * deep.nodes.max(axis=0)
    np.testing.assert_allclose(drawn.min(axis=(0, 1)), low[:2], atol=1e-9)  # seen from above
    np.testing.assert_allclose(drawn.max(axis=(0, 1)), high[:2], atol=1e-9)
    thin = lattice(box_cells(5, 5, 2), PARAMETERS)
    assert len(lines_of(plot_body(thin, [View()], renderer="matplotlib")).get_segments()) == 2 * len(thin.members)


def test_lines_are_drawn_to_scale(cell, tmp_path):
    figure = plot_structure(cell, renderer="matplotlib")
    lines = lines_of(figure)
    assert len(lines.get_segments()[1::2]) == 48  # every second one is an edge
    widths, longest = np.asarray(lines.get_linewidths())[1::2], lengths(lines)[1::2]
    assert (widths == widths.min()).sum() == 12  # bars are thinner than tendons
    assert widths.min() == pytest.approx(BAR_WIDTH * widths.max())
    # a parallel projection shortens, the more the steeper, and never lengthens
    length = 1e6 * cell.rest_length
    assert longest.max() <= length.max() * (1 + 1e-12)
    assert longest.max() > 0.9 * length.max()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["square tendon", "edge tendon", "bar"]
    bar, label = figure.axes[0].lines[0], figure.axes[0].texts[0].get_text()
    assert label == f"{np.ptp(bar.get_xdata()):g} µm"
    assert figure.axes[0].get_aspect() == 1
    assert not figure.axes[0].axison
    save_figure(figure, tmp_path / "cell.png")
    assert imread(tmp_path / "cell.png")[..., :3].std() > 0.05
    assert [path.name for path in tmp_path.iterdir()] == ["cell.png"]


def test_lines_follow_the_displacement(cell):
    plain, doubled = (lines_of(plot_structure(cell, u, renderer="matplotlib")) for u in (None, cell.nodes))
    np.testing.assert_allclose(lengths(doubled), 2 * lengths(plain), rtol=1e-12)
    with pytest.raises(InputError, match=r"displacement: expected finite numbers of shape \(24, 3\)"):
        plot_structure(cell, np.full((24, 3), np.nan))


@pytest.mark.parametrize("renderer", RENDERERS)
def test_upright_rod_gets_a_scale_bar(renderer):
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e-5]])
    rod = from_arrays(ends, np.array([[0, 1]]), kind=np.full(1, 2, np.uint8), EA=np.ones(1), rest_length=np.ones(1))
    assert plot_structure(rod, renderer=renderer).axes[0].texts[0].get_text() == "2 µm"


def test_periodic_members_reach_their_image():
    block = lattice(box_cells(2, 2, 2), PARAMETERS, periodic=(True, True, True))
    lines = lines_of(plot_structure(block, renderer="matplotlib"))
    assert lengths(lines).max() <= 1e6 * block.rest_length.max() * (1 + 1e-12)


@needs_pyvista
def test_tubes_are_where_the_lines_are():
    """One upright rod, seen from the front: the pixels it covers are its length and its thickness."""
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e-5], [4e-6, 0.0, 2e-6], [4e-6, 0.0, 6e-6]])
    rods = from_arrays(
        ends,
        np.array([[0, 1], [2, 3]]),
        kind=np.array([2, 0], np.uint8),
        EA=np.ones(2),
        rest_length=np.ones(2),
    )
    figure = plot_views(rods, [View()], azimuth=-90.0, elevation=0.0, renderer="pyvista")
    (image,) = figure.axes[0].images
    left, right, bottom, top = image.get_extent()
    dark = np.asarray(image.get_array())[..., :3].min(axis=2) < 200
    x = left + (right - left) * (np.arange(dark.shape[1]) + 0.5) / dark.shape[1]
    z = top - (top - bottom) * (np.arange(dark.shape[0]) + 0.5) / dark.shape[0]
    bar, tendon = dark[:, np.abs(x) < 0.5], dark[:, np.abs(x - 4.0) < 0.5]
    tall = z[tendon.any(axis=1)]
    assert (tall.min(), tall.max()) == pytest.approx((2.0, 6.0), abs=0.25)
    assert np.ptp(z[bar.any(axis=1)]) == pytest.approx(10.0, abs=0.5)
    pixel = (right - left) / dark.shape[1]
    thin, thick = (part.sum(axis=1).max() * pixel for part in (bar, tendon))
    assert thick > 1.5 * thin > 0.05


@pytest.mark.parametrize("renderer", RENDERERS)
def test_views_share_scale_and_colours(cell, renderer, tmp_path):
    force = np.where(cell.bars, -2e-9, 1e-9)
    squeezed = cell.nodes * [0.0, 0.0, -0.2]
    views = [View("before", None, 0.5 * force), View("after", squeezed, force)]
    figure = plot_views(cell, views, renderer=renderer, width=3.0)
    before, after = figure.axes[:2]
    assert (before.get_title(), after.get_title()) == ("before", "after")
    assert before.get_xlim() == after.get_xlim()
    assert before.get_ylim() == after.get_ylim()
    (bar,) = [axes for axes in figure.axes if axes.get_ylabel() == "member force / nN"]
    assert bar._colorbar.mappable.get_clim() == pytest.approx((-2.0, 2.0))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["tendon", "bar"]
    for axes in (before, after):  # compressed bars are bluish, tendons reddish
        if renderer == "matplotlib":
            colours = np.asarray(axes.collections[0].get_colors())[1::2, :3]
            red = int((colours[:, 0] > colours[:, 2]).sum())
            assert (red, len(colours) - red) == (36, 12)
        else:
            image = np.asarray(axes.images[0].get_array()).astype(int)
            assert (image[..., 2] - image[..., 0] > 20).sum() > 1000
            assert (image[..., 0] - image[..., 2] > 20).sum() > 1000
    save_figure(figure, tmp_path / "views.png")
    assert imread(tmp_path / "views.png")[..., :3].std() > 0.05


def test_full_force_has_the_end_colour(cell):
    force = np.where(cell.bars, -2e-9, 2e-9)
    colours = np.asarray(lines_of(plot_structure(cell, None, force, renderer="matplotlib")).get_colors())[1::2, :3]
    faded = np.unique(np.round(colours, 6), axis=0)
    assert len(faded) > 2  # far members fade towards the paper
    near = colours[np.argsort(colours.sum(axis=1))[:5]]
    assert np.abs(near[:, None] - np.array([FORCE(0.0)[:3], FORCE(1.0)[:3]])).max(axis=2).min(axis=1).max() < 0.1


def test_without_pyvista_lines_are_drawn(cell, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)  # importing it fails
    assert choose_renderer() == "matplotlib"
    assert len(lines_of(plot_structure(cell)).get_segments()) == 2 * 48
    with pytest.raises(InputError, match="renderer: expected one that is installed, got pyvista"):
        plot_structure(cell, renderer="pyvista")


def test_bad_views(cell):
    force = np.ones(48)
    with pytest.raises(InputError, match="views: expected at least one, and forces in all of them or in none"):
        plot_views(cell, [])
    with pytest.raises(InputError, match="forces in all of them or in none"):
        plot_views(cell, [View(), View(force=force)])
    with pytest.raises(InputError, match=r"force: expected finite numbers of shape \(48,\)"):
        plot_structure(cell, None, force[1:])
    with pytest.raises(InputError, match="renderer: expected"):
        plot_structure(cell, renderer="crayon")


def test_time_series(tmp_path):
    write_pvd(tmp_path / "run.pvd", [(0.0, "steps/000.vtu"), (np.float64(2.5), 'steps/"a&b".vtu')])
    sets = ET.parse(tmp_path / "run.pvd").getroot().findall("Collection/DataSet")
    assert [(float(s.attrib["timestep"]), s.attrib["file"]) for s in sets] == [
        (0.0, "steps/000.vtu"),
        (2.5, 'steps/"a&b".vtu'),
    ]
    for steps in ([], [(1.0, "a"), (1.0, "b")], [(np.nan, "a")]):
        with pytest.raises(InputError, match="steps: expected at least one, with finite times that rise"):
            write_pvd(tmp_path / "bad.pvd", steps)
    with pytest.raises(InputError, match=r"ends in \.pvd"):
        write_pvd(tmp_path / "run.xml", [(0.0, "a")])
    assert [path.name for path in tmp_path.iterdir()] == ["run.pvd"]


def test_voxels_are_drawn_to_scale_and_the_near_eighth_shows_the_inside(tmp_path):
    body = voxel_body(box_cells(4, 4, 4))
    one = plot_voxels(body, 1e-5, np.zeros(64), ["body"], azimuth=-90.0, elevation=0.0)
    (faces,) = one.axes[0].collections
    corners = np.concatenate([path.vertices for path in faces.get_paths()])
    assert len(faces.get_paths()) == 16  # along y, the faces of one side alone
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[0, 0], [40, 40]], atol=1e-9)
    inner = ((body.nodes[body.cells[:, 0]] >= 1) & (body.nodes[body.cells[:, 0]] <= 2)).all(axis=1)
    two = plot_voxels(body, 1e-5, inner.astype(int), ["outside", "inside"])
    assert [text.get_text() for text in two.legends[0].get_texts()] == ["outside", "inside"]
    (faces,) = two.axes[0].collections
    assert len(faces.get_paths()) == 3 * 16  # of the cube: what is cut off three sides is seen further in
    orange = [colour[0] > colour[2] for colour in faces.get_facecolors()]
    assert sum(orange) == 3  # one of each of the three cuts
    save_figure(two, tmp_path / "body.png")
    assert imread(tmp_path / "body.png")[..., :3].std() > 0.05
    with pytest.raises(InputError, match="edge, regions: expected a positive length"):
        plot_voxels(body, -1.0, np.zeros(64), ["body"])
