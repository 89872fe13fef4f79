"""Every scene of docs/examples runs, and says a number that comes from elsewhere."""

from __future__ import annotations

import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest

import meshes
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_spec import RVESpec
from workflows.scenes.read import read_scene

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
NAMES = sorted(path.stem for path in EXAMPLES.glob("*.toml"))
BLOCK = 20e-6


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The scenes, and the meshes that their script makes."""
    folder = tmp_path_factory.mktemp("examples")
    for path in EXAMPLES.glob("*.toml"):
        shutil.copy(path, folder)
    runpy.run_path(str(EXAMPLES / "make_meshes.py"))["make_meshes"](folder)
    return folder


@pytest.fixture
def run(folder, tsgdd, read_summary, tmp_path):
    """``run(name, *options, command="solve", scene=text -> text)``: the summary of a run of an example."""

    def start(name, *options, command="solve", scene=lambda text: text):
        text = (folder / f"{name}.toml").read_text()
        changed = scene(text)
        file = folder / f"{name}.toml" if changed == text else folder / f"{name}_changed.toml"
        file.write_text(changed)
        done = tsgdd(command, file, *options, "--no-plots", "--out", tmp_path / f"{name}_{command}")
        assert done.code == 0, done.err
        return read_summary(tmp_path / f"{name}_{command}")

    return start


def with_(*pairs):
    """A change of a scene's text: each pair is what goes, which must be there, and what comes."""

    def change(text):
        for old, new in pairs:
            assert old in text
            text = text.replace(old, new)
        return text

    return change


def test_all_of_them_are_here():
    table = (EXAMPLES / "README.md").read_text()
    assert len(NAMES) == 8
    for name in NAMES:
        assert f"{name}.toml" in table
        assert f"test_{name}" in globals()


def test_strip(run):
    """FE2 and the full tensegrity of the same file; the root carries what the tip does."""
    found = run("strip")
    np.testing.assert_allclose(found["reactions"]["left"], [-15.0 * BLOCK**2, 0.0, 0.0], atol=1e-9 * 15 * BLOCK**2)
    tip = found["displacements"]["right"][0]
    assert tip == pytest.approx(run("strip", command="fe2")["displacements"]["right"][0], rel=0.01)
    assert tip == pytest.approx(run("strip", command="dns")["displacements"]["right"][0], rel=0.02)


def test_hole(run, folder):
    """The plane of symmetry carries the load, nothing leaves its plane, the hole opens along it and closes across."""
    found = run("hole")
    load = 20.0 * 6 * BLOCK * BLOCK
    assert found["reactions"]["bottom"][1] == pytest.approx(-load, rel=1e-8)
    moved = found["displacements"]
    for side, axis in (("left", 0), ("bottom", 1), ("back", 2)):
        assert abs(moved[side][axis]) < 1e-9 * moved["top"][1]
    assert moved["hole"][0] < 0 < moved["hole"][1]
    size = (6 * BLOCK, 8 * BLOCK, BLOCK)
    meshes.quarter_with_hole(folder / "coarse.msh", elements=(2, 2, 1), size=size, radius=2 * BLOCK)
    coarse = with_(("hole.msh", "coarse.msh"), ("[solve]", "[solve]\nedges = false"))
    adaptive, fe2 = (run("hole", command=command, scene=coarse) for command in ("solve", "fe2"))
    assert adaptive["displacements"]["top"][1] == pytest.approx(fe2["displacements"]["top"][1], rel=0.005)


def test_spheroid(run):
    """Its six sides move alike; a smaller one is as the full tensegrity."""
    small = with_(("spheroid = 3", "spheroid = 2"))
    found = run("spheroid", scene=small)
    inwards = [found["displacements"][side][k // 2] * (-1) ** k for k, side in enumerate(SIDES)]
    np.testing.assert_allclose(inwards, inwards[0], rtol=1e-3)
    assert inwards[0] > 0
    assert found["factor_steps"] == [0.5, 1.0]
    dns = run("spheroid", command="dns", scene=small)
    assert found["volume_change"] == pytest.approx(dns["volume_change"], rel=0.1)


SIDES = ("left", "right", "bottom", "top", "back", "front")


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_spheroid_of_one_tissue_under_little_pressure(run, kinematics):
    """10 nN and 5 Pa: -0.45 % (FE2 and the full tensegrity)."""
    change = with_(
        ('{profile = "exponential", f_max = "50 nN", decay = 2}', '"10 nN"'),
        ("100 Pa", "5 Pa"),
        ('"finite"', f'"{kinematics}"'),
        ("spheroid = 3", "spheroid = 2"),
    )
    found = run("spheroid", scene=change)
    assert found["volume_change"] == pytest.approx(-4.5e-3, rel=0.01)
    assert found["estimated_error"] < 0.01


def test_cube(run):
    """Homogeneous: the force on the plate is the stress of one RVE whose sides are free."""
    found = run("cube")
    rve = RVESpec.of_kind("bulk", Tissue(bar_force=1e-8), free=("xx", "yy")).build()
    state = rve.solve_strain([0.0, 0.0, -0.03, 0.0, 0.0, 0.0], steps=2)
    assert found["reactions"]["front"][2] == pytest.approx(state.first_piola[2, 2] * (2 * BLOCK) ** 2, rel=1e-3)
    assert found["displacements"]["right"][0] == pytest.approx((state.F[0, 0] - 1.0) * 2 * BLOCK, rel=5e-3)


def test_inclusion(run, folder):
    """Between the cubes of one tissue and the other; reactions in balance; FE2 within half a per cent."""
    size = (3 * BLOCK, 3 * BLOCK, 3 * BLOCK)
    meshes.box_with_inclusion(folder / "small.msh", elements=(3, 3, 3), size=size, radius=0.5 * BLOCK)
    small = ("inclusion.msh", "small.msh")
    found = run("inclusion", scene=with_(small))
    front, back = (np.array(found["reactions"][side]) for side in ("front", "back"))
    np.testing.assert_allclose(front, -back, atol=1e-8 * abs(front[2]))
    soft = run("inclusion", scene=with_(small, ("20 nN", "5 nN")))["reactions"]["front"][2]
    stiff = run("inclusion", scene=with_(small, ("5 nN", "20 nN")))["reactions"]["front"][2]
    fe2 = run("inclusion", command="fe2", scene=with_(small))
    assert stiff < front[2] < soft < 0
    assert front[2] == pytest.approx(fe2["reactions"]["front"][2], rel=0.005)


def test_arc(run):
    """The root carries the traction, 2 Pa in the mean, and the weight of the tip, whose volume is a closed form."""
    found = run("arc")
    length, width, thickness, radius, ratio = 0.24e-3, 0.06e-3, 0.04e-3, 0.16e-3, 0.5
    t = thickness * (1.0 + (ratio - 1.0) * np.linspace(0.5, 1.0, 2001))
    volume = width * 0.5 * length * np.trapezoid(t + t**2 / (2 * radius), dx=1 / 2000)
    area = width * ratio * thickness
    assert found["reactions"]["left"][2] == pytest.approx(-2.0 * area + 2e3 * volume, rel=1e-3)
    np.testing.assert_allclose(found["reactions"]["left"][:2], 0.0, atol=1e-6 * 2.0 * area)
    moved = found["displacements"]
    assert moved["top"][2] > moved["bottom"][2]  # it twists towards the larger traction
    assert found["estimated_error"] < 0.02


def test_voxels(run, folder, tsgdd, read_summary):
    """It carries the weight of its voxels; pressure on all of the surface adds nothing; both sides of y move alike."""
    surface = ("--surface", folder / "organ.stl", "--unit", "um", "--size", "20um")
    assert tsgdd("mesh", "voxels", *surface, "--no-plots", "--out", folder / "voxels.msh").code == 0
    mesh = read_summary(folder / "voxels.msh")
    assert mesh["volume"] == pytest.approx(mesh["voxels"] * BLOCK**3, rel=1e-12)
    found = run("voxels")
    np.testing.assert_allclose(
        found["reactions"]["back"], [0.0, 0.0, 1e5 * mesh["volume"]], atol=1e-7 * 1e5 * mesh["volume"]
    )
    bottom, top = found["displacements"]["bottom"], found["displacements"]["top"]
    assert bottom[1] == pytest.approx(-top[1], rel=1e-4)
    assert found["volume_change"] < 0


def test_two_data(run, folder, tsgdd):
    """Few data are wrong, and say by how much: against the adaptive solution of the same file."""
    scene = folder / "two_data.toml"
    for name in ("soft", "stiff"):
        sampled = ("--paths", 12, "--steps", 2, "--no-plots", "--processes", 1, "--out", folder / f"{name}.h5")
        assert tsgdd("sample", scene, "--tissue-name", name, *sampled).code == 0
    found = run("two_data")
    exact = run("inclusion")["reactions"]["front"][2]
    off = abs(found["reactions"]["front"][2] / exact - 1.0)
    assert found["estimated_error"] > 0.02
    assert off < 2.0 * found["estimated_error"]
    assert found["warnings"] or found["estimated_error"] < 0.05


@pytest.mark.parametrize("name", NAMES)
def test_the_file_is_read(folder, name):
    scene = read_scene(folder / f"{name}.toml")
    assert scene.solve.method in ("adaptive", "tangents")
    assert scene.body.mesh is None or scene.body.mesh.parent == folder
