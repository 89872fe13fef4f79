"""The parts of a scene: units, supports, loads, tissues, steps; one answer whatever the ranks, and after a cut."""

from __future__ import annotations

import json
import signal
import subprocess
import time
import tomllib
import weakref

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import brentq

import dd_macro as dd
import meshes
from dd_macro.scene.linear import LinearSolver
from meshes.mapped import write_mapped
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_spec import RVESpec
from workflows.runs.scene_steps import Steps
from workflows.runs.solve_scene import solve_scene
from workflows.scenes.quantities import quantity
from workflows.scenes.read import read_scene, scene_of
from workflows.scenes.scene import build

BLOCK = 20e-6
C = dd.isotropic(young=1e3, poisson=0.3).C
LAW = dd.LinearLaw(C, np.zeros(6))
BOX = "[body]\nblocks = [3, 2, 2]\n[tissue.one]\n"
HELD = '[[support]]\nside = "left"\n'
PUSHED = '[[load]]\nside = "surface"\npressure = "3 Pa"\n'
FREE = "[[support]]\nmean = true\n"
PLANES = "".join(f'[[support]]\nside = "{side}"\nfix = "normal"\n' for side in ("left", "bottom", "back"))


def problem(text, folder=None):
    """The problem of a scene, without edges, and the places (nodes, 3) of its nodes in blocks."""
    built = build(MPI.COMM_SELF, scene_of(tomllib.loads(text), **({} if folder is None else {"folder": folder})))
    found = built.problem([None] * len(built.names))
    return found, found.operator.node_coordinates() / BLOCK


def middles(built):
    """Of the cells (cells, 3), m."""
    return built.problem([None] * len(built.names)).operator.cell_corners.mean(axis=1)


def nodal(array, x):
    return array[: x.size].reshape(-1, 3)


@pytest.mark.parametrize(
    ("text", "unit", "number"),
    [
        ("20 um", "m", 2e-5),
        ("20 µm", "m", 2e-5),
        ("0.3 mm", "m", 3e-4),
        ("-7nm", "m", -7e-9),
        ("1e-3 mm", "m", 1e-6),
        ("10 nN", "N", 1e-8),
        ("5 kPa", "Pa", 5e3),
        ("2 nN/um**2", "Pa", 2e3),
        ("2 nN/um^2", "Pa", 2e3),
        ("10 kN/m**3", "N/m^3", 1e4),
        (3, "Pa", 3.0),
        (0.1, "m", 0.1),
    ],
)
def test_units_are_exact(text, unit, number):
    assert quantity(text, unit, "something") == number


@pytest.mark.parametrize(
    "text", ["20", "20 s", "um", "", "m**9**9 1", "2 m**99", "1e999 m", "20 um; 3", "nan m", "2 ** 3 m"]
)
def test_what_is_no_length(text):
    with pytest.raises(ValueError, match='expected a length such as "20 um", or a number in m, got'):
        quantity(text, "m", "a length")


@pytest.mark.parametrize(
    ("support", "where", "axes"),
    [
        ('side = "left"', lambda x: x[:, 0] == 0, (0, 1, 2)),
        ('side = "right"\nfix = ["z", "x"]', lambda x: x[:, 0] == 3, (0, 2)),
        ('side = "front"\nfix = "normal"', lambda x: x[:, 2] == 2, (2,)),
        ('side = "bottom"\nfix = "normal"', lambda x: x[:, 1] == 0, (1,)),
        ('side = "left"\nwithin = {y = [0, "20 um"]}', lambda x: (x[:, 0] == 0) & (x[:, 1] <= 1), (0, 1, 2)),
        (
            'side = "top"\nfix = ["y"]\nwithin = {x = ["20 um", "40 um"], z = ["39 um", 1]}',
            lambda x: (x[:, 1] == 2) & (x[:, 0] >= 1) & (x[:, 0] <= 2) & (x[:, 2] == 2),
            (1,),
        ),
        ('side = ["left", "back"]', lambda x: (x[:, 0] == 0) & (x[:, 2] == 0), (0, 1, 2)),
        ('side = ["right", "top", "front"]', lambda x: (x == (3, 2, 2)).all(axis=1), (0, 1, 2)),
        (
            'side = "surface"\nfix = ["y"]',
            lambda x: (x[:, 0] % 3 == 0) | (x[:, 1:] != 1).any(axis=1),
            (1,),
        ),
    ],
)
def test_supports(support, where, axes):
    found, x = problem(f"{BOX}[[support]]\n{support}\n{FREE}{PUSHED}")
    x = np.rint(x)
    expected = np.zeros_like(x, dtype=bool)
    expected[np.ix_(where(x), axes)] = True
    assert expected.any()
    np.testing.assert_array_equal(nodal(found.fixed, x), expected)
    assert not found.prescribed.any()


def test_the_mean_of_a_free_body_is_held():
    """Six motions without supports, those that are left with some: no net translation or rotation of the solution."""
    for support, motions in (("", 6), ('[[support]]\nside = "left"\nfix = "normal"\n', 3)):
        found, x = problem(f"{BOX}{support}{FREE}{PUSHED}")
        assert len(found.motions) == motions
        u = dd.LawMethod().prepare(found, dd.Material(law=LAW)).solve().mechanical.u[: x.size]
        np.testing.assert_allclose(found.motions @ u, 0.0, atol=1e-9 * np.linalg.norm(u))
        strain = 3.0 * (1 - 2 * 0.3) / 1e3
        away = x * BLOCK - (x * BLOCK).mean(axis=0)
        np.testing.assert_allclose(nodal(u, x)[:, 1:], -strain * away[:, 1:], atol=1e-6 * strain * BLOCK)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ('{y = "2 um"}', (None, 2e-6, None)),
        ('[0, "-1 um", 1e-6]', (0.0, -1e-6, 1e-6)),
        ("{x = 0, z = 5e-7}", (0.0, None, 5e-7)),
    ],
)
def test_a_side_that_is_moved(value, expected):
    found, x = problem(f'{BOX}{HELD}[[load]]\nside = "right"\nwithin = {{z = [0, "20 um"]}}\ndisplacement = {value}\n')
    there = (np.rint(x[:, 0]) == 3) & (x[:, 2] < 1.5)
    for axis, number in enumerate(expected):
        assert (nodal(found.fixed, x)[there, axis] == (number is not None)).all()
        np.testing.assert_allclose(nodal(found.prescribed, x)[there, axis], number or 0.0, rtol=1e-15)
    assert not nodal(found.fixed, x)[~there & (x[:, 0] > 0.5)].any()


@pytest.mark.parametrize(
    ("load", "force", "about"),
    [
        ('side = "right"\ntraction = ["15 Pa", -3, "1 nN/um**2"]', np.array([15.0, -3.0, 1e3]) * 4, None),
        ('side = "right"\npressure = "5 Pa"', np.array([-5.0, 0.0, 0.0]) * 4, None),
        ('side = "top"\npressure = -2', np.array([0.0, 2.0, 0.0]) * 6, None),
        # 1 Pa to 5 Pa over the height: 3 Pa in the mean, and a moment about the middle of 4 Pa h^3 / 12 over the width
        (
            'side = "right"\ntraction = {along = "y", at = [0, "40 um"], value = [[1, 0, 0], [5, 0, 0]]}',
            np.array([3.0, 0.0, 0.0]) * 4,
            -4.0 * 2**2 / 12 * 2,
        ),
        # no more than the last value beyond the last place
        (
            'side = "right"\ntraction = {along = "y", at = ["-2 um", "-1 um"], value = [[9, 9, 9], [0, 7, 0]]}',
            np.array([0.0, 7.0, 0.0]) * 4,
            None,
        ),
        ('body_force = [0, 0, "-10 kN/m**3"]', np.array([0.0, 0.0, -1e4]) * 12 * BLOCK, None),
    ],
)
def test_loads(load, force, about):
    found, x = problem(f"{BOX}{HELD}[[load]]\n{load}\n")
    forces = nodal(found.forces, x)
    np.testing.assert_allclose(forces.sum(axis=0), force * BLOCK**2, atol=1e-12 * np.abs(force).max() * BLOCK**2)
    if about is not None:
        moment = np.cross(x - (0, 1, 1), forces).sum(axis=0)
        np.testing.assert_allclose(moment, [0.0, 0.0, about * BLOCK**2], atol=1e-9 * abs(about) * BLOCK**2)


def test_a_body_force_in_a_region_and_the_tissues_of_its_cells(tmp_path):
    meshes.box_with_inclusion(
        tmp_path / "a.msh", elements=(4, 4, 4), size=(0.08, 0.08, 0.08), radius=0.021, centre=(0.03, 0.03, 0.03)
    )
    body = (
        '[body]\nmesh = "a.msh"\nunit = "mm"\n[tissue.soft]\n[tissue.stiff]\nregion = "inclusion"\nbar_force = 2e-8\n'
    )
    text = f'{body}{HELD}[[load]]\nbody_force = [0, 2e4, 0]\nregion = "inclusion"\n'
    found, x = problem(text, tmp_path)
    forces = nodal(found.forces, x)
    inside = 7 * BLOCK**3  # the cell whose centre is the sphere's, and its six neighbours
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 2e4 * inside, 0.0], atol=1e-12 * 2e4 * inside)
    np.testing.assert_allclose((x * forces[:, 1:2]).sum(axis=0) / forces[:, 1].sum(), 1.5, rtol=1e-9)
    built = build(MPI.COMM_SELF, scene_of(tomllib.loads(text), folder=tmp_path))
    middle = found.operator.cell_corners.mean(axis=1)
    near = np.linalg.norm(middle - 1.5 * BLOCK, axis=1) < 1.01 * BLOCK
    np.testing.assert_array_equal(built.cell_tissue == built.names.index("stiff"), near)
    np.testing.assert_array_equal(built.bar_force, np.where(near, 2e-8, Tissue().bar_force))


@pytest.mark.parametrize(
    ("body", "extent", "cells"),
    [
        ("blocks = [3, 2, 1]", (60, 40, 20), 6),
        ('box = ["60 um", "40 um", "20 um"]\nrefine = 2', (60, 40, 20), 48),
        ('box = ["55 um", "0.03 mm", 24e-6]', (55, 30, 24), 6),
        ('sheet = ["90 um", "40 um"]', (90, 40, 20), 8),
        ("spheroid = 2", (80, 80, 80), 32),
    ],
)
def test_bodies(body, extent, cells):
    """Their size, to the length or the block; a pressure on all of the surface has no resultant, on a side p A."""
    text = f"[body]\n{body}\n[tissue.one]\n{FREE}"
    found, x = problem(f"{text}{PUSHED}")
    assert found.operator.domain.global_cells == cells
    np.testing.assert_allclose(np.ptp(x, axis=0) * 20.0, extent, rtol=1e-12)
    assert np.abs(found.forces).max() > 0
    np.testing.assert_allclose(nodal(found.forces, x).sum(axis=0), 0.0, atol=1e-12 * np.abs(found.forces).max())
    one, x = problem(text.replace(FREE, HELD) + PUSHED.replace("surface", "front"))
    area = {"spheroid = 2": 4 * 400}.get(body, extent[0] * extent[1])
    np.testing.assert_allclose(nodal(one.forces, x).sum(axis=0)[2], -3e-12 * area, rtol=1e-9)


@pytest.mark.parametrize(
    ("body", "more", "elements"),
    [
        ("blocks = [6, 3, 1]", "", 8 * 6),  # held at the left: its corners are at bottom and top
        ("blocks = [6, 3, 1]\ngraded = false", "", 6 * 3),
        ("blocks = [6, 3, 1]\nrefine = 2", "", 16 * 12 * 2),
        ('sheet = ["115 um", "63 um"]', "", 8 * 6),
        ("blocks = [6, 3, 1]", '[solve]\nelement = "trilinear"\n', 6 * 3),
        ("blocks = [6, 3, 1]", "[solve]\ndegree = 2\n", 6 * 3),
        ("blocks = [6, 3, 2]", "", 6 * 3 * 2),
        ("blocks = [6, 3, 2]\ngraded = true", "", 8 * 6 * 4),
        ("blocks = [6, 5, 1]", '[[support]]\nside = "bottom"\nfix = "normal"\n', 8 * 7),
        ("blocks = [6, 5, 1]", '[[load]]\nside = "right"\ndisplacement = ["1 um", 0, 0]\n', 10 * 9),
    ],
)
def test_outer_blocks_of_a_sheet_are_halved_where_it_is_held(body, more, elements):
    """And where sides without support meet a clamp; a block's elements are of its own bar force."""
    text = f'[body]\n{body}\n[tissue.one]\nbar_force = {{profile = "linear", f_max = 1e-8}}\n{HELD}{PUSHED}{more}'
    built = build(MPI.COMM_SELF, scene_of(tomllib.loads(text)))
    assert built.domain.global_cells == elements
    edge = np.ptp(built.domain.mesh.geometry.x, axis=0) / [6, 5 if "5, 1" in body else 3, 2 if ", 2]" in body else 1]
    _, block = np.unique(np.floor(middles(built) / edge), axis=0, return_inverse=True)
    for k in np.unique(block):
        np.testing.assert_allclose(built.bar_force[block == k], built.bar_force[block == k][0], rtol=1e-12)


@pytest.mark.parametrize("element", ["enhanced", "trilinear"])
def test_patch(tmp_path, element):
    """A traction between planes of symmetry: one stress, in elements of any shape; the strain is Hooke's."""

    def bulge(x):
        inside = np.prod(np.sin(np.pi * x / [6e-5, 4e-5, 4e-5]), axis=1)
        return x + 4e-6 * inside[:, None] * [1.0, -0.7, 0.5]

    write_mapped(tmp_path / "a.msh", (3, 2, 2), (6e-5, 4e-5, 4e-5), bulge)
    load = '[[load]]\nside = "right"\ntraction = [10, 0, 0]\n'
    text = f'[body]\nmesh = "a.msh"\n[tissue.one]\n{PLANES}{load}[solve]\nelement = "{element}"\n'
    found, x = problem(text, tmp_path)
    z = dd.LawMethod().prepare(found, dd.Material(law=LAW)).solve().mechanical
    np.testing.assert_allclose(z.stress, np.broadcast_to([10.0, 0, 0, 0, 0, 0], z.stress.shape), atol=1e-8)
    np.testing.assert_allclose(nodal(z.u, x), x * BLOCK * [0.01, -0.003, -0.003], atol=1e-8 * BLOCK)


def test_a_profile_of_the_bar_force():
    """f_max exp(-decay r / R) at the middle of every block; a finer mesh has the block's."""
    given = 'bar_force = {profile = "exponential", f_max = "50 nN", decay = 2, centre = [0, 0, 0], radius = "40 um"}\n'
    coarse = build(MPI.COMM_SELF, scene_of(tomllib.loads(f"{BOX}{given}{HELD}{PUSHED}")))
    middle = middles(coarse)
    expected = 5e-8 * np.exp(-2.0 * np.linalg.norm(middle, axis=1) / 4e-5)
    np.testing.assert_allclose(coarse.bar_force, expected, rtol=1e-12)
    text = f"{BOX}{given}{HELD}{PUSHED}".replace("[tissue", "refine = 2\n[tissue", 1)
    fine = build(MPI.COMM_SELF, scene_of(tomllib.loads(text)))
    np.testing.assert_allclose(np.sort(fine.bar_force), np.sort(np.repeat(coarse.bar_force, 8)), rtol=1e-12)


def test_bar_forces_of_a_file(tmp_path):
    (tmp_path / "f.csv").write_text("x,y,z,bar_force\n1e-5,1e-5,1e-5,3e-8\n5e-5,1e-5,1e-5,7e-9\n")
    text = f'{BOX}bar_force = {{file = "f.csv"}}\n{HELD}{PUSHED}'
    built = build(MPI.COMM_SELF, scene_of(tomllib.loads(text), folder=tmp_path))
    x = middles(built)[:, 0]
    outer = np.abs(x - 3e-5) > 1e-6  # the middle ones are as near to one row as to the other
    np.testing.assert_array_equal(built.bar_force[outer], np.where(x < 3e-5, 3e-8, 7e-9)[outer])


def test_the_jump_is_where_the_region_ends(tmp_path):
    """Blocks in series, held across: strain is uniform in each tissue, and their stress is one. Both from RVEs."""
    meshes.flat_sheet(
        tmp_path / "a.msh",
        elements=(4, 2, 2),
        size=(4 * BLOCK, 2 * BLOCK, 2 * BLOCK),
        region=lambda x: np.where(x[:, 0] < 3 * BLOCK, "a", "b"),
    )
    tissues = "".join(
        f'[tissue.{name}]\nregion = "{name}"\nbar_force = "{force} nN"\nkind = "bulk"\n'
        for name, force in (("a", 5), ("b", 20))
    )
    walls = "".join(
        f'[[support]]\nside = "{side}"\nfix = "normal"\n' for side in ("left", "bottom", "top", "back", "front")
    )
    load = '[[load]]\nside = "right"\ndisplacement = {x = "1.6 um"}\n'
    (tmp_path / "a.toml").write_text(f'[body]\nmesh = "a.msh"\n{tissues}{walls}{load}[solve]\nmethod = "adaptive"\n')
    solve_scene(tmp_path / "out", read_scene(tmp_path / "a.toml"), plots=False)
    fields = dd.read_quadrature(tmp_path / "out" / "quadrature.h5")
    soft, stiff = (RVESpec.of_kind("bulk", Tissue(bar_force=force)).build() for force in (5e-9, 2e-8))

    def stress(rve, strain):
        return rve.solve_strain([strain, 0, 0, 0, 0, 0]).first_piola[0, 0]

    a = brentq(lambda e: stress(soft, e) - stress(stiff, 0.08 - 3 * e), 0.02, 0.0266, xtol=1e-9)
    in_a = fields.midpoint[:, 0] < 3 * BLOCK
    strain = fields.mechanical_strain[..., 0]
    assert 0.08 - 3 * a < 0.9 * a
    np.testing.assert_allclose(strain[in_a], a, rtol=5e-3)
    np.testing.assert_allclose(strain[~in_a], 0.08 - 3 * a, rtol=5e-3)
    np.testing.assert_allclose(fields.mechanical_stress[..., 0], stress(soft, a), rtol=5e-3)


STEPS = """
[body]
blocks = [2, 1, 1]
[tissue.one]
bar_force = "10 nN"
kind = "bulk"
[[support]]
side = "left"
[[load]]
side = "right"
displacement = ["0.4 um", 0, 0]
[solve]
method = "adaptive"
steps = 3
"""


def scene(text=STEPS, **solve):
    values = tomllib.loads(text)
    values["solve"] |= solve
    return scene_of(values)


def answer(summary):
    return np.concatenate([np.ravel(list(summary[name].values())) for name in ("reactions", "displacements")])


@pytest.fixture
def one_solver_at_a_time(monkeypatch):
    """No step begins while the factorisation of the one before is held."""
    before: list[weakref.ref[LinearSolver]] = []
    solved = Steps._solved

    def noted(self, *given):
        assert all(linear() is None for linear in before)
        found = solved(self, *given)
        assert found.linear is not None
        before.append(weakref.ref(found.linear))
        return found

    monkeypatch.setattr(Steps, "_solved", noted)


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_steps_end_where_one_does(tmp_path, kinematics, one_solver_at_a_time):
    one, many = (
        solve_scene(tmp_path / str(steps), scene(method="FE2", kinematics=kinematics, steps=steps), plots=False)
        for steps in (1, [0.3, 1.4, 1.0])
    )
    np.testing.assert_allclose(answer(many), answer(one), rtol=1e-6, atol=1e-7 * np.abs(answer(one)).max())
    assert many["factor_steps"] == [0.3, 1.4, 1.0]
    pulls = [step["right"][0] for step in many["reactions_steps"]]
    assert pulls[0] < pulls[2] < pulls[1]
    series = json.loads((tmp_path / "[0.3, 1.4, 1.0]" / "fields.vtkhdf.series").read_text())
    assert [(file["name"], file["time"]) for file in series["files"]] == [
        ("step-1.vtkhdf", 0.3),
        ("step-2.vtkhdf", 1.4),
        ("step-3.vtkhdf", 1.0),
    ]
    assert all((tmp_path / "[0.3, 1.4, 1.0]" / file["name"]).stat().st_size > 1000 for file in series["files"])


@pytest.mark.parametrize("method", ["adaptive", "FE2"])
def test_a_run_that_was_cut_goes_on(tmp_path, method):
    """Ended by whoever listens while step 3 is told: step 2 stands, and the end is the same to round-off."""
    given = scene(method=method, kinematics="finite")
    whole = solve_scene(tmp_path / "whole", given, plots=False)

    def listen(text):
        if text.startswith("step 3 of 3"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve_scene(tmp_path / "cut", given, plots=False, say=listen)
    assert not (tmp_path / "cut" / "summary.json").exists()
    said: list[str] = []
    found = solve_scene(tmp_path / "cut", given, plots=False, say=said.append)
    assert "going on after step 2 of 3" in said
    assert found["resumed_after_step"] == 2
    np.testing.assert_allclose(answer(found), answer(whole), rtol=1e-9, atol=1e-9 * np.abs(answer(whole)).max())
    assert found["factor_steps"] == whole["factor_steps"]
    assert not list((tmp_path / "cut").glob("checkpoint*"))


def test_a_cut_run_of_another_scene_begins_anew(tmp_path):
    def listen(text):
        if text.startswith("step 3 of 3"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve_scene(tmp_path / "out", scene(), plots=False, say=listen)
    said: list[str] = []
    found = solve_scene(tmp_path / "out", scene(STEPS.replace("10 nN", "9 nN")), plots=False, say=said.append)
    assert found["resumed_after_step"] == 0
    assert any("other parameters" in text for text in said)


def test_a_run_that_is_killed_goes_on(program, tsgdd, tmp_path, read_summary):
    file, out = tmp_path / "scene.toml", tmp_path / "out"
    file.write_text(STEPS.replace("steps = 3", "steps = 12"))
    command = ["solve", file, "--method", "FE2", "--no-plots", "--out", out]
    with subprocess.Popen([program, *map(str, command)], stdout=subprocess.DEVNULL) as started:
        while not (out / "checkpoint.json").exists() and started.poll() is None:
            time.sleep(0.01)
        started.kill()
    assert started.returncode == -signal.SIGKILL
    done = len(json.loads((out / "checkpoint.json").read_text())["rows"])
    assert tsgdd(*command).code == 0
    found = read_summary(out)
    assert 1 <= found["resumed_after_step"] == done < 12
    whole = solve_scene(tmp_path / "whole", scene(method="FE2", steps=1), plots=False)
    np.testing.assert_allclose(answer(found), answer(whole), rtol=1e-6, atol=1e-7 * np.abs(answer(whole)).max())


def test_1_2_and_3_ranks(mpirun, program, tsgdd, tmp_path, read_summary):
    """A bar force that varies, a pressure that follows, free in space, in finite strain; y and z are alike."""
    text = """
    [body]
    blocks = [3, 1, 1]
    [tissue.one]
    bar_force = {profile = "exponential", f_max = "50 nN", decay = 2}
    kind = "bulk"
    [[support]]
    mean = true
    [[load]]
    side = "surface"
    pressure = "40 Pa"
    [solve]
    method = "adaptive"
    kinematics = "finite"
    """
    (tmp_path / "scene.toml").write_text(text)
    found = []
    for ranks in (1, 2, 3):
        out = tmp_path / str(ranks)
        arguments = ("solve", tmp_path / "scene.toml", "--no-plots", "--out", out)
        if ranks == 1:
            assert tsgdd(*arguments).code == 0
        else:
            done = mpirun(ranks, program, *arguments)
            assert done.returncode == 0, done.stderr
        found.append((read_summary(out), dd.read_quadrature(out / "quadrature.h5")))
    summary, fields = found[0]
    size = np.abs(fields.mechanical_stress).max()
    assert size > 10.0
    for ranks, (other, read) in zip((2, 3), found[1:], strict=True):
        assert other["ranks"] == ranks
        assert other["volume_change"] == pytest.approx(summary["volume_change"], rel=1e-8)
        np.testing.assert_allclose(read.coordinates, fields.coordinates, atol=1e-12)
        np.testing.assert_allclose(read.mechanical_stress, fields.mechanical_stress, atol=1e-8 * size, rtol=0)


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_a_body_that_is_unloaded_is_at_rest(tmp_path, kinematics):
    """Loaded and unloaded, between planes of symmetry: the last step leaves nothing but round-off."""
    planes = [{"side": side, "fix": "normal"} for side in ("left", "bottom", "back")]
    model = scene_of(
        {
            "body": {"blocks": [2, 2, 2]},
            "tissue": {"one": {"bar_force": 1e-8}},
            "support": planes,
            "load": [{"side": "right", "pressure": 20.0}],
            "solve": {"kinematics": kinematics, "steps": [1.0, 0.5, 0.0]},
        }
    )
    found = solve_scene(tmp_path / "out", model, plots=False)
    whole, half, none = found["volume_change_steps"]
    assert whole < half < -1e-3
    assert abs(none) < 1e-9
