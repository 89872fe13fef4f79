"""Bad input, failed runs and start-up: one clear line, the right exit code, and no rank left hanging."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest

HEAVY = {"numpy", "scipy", "h5py", "matplotlib", "meshio", "mpi4py", "petsc4py", "dolfinx", "dolfinx_solver", "gmsh"}


def check(done, code, *texts, alone=True):
    """One line on stderr with the texts, nothing of Python's inside, and the exit code."""
    lines = [line for line in done.err.splitlines() if "tsgdd: " in line]
    assert len(lines) == 1, done.err
    if alone:
        assert lines == done.err.strip().splitlines()
    for text in texts:
        assert text in lines[0]
    assert "Traceback" not in done.out + done.err
    assert done.code == code


@pytest.fixture
def box_mesh(tmp_path):
    """A gmsh file of the unit cube with named sides, of hexahedra or not."""

    def make(*, hexahedra, sides=("bottom", "top")):
        gmsh = pytest.importorskip("gmsh", exc_type=ImportError)
        gmsh.initialize([], readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        geo = gmsh.model.geo
        corners = [geo.addPoint(x, y, 0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
        lines = [geo.addLine(corners[i], corners[i - 3]) for i in range(4)]
        for line in lines:
            geo.mesh.setTransfiniteCurve(line, 2)
        back = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.mesh.setTransfiniteSurface(back)
        if hexahedra:
            geo.mesh.setRecombine(2, back)
        made = geo.extrude([(2, back)], 0, 0, 1, numElements=[1] if hexahedra else [], recombine=hexahedra)
        geo.synchronize()
        for side, name in zip((2, 4), sides, strict=True):
            gmsh.model.addPhysicalGroup(2, [made[side][1]], name=name)
        gmsh.model.addPhysicalGroup(3, [made[1][1]], name="body")
        gmsh.model.mesh.generate(3)
        gmsh.write(str(tmp_path / "box.msh"))
        gmsh.finalize()
        return tmp_path / "box.msh"

    return make


@pytest.mark.parametrize(
    ("arguments", "texts"),
    [
        (["nonsense"], ["No such command 'nonsense'"]),
        (["structure", "--cells", 1, 1, 1, "--bar-force", -1e-8], ["bar_force: expected positive", "got -1e-08"]),
        (["structure", "--cells", 1, 1, 1, "--bar-force", "nan"], ["bar_force: expected positive", "got nan"]),
        (["structure", "--cells", 1, 1, 1, "--half-diagonal", 1], ["half_diagonal", "(0, 1), got 1.0"]),
        (["structure", "--cells", 1, 1, 1, "--half-diagonal", -0.5], ["half_diagonal", "(0, 1), got -0.5"]),
        (["structure", "--cells", 0, 1, 1], ["cells: expected", "got 0 1 1"]),
        (["structure", "--cells", 2, 2], ["'--cells' requires 3 arguments"]),
        (["structure"], ["--cells NX NY NZ"]),
        (["structure", "--shape", "cone"], ["shape: expected box or spheroid, got 'cone'"]),
        (["structure", "--shape", "spheroid", "--radius", "nan"], ["radius: expected", "got nan"]),
        (["dns", "--bar-force", 1.0], ["bar_force: expected less than the bar stiffness"]),
        (["dns", "--blocks", 0, 3], ["blocks", "at least 1, got 0 3"]),
        (["dns", "--strain", 0], ["strain: expected", "got 0.0"]),
        (["dns", "--strain", "inf"], ["strain: expected", "got inf"]),
        (["dns", "--strain", "much"], ["--strain", "valid number"]),
        (["dns", "--load", "bend"], ["--load", "'bend' is not one of 'stretch', 'shear'"]),
        (["dns", "--linear-solver", "magic"], ["linear solver: expected auto", "got 'magic'"]),
        (["dns", "--stretchy"], ["No such option: --stretchy"]),
        (["sample"], ["out: expected a file name that ends in .h5"]),
        (["sample", "--paths", 0], ["paths: expected at least 1, got 0"]),
        (["sample", "--steps", 0], ["steps: expected at least 1, got 0"]),
        (["sample", "--seed", -1], ["seed: expected at least 0, got -1"]),
        (["sample", "--processes", 0], ["processes: expected at least 1, got 0"]),
        (["sample", "--paths", "many"], ["--paths", "valid integer"]),
    ],
)
def test_bad_arguments(arguments, texts, tsgdd, tmp_path):
    name = "out" if "out: " in texts[0] or arguments[0] != "sample" else "out.h5"
    out = [] if arguments == ["nonsense"] else ["--out", tmp_path / name]
    check(tsgdd(arguments[0], *out, *arguments[1:]), 2, *texts)
    assert not list(tmp_path.iterdir())


def test_output_that_cannot_be_written(tsgdd, chain, tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    dd = ("solve", "--data", chain.data, "--elements", 1, 1, 1)
    for arguments in (
        ("structure", "--cells", 1, 1, 1, "--out", file / "deep"),
        ("structure", "--cells", 1, 1, 1, "--out", file),
        ("dns", "--blocks", 1, 1, "--out", file),
        ("sample", "--out", file / "d.h5"),
        ("compare", "--dd", chain.dd, "--dns", chain.dns, "--out", file),
        ("demo", "--out", file),
        (*dd, "--out", file),
    ):
        check(tsgdd(*arguments), 2, str(file), "cannot be written")
    assert file.read_text() == "mine"
    (tmp_path / "folder.h5").mkdir()
    check(tsgdd("sample", "--out", tmp_path / "folder.h5"), 2, "out: expected a file, got the folder")


def set_unit(file):
    file["stress"].attrs["unit"] = "kPa"


def set_nan(file):
    file["stress"][3, 2] = np.nan


def no_points(file):
    for name in list(file):
        unit, shape = file[name].attrs["unit"], file[name].shape[1:]
        del file[name]
        file.create_dataset(name, (0, *shape), float).attrs["unit"] = unit


def drop_strain(file):
    del file["strain"]


def new_schema(file):
    file.attrs["schema"] = 99


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (set_unit, "stress: expected the unit 'Pa', got 'kPa'"),
        (set_nan, "stress: expected finite numbers, got NaN or infinity at 1 points (first at index 3)"),
        (no_points, "expected at least one point, got none"),
        (drop_strain, "strain is missing"),
        (new_schema, "expected schema 1, got 99"),
    ],
)
def test_data_that_are_not_valid(change, text, tsgdd, chain, tmp_path):
    shutil.copy(chain.data, tmp_path / "d.h5")
    with h5py.File(tmp_path / "d.h5", "a") as file:
        change(file)
    solve = ("solve", "--data", tmp_path / "d.h5", "--elements", 1, 1, 1, "--out", tmp_path / "out")
    check(tsgdd(*solve), 2, "d.h5", text)
    assert not (tmp_path / "out").exists()


def test_files_that_are_no_data(tsgdd, chain, tmp_path):
    (tmp_path / "empty.h5").write_bytes(b"")
    (tmp_path / "text.h5").write_text("strain,stress\n1,2\n")
    (tmp_path / "truncated.h5").write_bytes(chain.data.read_bytes()[:20_000])
    h5py.File(tmp_path / "hollow.h5", "w").close()
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["strain"] = np.ones((3, 6))
    for name, text in {
        "none.h5": "no such file",
        "empty.h5": "expected an HDF5 file",
        "text.h5": "expected an HDF5 file",
        "truncated.h5": "expected an HDF5 file",
        "hollow.h5": "format='tsgdd-dataset', got None",
        "foreign.h5": "format='tsgdd-dataset', got None",
    }.items():
        data = tmp_path / name
        check(tsgdd("solve", "--data", data, "--elements", 1, 1, 1, "--out", tmp_path / "out"), 2, name, text)
        if name != "none.h5":  # to append to, as well
            before = data.read_bytes()
            check(tsgdd("sample", "--append", "--paths", 1, "--out", data), 2, name, text)
            assert data.read_bytes() == before


def test_append_of_another_stress(tsgdd, chain):
    before = chain.data.read_bytes()
    append = ("sample", "--append", "--paths", 1, "--stress-measure", "cauchy", "--out", chain.data)
    check(tsgdd(*append), 2, "expected a data set of cauchy stress to append to")
    assert chain.data.read_bytes() == before


@pytest.mark.parametrize(
    ("options", "texts"),
    [
        (["--elements", 1, 1, 1, "--strain", 0.3], ["strain: expected a nominal eps_yy within", "got 0.3"]),
        (["--elements", 1, 1, 1, "--strain", 0.3, "--load", "shear"], ["eps_xy within", "got 0.15"]),
        (["--elements", 0, 1, 1], ["elements: expected three positive integers, got (0, 1, 1)"]),
        (["--elements", 1, 1, 1, "--metric", "best"], ["metric: expected one of auto, tangent, visited", "got 'best'"]),
        (["--elements", 1, 1, 1, "--order", 3], ["order: expected 1 or 2, got 3"]),
        (["--elements", 1, 1, 1, "--max-iterations", 0], ["max_iterations: expected at least 1, got 0"]),
        (["--elements", 1, 1, 1, "--over-relaxation", 2], ["over_relaxation: expected a number in [1, 2), got 2.0"]),
        (["--elements", 1, 1, 1, "--order", 2, "--over-relaxation", 1.5], ["over_relaxation: expected none but with"]),
        (["--elements", 1, 1, 1, "--mesh", "a.msh"], ["elements, mesh: expected one of them"]),
        ([], ["elements, mesh: expected one of them"]),
        (["--mesh", "none.msh"], ["mesh none.msh: no such file"]),
    ],
)
def test_bad_scenes(options, texts, tsgdd, chain, tmp_path):
    check(tsgdd("solve", "--data", chain.data, *options, "--out", tmp_path), 2, *texts)


def test_bad_meshes(tsgdd, chain, box_mesh, tmp_path):
    solve = ("solve", "--data", chain.data, "--out", tmp_path, "--mesh")
    check(tsgdd(*solve, box_mesh(hexahedra=False)), 2, "expected 8-node hexahedra only, got tetrahedra")
    roof = box_mesh(hexahedra=True, sides=("bottom", "roof"))
    check(tsgdd(*solve, roof), 2, "side of the mesh: expected one of bottom, roof, got 'top'")
    assert tsgdd(*solve, box_mesh(hexahedra=True), "--no-plots").code == 0


def test_wrong_folders_to_compare(tsgdd, chain, tmp_path):
    def compare(dd, dns):
        return tsgdd("compare", "--dd", dd, "--dns", dns, "--out", tmp_path / "out")

    check(compare(chain.dns, chain.dd), 2, str(chain.dns), "a folder made by 'tsgdd solve'")
    check(compare(chain.dd, tmp_path), 2, str(tmp_path), "a folder made by 'tsgdd dns'", "no summary.json")
    (tmp_path / "summary.json").write_text("{")
    check(compare(chain.dd, tmp_path), 2, "summary.json: expected JSON")
    assert tsgdd("dns", "--blocks", 3, 4, "--strain", 0.04, "--no-plots", "--out", tmp_path / "dns").code == 0
    check(compare(chain.dd, tmp_path / "dns"), 2, "elements: expected each in a block of the tensegrity", "4 of 16")


def test_no_convergence_is_a_failed_run(tsgdd, launch, chain, tmp_path):
    solve = ("solve", "--data", chain.data, "--elements", 2, 2, 1, "--max-iterations", 1, "--out", tmp_path)
    for done in (tsgdd(*solve), launch(*solve, ranks=2)):
        check(done, 1, "expected convergence within 1 iterations", alone=False)
    assert not (tmp_path / "summary.json").exists()


@pytest.mark.parametrize("ranks", [None, 2])
def test_no_compiler_is_a_failed_run(ranks, launch, chain, tmp_path):
    env = {"CC": "/nonexistent/cc", "XDG_CACHE_HOME": str(tmp_path / "cache")}
    if ranks is None:  # mpirun may need the path itself
        env["PATH"] = "/nonexistent"
    solve = ("solve", "--data", chain.data, "--elements", 1, 2, 1, "--out", tmp_path / "out")
    check(launch(*solve, ranks=ranks, env=env), 1, "C compiler", alone=False)


def test_bad_input_on_two_ranks(launch, chain, box_mesh, tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "empty.h5").touch()
    roof = box_mesh(hexahedra=True, sides=("bottom", "roof"))
    solve = ("solve", "--out", tmp_path / "out", "--data")
    for arguments, text in (
        ((*solve, tmp_path / "empty.h5", "--elements", 1, 2, 1), "expected an HDF5 file"),
        ((*solve, chain.data, "--mesh", roof), "got 'top'"),
        (("solve", "--data", chain.data, "--elements", 1, 2, 1, "--out", tmp_path / "file"), "cannot be written"),
        ((*solve, chain.data, "--stretchy"), "No such option: --stretchy"),
        (("sample", "--paths", 0, "--out", tmp_path / "d.h5"), "paths: expected at least 1, got 0"),
        (("dns", "--blocks", 1, 1, "--out", tmp_path / "out"), "dns: expected one process, got 2 ranks"),
    ):
        check(launch(*arguments, ranks=2), 2, text, alone=False)


def test_what_one_rank_alone_gets_wrong_ends_all(mpirun, program, chain, tmp_path):
    solve = ("solve", "--data", chain.data, "--elements", 1, 2, 1, "--no-plots", "--out", tmp_path / "out")

    def second_rank(*wrong):
        command = shlex.join(map(str, (program, *solve)))
        by_rank = (
            f'[ "$PMI_RANK$OMPI_COMM_WORLD_RANK" = 0 ] && exec {command}; exec {command} {shlex.join(map(str, wrong))}'
        )
        done = mpirun(2, "sh", "-c", by_rank, timeout=60)
        assert "Traceback" not in done.stdout + done.stderr
        return done.returncode, done.stderr

    code, err = second_rank("--data", tmp_path / "none.h5")  # a disk that only the first rank's machine has
    assert code == 2
    assert err.count("none.h5: no such file") == 1, err
    code, err = second_rank("--stretchy")  # it leaves before MPI starts, where the first rank waits
    assert code == 2
    assert err.count("rank 1: tsgdd: No such option: --stretchy") == 1, err


LOADED = """
import sys
from workflows.cli import main
sys.argv = ["tsgdd", *sys.argv[1:]]
try:
    main()
finally:
    print("LOADED", *{name.split(".")[0] for name in sys.modules})
"""


@pytest.mark.parametrize(
    ("arguments", "allowed"),
    [
        ("--help", set()),
        ("solve --help", set()),
        ("structure --cells 1 1 1 --no-plots --out {}", {"numpy", "scipy", "h5py"}),
        ("sample --paths 1 --steps 1 --processes 1 --no-plots --out {}/d.h5", {"numpy", "scipy", "h5py"}),
        (
            "solve --adapt --bar-force 1e-8 --elements 2 1 1 --no-edges --no-plots --out {}",
            HEAVY - {"matplotlib", "meshio", "gmsh"},
        ),
        ("dns --blocks 1 1 --steps 1 --no-plots --out {}", {"numpy", "scipy", "h5py"}),
        ("dns --blocks 1 1 --steps 1 --out {}", {"numpy", "scipy", "h5py", "matplotlib", "meshio"}),
    ],
)
def test_what_a_command_imports(arguments, allowed, tmp_path):
    command = [sys.executable, "-c", LOADED, *arguments.format(tmp_path).split()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    loaded = set(done.stdout.split("LOADED")[1].split())
    assert "typer" in loaded
    assert loaded & HEAVY <= allowed


def test_help(launch, tsgdd):
    done = launch("--help")
    assert done.code == 0
    commands = ("structure", "sample", "dns", "solve", "compare", "import-csv", "demo")
    for command in commands:
        assert f"\n  {command} " in done.out
        assert "--out" in tsgdd(command, "--help").out
    alone = tsgdd()
    assert alone.code == 2
    assert "Commands:" in alone.err
    assert len(alone.err.splitlines()) > len(commands)
