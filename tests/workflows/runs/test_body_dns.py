"""The full tensegrity of bodies of voxels: loads against reactions, sides and parts of them, runs that were cut."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.errors import InputError
from workflows.runs.body_dns import body_dns
from workflows.runs.voxel_scene import scene_loads, voxel_scene

TISSUE = Tissue()
EDGE = TISSUE.block
STAIR = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]])
STEP = {"step": lambda x: (np.abs(x[:, 1] - EDGE) < 1e-9) & (x[:, 0] < EDGE)}
"""The upper face of the first block, on which the third one does not stand."""


def mesh(blocks, **more):
    return dd.voxel_mesh(MPI.COMM_SELF, blocks, edge=EDGE, **more)


def cube(n):
    return np.argwhere(np.ones((n, n, n), dtype=bool))


@pytest.fixture
def run(tmp_path):
    def start(domain, supports, loads, *, out=tmp_path, force=1e-8, **more):
        given: dict[str, Any] = {"factors": (0.5, 1.0), "plots": False} | more
        return body_dns(
            out,
            domain=domain,
            tissue=TISSUE,
            bar_force=np.broadcast_to(force, domain.global_cells),
            supports=supports,
            loads=loads,
            **given,
        )

    return start


def test_reactions_are_the_loads(run, tmp_path):
    """Tractions, one of them a function, a pressure on a part, a body force in a region, on a stair that is held."""
    domain = mesh(STAIR, origin=(1e-5, -4e-5, 0.0), regions={"first": [0]})
    loads = [
        dd.Traction("right", (3.0, -5.0, 2.0)),
        dd.Traction("top", lambda x: np.column_stack([0.0 * x[:, 0], 1e5 * x[:, 0], 0.0 * x[:, 0]])),
        dd.Pressure("front", 4.0),
        dd.BodyForce((0.0, 0.0, -2e5), "first"),
    ]
    summary = run(domain, [dd.Displacement("left")], loads)
    area = EDGE**2
    applied = np.array([2 * 3.0, -2 * 5.0, 2 * 2.0]) * area  # two faces are on the right
    applied += [0.0, 1e5 * (1e-5 + 1.5 * EDGE) * area, -3 * 4.0 * area - 2e5 * EDGE**3]
    np.testing.assert_allclose(summary["reactions"]["left"], -applied, rtol=1e-7)
    assert summary["unsupported_force"] < 1e-8
    assert (summary["blocks"], summary["cells"], summary["negative_pivots"]) == (3, 24, 0)
    assert (summary["pressure_follows"], summary["free_motions"]) == (False, 0)
    assert summary["displacements"]["left"] == [0.0, 0.0, 0.0]
    assert summary["displacements"]["right"][2] < 0.0
    for name, measure in (("blocks.h5", "first_piola"), ("blocks_kirchhoff.h5", "kirchhoff")):
        data = read_dataset(tmp_path / name)
        assert data.stress_measure == measure
        assert data.midpoint is not None
        middle = np.array([1e-5, -4e-5, 0.0]) + EDGE * (STAIR + 0.5)
        np.testing.assert_allclose(data.midpoint[np.lexsort(data.midpoint.T)], middle[np.lexsort(middle.T)])
    assert json.loads((tmp_path / "summary.json").read_text())["command"] == "dns"
    assert not (tmp_path / "checkpoint.h5").exists()


def test_supports_are_asked_at_the_nodes(run):
    """A cube between clamps, and its top turned by a function; a part of a side; a condition over one before it."""
    domain = mesh(cube(2))
    held = dd.Displacement("bottom")
    down = run(domain, [held, dd.Displacement("top", (0.0, -0.03 * 2 * EDGE, 0.0))], [])
    assert down["reactions"]["top"][1] / (2 * EDGE) ** 2 == pytest.approx(-32.91, abs=0.005)
    np.testing.assert_allclose(down["reactions"]["top"], -np.array(down["reactions"]["bottom"]), atol=1e-16)
    scene = voxel_scene(domain, TISSUE, np.full(8, 1e-8))

    def turned(x):
        return 0.01 * np.column_stack([x[:, 2], -x[:, 0]])

    half = dd.Displacement("top", (1e-6,), (0,), where=lambda x: x[:, 0] < EDGE)
    loads = scene_loads(scene, [held, dd.Displacement("top", turned, (0, 2)), half], [])
    top, x = scene.nodes("top"), scene.body.position
    np.testing.assert_allclose(x[top, 1], 2 * EDGE)
    assert not loads.fixed[top, 1].any()
    near = top[x[top, 0] < EDGE]
    np.testing.assert_array_equal(loads.displacement[near, 0], 1e-6)
    far = np.setdiff1d(top, near)
    np.testing.assert_array_equal(loads.displacement[far][:, [0, 2]], turned(x[far]))
    assert len(near) == len(far) == 4 * 8


def test_edges_and_points_are_the_nodes_next_to_them():
    domain = mesh(cube(2))
    scene = voxel_scene(domain, TISSUE, np.full(8, 1e-8))
    edge, point = scene.nodes(("left", "bottom")), scene.nodes(("left", "bottom", "back"))
    x = scene.body.position
    assert (len(edge), len(point)) == (2 * 4, 3)
    assert (np.linalg.norm(x[edge][:, :2], axis=1) < 0.3 * EDGE / 2).all()
    assert (np.linalg.norm(x[point], axis=1) < 0.6 * EDGE / 2).all()
    with pytest.raises(InputError, match="expected nodes on all of left, right, got none"):
        scene.nodes(("left", "right"))


def test_a_pressure_all_around_follows_and_on_parts_is_dead():
    domain = mesh(STAIR, sides=STEP)
    scene = voxel_scene(domain, TISSUE, np.full(3, 1e-8))
    around = scene_loads(scene, [], [dd.Pressure("surface", 7.0)])
    assert (around.pressure, np.abs(around.force).max()) == (7.0, 0.0)
    two = scene_loads(scene, [], [dd.Pressure("surface", 7.0), dd.Pressure("step", 2.0)])
    assert two.pressure == 0.0
    np.testing.assert_allclose(two.force.sum(axis=0), [0.0, -2.0 * EDGE**2, 0.0], atol=1e-12 * EDGE**2)
    virial = scene.body.position.T @ two.force
    flat = 2.0 * EDGE**3 * np.array([[0, -0.5, 0], [0, -1, 0], [0, -0.5, 0]])
    np.testing.assert_allclose(virial, -7.0 * 3 * EDGE**3 * np.eye(3) + flat, atol=1e-10 * EDGE**3)


def test_a_free_body_under_pressure_and_one_that_would_fly_away(run, is_png, tmp_path, monkeypatch):
    monkeypatch.setattr("tsg_micro.figures.space.choose_renderer", lambda wanted: "matplotlib")  # tubes take seconds
    domain = mesh(cube(2))
    summary = run(domain, [], [dd.Pressure("surface", 20.0)], free=True, force=2e-8, plots=True)
    assert all(is_png(tmp_path / f"{name}.png") for name in ("body", "slices"))
    assert (tmp_path / "structure.vtu").exists()
    assert (summary["free_motions"], summary["pressure_follows"], summary["negative_pivots"]) == (6, True, 0)
    assert summary["unsupported_force"] < 1e-9
    assert np.abs(summary["displacements"]["surface"]).max() < 1e-15
    assert summary["displacements"]["left"][0] == pytest.approx(-summary["displacements"]["right"][0], rel=1e-9)
    assert -0.03 < summary["volume_change"] < summary["enclosed_volume_change"] * 0.5 < 0.0
    with pytest.raises(InputError, match=r"no resultant .* a force of \(1.6e-08, 0, 0\) N"):
        run(domain, [], [dd.Traction("left", (10.0, 0.0, 0.0))], free=True, out=tmp_path / "away")
    with pytest.raises(InputError, match="got 6 of 6; hold more, or declare it free"):
        run(domain, [], [], out=tmp_path / "away")
    assert not (tmp_path / "away").exists()


def test_a_run_that_was_cut_goes_on(run, tmp_path, monkeypatch):
    domain = mesh(STAIR)
    scene = ([dd.Displacement("left")], [dd.Traction("right", (0.0, 3.0, 0.0))])
    whole = run(domain, *scene, out=tmp_path / "whole")
    said: list[str] = []

    def stop(text):
        said.append(text)
        if text.startswith("step 1"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(domain, *scene, say=stop)
    assert (tmp_path / "checkpoint.h5").exists()
    again = run(domain, *scene, say=said.append)
    assert again["resumed_after_step"] == 1
    assert again["energy_history"] == pytest.approx(whole["energy_history"], rel=1e-9)
    np.testing.assert_allclose(again["displacements"]["right"], whole["displacements"]["right"], rtol=1e-7)


@pytest.mark.parametrize(
    ("supports", "loads", "text"),
    [
        ([dd.Displacement("nowhere")], [], "side of the mesh: expected one of"),
        ([dd.Displacement("left", (0.0, 0.0))], [], r"finite numbers in m of shape \(3,\), got \(2,\)"),
        ([dd.Displacement("left", (0.0,), (3,))], [], "expected some of 0, 1, 2"),
        ([dd.Displacement("left", where=lambda x: x[:, 1] < 1e-9)], [], "expected nodes of the lattice where it says"),
        ([], [dd.Traction("left", (0.0, np.inf, 0.0))], "traction on 'left': expected finite numbers in Pa"),
        ([], [dd.BodyForce((0.0, 0.0, 1.0), "core")], "region of the mesh: expected one of"),
    ],
)
def test_bad_scenes(supports, loads, text):
    scene = voxel_scene(mesh(STAIR), TISSUE, np.full(3, 1e-8))
    with pytest.raises(InputError, match=text):
        scene_loads(scene, supports, loads)


def test_bad_arguments(run, tmp_path):
    domain, held = mesh(STAIR), [dd.Displacement("left")]
    with pytest.raises(InputError, match="factors: expected at least one finite number"):
        run(domain, held, [], factors=())
    with pytest.raises(InputError, match=r"bar_force: expected one number a cell \(3\), got shape \(1,\)"):
        body_dns(tmp_path, domain=domain, tissue=TISSUE, bar_force=[1e-8], supports=held, loads=[])
    with pytest.raises(InputError, match="expected cubes of one block's edge"):
        run(dd.voxel_mesh(MPI.COMM_SELF, STAIR, edge=1e-5), held, [])
