"""Bad scenes: each is one line that names file and key, what was expected and what came; exit 2, before any work."""

from __future__ import annotations

import shutil
from typing import NamedTuple

import numpy as np
import pytest

import meshes
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset_file import write_dataset

SCENE = """
[body]
blocks = [2, 1, 1]
[tissue.one]
bar_force = "10 nN"
[[support]]
side = "left"
[[load]]
side = "right"
traction = ["15 Pa", 0, 0]
[solve]
method = "adaptive"
"""
BODY, FORCE, HELD, AT = "blocks = [2, 1, 1]", 'bar_force = "10 nN"', 'side = "left"', 'side = "right"'
PULL, METHOD = 'traction = ["15 Pa", 0, 0]', 'method = "adaptive"'
TWO = 'mesh = "two.msh"'


class Bad(NamedTuple):
    """What of the scene is replaced by what, and what the line must say."""

    old: str
    new: str
    said: str


KEYS = [
    Bad(BODY, f"{BODY}\ncolour = 1", "body.colour: expected no such key, got one"),
    Bad(HELD, f'{HELD}\nfixed = ["x"]', "support.0.fixed: expected no such key"),
    Bad(PULL, f"{PULL}\ntractoin = [1, 0, 0]", "load.0.tractoin: expected no such key"),
    Bad(FORCE, f"{FORCE}\ncell = {{colour = 1}}", "tissue.one.cell.colour: expected no such key"),
    Bad(
        FORCE,
        'bar_force = {profile = "linear", f_max = 1e-8, slope = 2}',
        "tissue.one.bar_force.slope: expected no such key",
    ),
    Bad("[solve]", "[sove]", "sove: expected no such key"),
    Bad("[body]\n" + BODY, "", "body: expected a value, got none"),
    Bad(BODY, "", "body: expected one of mesh, blocks, box, sheet, spheroid, got none"),
    Bad(
        BODY, f'{BODY}\nmesh = "two.msh"', "body: expected one of mesh, blocks, box, sheet, spheroid, got mesh, blocks"
    ),
    Bad("[tissue.one]\n" + FORCE, "", "tissue: expected a value, got none"),
    Bad("[tissue.one]\n" + FORCE, "[tissue]", "tissue: expected at least 1 of them, got {}"),
    Bad(f"[[load]]\n{AT}\n{PULL}\n", "", "load: expected a value, got none"),
]
UNITS = [
    Bad(
        FORCE,
        'bar_force = "10 um"',
        'tissue.one.bar_force: expected a force such as "10 nN", or a number in N, got \'10',
    ),
    Bad(FORCE, "bar_force = nan", "tissue.one.bar_force: expected a force such as"),
    Bad(PULL, 'traction = ["15 N", 0, 0]', 'load.0.traction.0: expected a stress such as "5 kPa", or a number in Pa'),
    Bad(PULL, 'traction = ["9**9**9 Pa", 0, 0]', "load.0.traction.0: expected a stress"),
    Bad(PULL, 'displacement = {x = "1 s"}', 'load.0.displacement.x: expected a length such as "20 um"'),
    Bad(PULL, "pressure = inf", "load.0.pressure: expected a stress"),
    Bad(FORCE, f'{FORCE}\ncell = {{height = "10 Pa"}}', "tissue.one.cell.height: expected a length"),
    Bad(BODY, 'box = ["20 um", "20 kPa", 1e-5]', "body.box.1: expected a length"),
    Bad(METHOD, f"{METHOD}\nsteps = [0.5, nan]", "solve.steps.1: expected a number, got nan"),
    Bad(BODY, f'{TWO}\nunit = "inch"', "body.unit: expected 'm', 'mm', 'um' or 'nm', got 'inch'"),
    Bad(BODY, f'{TWO}\nunit = "um"', "got 4e-11 m, its coordinates taken in um"),
]
TYPES = [
    Bad(BODY, 'blocks = "two"', "body.blocks: expected a list, got 'two'"),
    Bad(BODY, "blocks = [2.5, 1, 1]", "body.blocks.0: expected a whole number, got 2.5"),
    Bad(BODY, 'blocks = ["2", 1, 1]', "body.blocks.0: expected a whole number, got '2'"),
    Bad(BODY, "blocks = [0, 1, 1]", "body.blocks.0: expected greater than or equal to 1, got 0"),
    Bad(BODY, "spheroid = -2", "body.spheroid: expected greater than 0, got -2"),
    Bad(BODY, "spheroid = 0.1", "body.spheroid: radius: expected at least 0.866 blocks, got 0.1"),
    Bad(PULL, "traction = [1, 0]", "load.0.traction.2: expected a value, got none"),
    Bad(PULL, "traction = true", "load.0.traction: expected a list or a table, got True"),
    Bad(
        PULL,
        'traction = {along = "x", at = [1, 0], value = [[0, 0, 0], [0, 0, 0]]}',
        "load.0.traction: expected at least two rising places in at",
    ),
    Bad(HELD, f'{HELD}\nfix = "all"', "support.0.fix: expected a list or 'normal', got 'all'"),
    Bad(HELD, f'{HELD}\nfix = ["w"]', "support.0.fix.0: expected 'x', 'y' or 'z', got 'w'"),
    Bad(HELD, f'{HELD}\nwithin = {{y = ["20 um", 0]}}', "support.0.within.y: expected the least coordinate and the"),
    Bad(HELD, 'mean = "yes"', "support.0.mean: expected true or false, got 'yes'"),
    Bad(HELD, f"{HELD}\nmean = true", "support.0: expected side, or mean = true, got both"),
    Bad(METHOD, f"{METHOD}\nsteps = []", "solve.steps: expected a whole number or at least 1 of them, got []"),
    Bad(METHOD, f"{METHOD}\nsteps = [0.0, 0]", "solve.steps: expected a part of the load that is not zero, got none"),
    Bad(METHOD, f'{METHOD}\nsteps = "three"', "solve.steps: expected a whole number or a list, got 'three'"),
    Bad("[tissue.one]\n" + FORCE, "[tissue]\none = 3", "tissue.one: expected a table, got 3"),
    Bad("[body]\n" + BODY, "body = [[1, {a = [2]}]]", "body: expected a table, got [[1, {'a': [2]}]]"),
    Bad(PULL, "traction = {along = {along = 1}}", "load.0.traction.along: expected 'x', 'y' or 'z', got {'along': 1}"),
]
PLACES = [
    Bad(HELD, 'side = "west"', "support.0.side: side of the mesh: expected one of back, bottom, front, left, right"),
    Bad(AT, 'side = "tip"', "load.0.side: side of the mesh: expected one of back"),
    Bad(HELD, 'side = ["left", "right"]', "expected nodes on all of left, right, got none"),
    Bad(HELD, 'side = "surface"\nfix = "normal"', "support.0.fix: expected a flat side normal to x, y or z"),
    Bad(HELD, f'{HELD}\nwithin = {{y = ["1 m", "2 m"]}}', "displacement on 'left': expected nodes in the part of it"),
    Bad(AT, 'side = ["right", "top"]', "load.0: expected one side of a traction or pressure, got several"),
    Bad(PULL, "", "load.0: expected one of displacement, traction, pressure, body_force, got none"),
    Bad(
        PULL, f"{PULL}\npressure = 3", "load.0: expected one of displacement, traction, pressure, body_force, got trac"
    ),
    Bad(
        f"{AT}\n{PULL}", 'body_force = [0, 0, 1]\nregion = "core"', "load.0.region: region of the mesh: expected one of"
    ),
    Bad(FORCE, f'{FORCE}\nregion = "core"', "tissue.one.region: region of the mesh: expected one of none"),
    Bad(
        HELD,
        "mean = true",
        "loads: expected some in balance on a body that is free in space, got a resultant of (6e-09",
    ),
    Bad(f"[[support]]\n{HELD}", "", "loads: expected some in balance on a body that is free in space"),
    Bad(HELD, f'{HELD}\nfix = ["x"]', "boundary conditions: expected no rigid-body motion left free, got 3 of 6"),
]
TISSUES = [
    Bad(FORCE, "bar_force = -1e-8", "tissue.one: bar_force: expected positive forces in N"),
    Bad(FORCE, 'bar_force = {profile = "linear", f_max = -1}', "tissue.one: bar_force: expected positive forces"),
    Bad(FORCE, 'bar_force = {f_max = "5 nN"}', "tissue.one.bar_force: expected one of profile, file, got none"),
    Bad(FORCE, 'bar_force = {file = "none.csv"}', "none.csv: no such file"),
    Bad(
        FORCE,
        f"{FORCE}\ncell = {{half_diagonal = 2}}",
        "tissue.one: half_diagonal r: expected a number in (0, 1), got 2",
    ),
    Bad(FORCE, f'{FORCE}\nfile = "none.toml"', "tissue.one: tissue "),
    Bad(FORCE, f'{FORCE}\ndata = "none.h5"', "none.h5: no such file"),
    Bad(FORCE, f"{FORCE}\n[tissue.two]\n{FORCE}", "tissue: expected a region for all tissues but one, got none of one"),
    Bad(
        f"{BODY}\n[tissue.one]\n{FORCE}",
        f'{TWO}\n[tissue.one]\nregion = "a"\n[tissue.two]\nregion = "a"',
        "tissue: expected regions that do not overlap, got 1 cells in two",
    ),
    Bad(
        f"{BODY}\n[tissue.one]",
        f'{TWO}\n[tissue.one]\nregion = "a"',
        "tissue: expected one for every cell, got none for 1",
    ),
    Bad(
        f"{BODY}\n[tissue.one]\n{FORCE}",
        f'{TWO}\n[tissue.one]\nregion = "a"\n[tissue.two]\nregion = "b"\n[tissue.three]',
        "tissue.three: expected some cells of it, got none",
    ),
    Bad(
        f"{BODY}\n[tissue.one]\n{FORCE}",
        f'{TWO}\n[tissue.one]\nregion = "a"\n[tissue.two]\ncell = {{height = "8 um"}}\n[s]',
        "s: expected no such key, got one",
    ),
    Bad(f"{METHOD}", 'method = "tangents"', "tissue.one: data: expected a file for method 'tangents', got none"),
    Bad(
        f"{FORCE}",
        'bar_force = "5 nN"\ndata = "ten.h5"\nkind = "bulk"',
        "tissue.one: bar_force: expected that of the data, 1e-08 N, got 5e-09",
    ),
    Bad(f"{FORCE}", f'{FORCE}\ndata = "ten.h5"\nkind = "sheet"', "kind: expected that of the data, bulk, got sheet"),
]
OTHERS = [
    Bad(METHOD, 'method = "magic"', "solve.method: expected one of points; tangents; "),
    Bad(
        METHOD, 'method = "FE2"\nbudget = 5', "solve.budget, tolerance: expected with method adaptive alone, got 'FE2'"
    ),
    Bad(METHOD, f'{METHOD}\nmetric = "euclid"', "solve.metric: expected one of auto, tangent"),
    Bad(METHOD, f"{METHOD}\ndegree = 3", "solve.degree: expected 1 or 2, got 3"),
    Bad(
        METHOD, f'{METHOD}\ndegree = 2\nelement = "enhanced"', "solve.element: expected none of degree 2, got enhanced"
    ),
    Bad(METHOD, f"{METHOD}\ntolerance = 2", "solve.tolerance: expected less than 1, got 2"),
    Bad(BODY, 'mesh = "none.msh"', "none.msh: no such file"),
    Bad(BODY, 'mesh = "scene.toml"', "scene.toml: expected a mesh of gmsh"),
    Bad(BODY, f"{TWO}\nrefine = 2", "body: expected refine of bodies made of blocks, got 2 of a mesh"),
    Bad(BODY, "spheroid = 2\ngraded = true", "body: expected graded beside blocks, box or sheet, got another body"),
    Bad(BODY, "blocks = [2, 2, 1]\ngraded = 2", "body.graded: expected"),
    Bad(BODY, "blocks = [100000, 100000, 100000]", "body.blocks: 1000000000000000 elements need about"),
    Bad(BODY, 'sheet = ["1 nm", "20 um"]', "body: expected lengths between half a block, 1e-05 m"),
    Bad(SCENE, "not = = toml", "expected a TOML file, got another: Invalid value (at line 1, column 7)"),
    Bad(SCENE, "a = " + "[" * 5000, "expected a TOML file, got another"),
    Bad(SCENE, "#" * 1_000_001, "expected a TOML file of at most 1000000 bytes, got more"),
    Bad(SCENE, "", "body: expected a value, got none"),
]
ALL = [*KEYS, *UNITS, *TYPES, *PLACES, *TISSUES, *OTHERS]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A mesh of two blocks, regions a and b, and data of another tissue."""
    folder = tmp_path_factory.mktemp("bad")
    size = (4e-5, 2e-5, 2e-5)
    meshes.flat_sheet(
        folder / "two.msh", elements=(2, 1, 1), size=size, region=lambda x: np.where(x[:, 0] < 2e-5, "a", "b")
    )
    zero = np.zeros((1, 6))
    data = RVESource(RVESpec.of_kind("bulk", Tissue(bar_force=1e-8))).states(zero, zero)
    assert data is not None
    write_dataset(folder / "ten.h5", data)
    return folder


@pytest.fixture
def folder(files, tmp_path):
    for path in files.iterdir():
        shutil.copy(path, tmp_path)
    return tmp_path


def check(done, scene, said, out):
    assert done.code == 2, done
    assert done.err.startswith(f"tsgdd: {scene}: "), done.err
    assert done.err.count("\n") == 1
    assert said in done.err
    assert not out.exists()


def test_the_scene_itself_is_good(tsgdd, folder):
    (folder / "scene.toml").write_text(SCENE)
    done = tsgdd("solve", folder / "scene.toml", "--no-plots", "--out", folder / "out")
    assert done.code == 0, done.err


@pytest.mark.parametrize("bad", ALL, ids=[f"{number}-{bad.said[:40]}" for number, bad in enumerate(ALL)])
def test_one_line_before_any_work(tsgdd, folder, bad):
    assert bad.old in SCENE
    scene = folder / "scene.toml"
    scene.write_text(SCENE.replace(bad.old, bad.new, 1))
    check(tsgdd("solve", scene, "--out", folder / "out"), scene, bad.said, folder / "out")


def test_no_text_and_no_file(tsgdd, folder):
    scene = folder / "scene.toml"
    for content, said in ((b"\xff\xfe\x00", "expected a TOML file, got another"), (b"\x00", "expected a TOML file")):
        scene.write_bytes(content)
        check(tsgdd("solve", scene, "--out", folder / "out"), scene, said, folder / "out")
    none = folder / "none.toml"
    check(tsgdd("solve", none, "--out", folder / "out"), none, "got none that can be read (No such", folder / "out")
    check(tsgdd("fe2", folder, "--out", folder / "out"), folder, "got none that can be read (Is a", folder / "out")


@pytest.mark.parametrize(
    ("command", "options", "said"),
    [
        ("solve", ("--elements", 3, 3, 1), "elements: expected in the scene file"),
        ("solve", ("--bar-force", 1e-8), "bar_force: expected in the scene file"),
        ("solve", ("--adapt", "--rve-budget", 3), "adapt, rve_budget: expected in the scene file"),
        ("solve", ("--data", "ten.h5"), "data: expected in the scene file"),
        ("fe2", ("--steps", 3), "steps: expected in the scene file"),
        ("dns", ("--blocks", 3, 3), "blocks: expected in the scene file"),
        ("sample", ("--kind", "bulk"), "kind: expected in the scene file"),
        ("sample", ("--blocks", 2, 2, 2), "blocks: expected in the scene file"),
        ("sample", ("--images", "duplicated"), "images: expected in the scene file"),
        ("sample", ("--stress-measure", "cauchy"), "stress_measure: expected in the scene file"),
    ],
)
def test_options_beside_a_file(tsgdd, folder, command, options, said):
    (folder / "scene.toml").write_text(SCENE)
    done = tsgdd(command, folder / "scene.toml", *options, "--out", folder / "out")
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert said in done.err
    assert done.err.endswith("scene.toml, got it as an option\n")
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("command", "bad"),
    [
        (
            "sample",
            Bad(f"{FORCE}\n", f"{FORCE}\n[tissue.two]\n{FORCE}\n", "tissue: expected a region for all tissues but one"),
        ),
        ("dns", Bad(HELD, 'side = "west"', "support.0.side")),
        ("dns", Bad(BODY, 'mesh = "bent.msh"', "expected")),
        (
            "dns",
            Bad(
                f"{BODY}\n[tissue.one]\n{FORCE}",
                f'{TWO}\n[tissue.one]\nregion = "a"\n[tissue.two]\ncell = {{E_tendon = "1 MPa"}}',
                "tissue.two: expected the cells of tissue.one in dns, got others",
            ),
        ),
        ("fe2", Bad(HELD, f'{HELD}\nfix = ["x"]', "boundary conditions: expected no rigid-body motion")),
    ],
    ids=lambda value: value if isinstance(value, str) else value.said[:30],
)
def test_the_other_commands(tsgdd, folder, command, bad):
    meshes.curved_sheet(folder / "bent.msh", elements=(2, 1, 1), size=(4e-5, 2e-5, 2e-5), radius=1e-4)
    scene = folder / "scene.toml"
    assert bad.old in SCENE
    scene.write_text(SCENE.replace(bad.old, bad.new, 1))
    check(tsgdd(command, scene, "--out", folder / "out"), scene, bad.said, folder / "out")


def test_a_tissue_that_is_not_there_has_no_data(tsgdd, folder):
    scene = folder / "scene.toml"
    scene.write_text(SCENE)
    done = tsgdd("sample", scene, "--tissue-name", "three", "--out", folder / "out.h5")
    check(done, scene, "tissue_name: expected one of one, got 'three'", folder / "out.h5")


@pytest.mark.parametrize(
    "bad",
    [
        Bad(FORCE, f"{FORCE}\ncolour = 1", "tissue.one.colour: expected no such key"),
        Bad(BODY, 'mesh = "none.msh"', "none.msh: no such file"),
        Bad(FORCE, 'bar_force = {file = "none.csv"}', "none.csv: no such file"),
        Bad(HELD, f'{HELD}\nwithin = {{y = ["1 m", "2 m"]}}', "expected nodes in the part of it, got none"),
        Bad(HELD, "mean = true", "loads: expected some in balance"),
    ],
    ids=lambda bad: bad.said[:30],
)
def test_no_rank_is_left(launch, folder, bad):
    scene = folder / "scene.toml"
    scene.write_text(SCENE.replace(bad.old, bad.new, 1))
    check(launch("solve", scene, "--out", folder / "out", ranks=2), scene, bad.said, folder / "out")
