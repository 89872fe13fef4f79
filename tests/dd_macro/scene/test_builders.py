"""Meshes that are built: volumes, sides and regions in closed form, read back on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest

import dd_macro as dd
import meshes
from dd_macro.parallel import total
from dd_macro.scene.hexahedra import hexahedra
from dd_macro.scene.loads import nodal_forces
from dd_macro.scene.msh import read_msh_file
from meshes.msh import write_msh
from meshes.voxels import Voxels, write_voxels
from tsg_micro.cells.lattice import box_cells
from tsg_micro.data.errors import InputError
from tsg_micro.data.voxels import voxel_body

pytestmark = pytest.mark.mpi
SIZE = (2e-4, 1e-4, 2e-5)


@pytest.fixture
def built(comm, folder):
    """Write with a builder on rank 0, and read on all."""

    def make(builder, *arguments, **more):
        if comm.rank == 0:
            builder(folder / "body.msh", *arguments, **more)
        comm.barrier()
        return dd.read_msh(folder / "body.msh", comm)

    return make


def volumes(domain):
    """Volume of each region, and of the body, m³."""
    weights = dd.StrainOperator(domain).weights.reshape(domain.owned_cells, -1).sum(axis=1)
    own = {name: inside[inside < domain.owned_cells] for name, inside in domain.regions.items()}
    return {name: float(total(domain.comm, weights[inside].sum())) for name, inside in own.items()} | {
        "": float(total(domain.comm, weights.sum()))
    }


def area(domain, side):
    operator = dd.StrainOperator(domain)
    return float(total(domain.comm, nodal_forces(operator, [dd.Traction(side, (0.0, 1.0, 0.0))]).sum()))


def test_a_quarter_with_a_hole_and_its_planes_of_symmetry(built):
    width, height, thickness = SIZE
    radius = 3e-5
    body = built(meshes.quarter_with_hole, elements=(8, 6, 2), size=SIZE, radius=radius)
    polygon = 0.5 * 16 * radius**2 * np.sin(0.5 * np.pi / 16)  # of the hole's sixteen chords
    assert volumes(body)[""] == pytest.approx((width * height - polygon) * thickness, rel=1e-12)
    assert set(body.names) == {*dd.SIDES, "hole"}
    straight = {"left": height - radius, "bottom": width - radius, "right": height, "top": width}
    straight["hole"] = 32 * radius * np.sin(0.25 * np.pi / 16)
    for side, length in straight.items():
        assert area(body, side) == pytest.approx(length * thickness, rel=1e-12)
    for side, axis, place in (("left", 0, 0.0), ("bottom", 1, 0.0), ("right", 0, width), ("top", 1, height)):
        low, high, _ = body.extent(side)
        np.testing.assert_allclose([low[axis], high[axis]], place, atol=1e-18)


def test_a_curved_tapered_strip_of_two_regions(built):
    length, width, thickness = SIZE
    radius, ratio = 1e-4, 0.5
    body = built(
        meshes.curved_sheet,
        elements=(40, 3, 2),
        size=SIZE,
        radius=radius,
        thickness_ratio=ratio,
        region=lambda x: np.where(x[:, 0] < 0.25 * length, "root", "tip"),
    )
    # of a cylinder's part with thickness t: (R t + t^2 / 2) over R, along the arc and the width
    t = thickness * (1.0 + (ratio - 1.0) * np.linspace(0.0, 1.0, 4001))
    density = width * length * (t + t**2 / (2 * radius))
    whole, root = (np.trapezoid(part, dx=1 / 4000) for part in (density, density[:1001]))
    found = volumes(body)
    assert found[""] == pytest.approx(whole, rel=1e-3)
    assert found["root"] == pytest.approx(root, rel=1e-3)
    assert found["root"] + found["tip"] == pytest.approx(found[""], rel=1e-12)
    assert area(body, "right") == pytest.approx(ratio * width * thickness, rel=1e-12)


def test_a_box_with_an_inclusion(built):
    body = built(meshes.box_with_inclusion, elements=(6, 6, 6), size=(6.0, 6.0, 6.0), radius=1.5)
    found = volumes(body)
    # centres at half-odd places: (+-1/2)^3 with distance 0.87, and (3/2, 1/2, 1/2) with 1.66 outside
    assert found["inclusion"] == pytest.approx(8.0, rel=1e-12)
    assert found["inclusion"] + found["matrix"] == pytest.approx(216.0, rel=1e-12)


def test_voxels_of_a_file_are_those_of_voxel_mesh(comm, built):
    places = box_cells(3, 2, 2)[:-1]
    labels = np.where(places[:, 0] < 1, 4, 7)
    file = built(write_voxels, Voxels(places, labels, 1, 0), edge=2e-5, origin=(0.0, 0.0, 0.0), labelled=True)
    numbers = {f"label-{i}": np.flatnonzero(labels == i) for i in (4, 7)}
    made = dd.voxel_mesh(comm, places, edge=2e-5, regions=numbers)
    assert set(file.names) == set(made.names) == {"surface", *dd.SIDES}
    for side in made.names:
        assert area(file, side) == pytest.approx(area(made, side), rel=1e-12)
    assert volumes(file) == pytest.approx(volumes(made), rel=1e-12)
    assert dd.StrainOperator(file).global_dofs == dd.StrainOperator(made).global_dofs


def test_a_box_whose_outer_elements_are_halved(comm):
    """At some of its sides; the body is the same, and so are its sides."""
    length, width, thickness = SIZE
    body = dd.box(comm, elements=(6, 3, 1), size=SIZE, refine=2, halved=("left", "bottom", "top"))
    nodes = dd.StrainOperator(body).node_coordinates()
    near, across = np.array([0, 0.25, 0.5, 0.75, 1, 1.25, 1.5, 1.75, 2]), np.arange(13) / 4
    for axis, planes in ((0, [*near, 2.5, 3, 3.5, 4, 4.5, 5, 5.5, 6]), (1, across), (2, [0, 0.5, 1])):
        edge = SIZE[axis] / (6, 3, 1)[axis]
        found = np.abs(nodes[:, axis, None] / edge - np.array(planes))
        assert found.min(axis=1).max(initial=0.0) < 1e-12  # every node on a plane
        there = total(comm, np.bincount(found.argmin(axis=1), minlength=len(planes)).astype(float))
        assert there.min() > 0  # and every plane has some
    assert body.global_cells == 16 * 12 * 2
    assert volumes(body)[""] == pytest.approx(length * width * thickness, rel=1e-12)
    areas = {"left": width, "bottom": length, "right": width, "top": length}
    for side, edge in areas.items():
        assert area(body, side) == pytest.approx(edge * thickness, rel=1e-12)
    for bad in ({"halved": ("up",)}, {"halved": "left"}, {"refine": 0}, {"refine": 1.5}):
        with pytest.raises(InputError, match="halved: expected a whole number of at least 1, and some of left"):
            dd.box(comm, elements=(2, 2, 1), size=SIZE, **bad)


def test_gmsh_reads_what_is_written(comm, folder, gmsh):
    if comm.rank > 0:
        return
    body = voxel_body(box_cells(2, 2, 1)[:3])
    regions = {"all": np.ones(3, dtype=bool), "one": np.arange(3) == 1}
    write_msh(
        folder / "a.msh", 2e-5 * body.nodes.astype(float), body.cells, body.faces, sides=body.sides(), regions=regions
    )
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.merge(str(folder / "a.msh"))
        names = {gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups()}
        gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
        gmsh.write(str(folder / "b.msh"))
    finally:
        gmsh.finalize()
    assert names == {"surface", *dd.SIDES, "all", "one"}
    first, second = (hexahedra(read_msh_file(folder / name)) for name in ("a.msh", "b.msh"))
    np.testing.assert_allclose(first.points, second.points, rtol=1e-15)
    assert np.array_equal(np.unique(first.cells, axis=0), np.unique(second.cells, axis=0))
    assert {name: len(own) for name, own in first.regions.items()} == {"all": 3, "one": 1}
    assert {name: len(own) for name, own in second.regions.items()} == {"all": 3, "one": 1}


@pytest.mark.parametrize(
    ("builder", "change", "message"),
    [
        ("flat_sheet", {"elements": (0, 1, 1)}, "elements: expected three positive integers"),
        ("flat_sheet", {"size": (1.0, 1.0, np.nan)}, "size: expected three positive lengths"),
        ("flat_sheet", {"region": lambda x: "one"}, "region: expected a name for each of 4 cells"),
        ("flat_sheet", {"region": lambda x: np.full(len(x), 'a"b')}, "name of a side or region: expected up to 120"),
        ("curved_sheet", {"radius": 1e-6}, "radius: expected more than"),
        ("curved_sheet", {"radius": 1e-3, "thickness_ratio": 0.0}, "thickness_ratio: expected a positive"),
        ("quarter_with_hole", {"radius": 2e-4}, "radius: expected between 0 and the shorter side"),
        ("box_with_inclusion", {"radius": 1e-9}, "radius: expected some of 4 cells inside, got 0"),
        ("box_with_inclusion", {"radius": 1.0}, "radius: expected some of 4 cells inside, got 4"),
    ],
)
def test_bad_input_is_named(folder, builder, change, message):
    with pytest.raises(InputError, match=message):
        getattr(meshes, builder)(folder / "bad.msh", **({"elements": (2, 2, 1), "size": SIZE} | change))
    assert not (folder / "bad.msh").exists()
