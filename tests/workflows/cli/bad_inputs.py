"""Bad inputs for every command: files that are damaged, values out of range, things of the wrong kind.

``bad_inputs(folder, count, seed)`` makes them, each a command line that must end by itself with exit code 1 or 2 and
one line; one that is damaged where nothing reads may also be taken. As a script, which takes minutes:

    python tests/workflows/cli/bad_inputs.py --count 400 --out FOLDER

runs them, each in a process of its own, and prints those that crash, hang, or say more or less than a line.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

DATA = Path(__file__).parents[2] / "data"
SECONDS = 25.0


@dataclass(frozen=True)
class BadInput:
    """A command line, and what is wrong with it; ``may_pass`` where it can be right by chance."""

    what: str
    arguments: tuple[str, ...]
    may_pass: bool = False


@dataclass(frozen=True)
class Sources:
    """Good files that are damaged, by their role."""

    folder: Path

    @property
    def files(self) -> dict[str, Path]:
        made = self.folder
        return {
            "data": DATA / "cases" / "hdf5" / "stretch_data.h5",
            "csv": DATA / "cases" / "csv" / "hold_20_lines.csv",
            "curve": DATA / "cases" / "calibrate" / "offset_100nm.csv",
            "mesh": DATA / "cases" / "mesh" / "reference_ok.msh",
            "tsgfem": DATA / "tsgfem" / "dbar_s1_slack0.npz",
            "tissue": made / "tissue.toml",
            "profile": made / "profile.csv",
            "stl": made / "cube.stl",
            "ply": made / "cube.ply",
            "obj": made / "cube.obj",
            "tif": made / "labels.tif",
        }


def make_sources(folder: Path, run: Callable[..., int]) -> Sources:
    """All good files, and two runs in ``folder``; ``run`` is the command line."""
    import meshio
    import numpy as np

    from tsg_micro.cells.tissue import Tissue
    from tsg_micro.cells.tissue_file import write_tissue

    folder.mkdir(parents=True, exist_ok=True)
    write_tissue(folder / "tissue.toml", Tissue())
    (folder / "profile.csv").write_text("r_over_R,f_over_fmax\n0,1\n0.5,0.6\n1,0.1\n")
    points = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
    sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    triangles = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    for suffix in ("stl", "ply", "obj"):
        meshio.write_points_cells(folder / f"cube.{suffix}", points, [("triangle", triangles.astype(np.int32))])
    try:
        import tifffile
    except ImportError:
        (folder / "labels.tif").write_bytes(b"II*\x00\x08\x00\x00\x00\x00\x00")
    else:
        tifffile.imwrite(folder / "labels.tif", np.ones((3, 4, 5), dtype=np.uint8), photometric="minisblack")
    data = Sources(folder).files["data"]
    for arguments in (
        ("dns", "--blocks", 3, 3, "--steps", 1, "--no-plots", "--out", folder / "dns"),
        ("solve", "--data", data, "--elements", 3, 3, 1, "--no-plots", "--out", folder / "dd"),
    ):
        assert run(*arguments) == 0
    return Sources(folder)


def bad_inputs(sources: Sources, folder: Path, count: int, seed: int = 0) -> list[BadInput]:
    """``count`` of them, of each kind in turn; files are made in ``folder``."""
    rng = random.Random(seed)
    folder.mkdir(parents=True, exist_ok=True)
    kinds = [_files(rng, sources, folder), _runs(rng, sources, folder), _values(rng, sources, folder)]
    kinds += [_kinds(rng, sources, folder), _values(rng, sources, folder), _files(rng, sources, folder)]
    return [next(kinds[k % len(kinds)]) for k in range(count)]


# Files

_ONE = ("--processes", "1")
_READERS: dict[str, list[tuple[str, ...]]] = {
    "data": [
        ("solve", "--data", "FILE", "--elements", "1", "1", "1", "--no-plots"),
        ("solve", "--data", "FILE", "--elements", "1", "1", "1", "--order", "2", "--no-plots"),
        (
            "sample",
            "--append",
            "--paths",
            "1",
            "--steps",
            "1",
            "--seed",
            "5",
            "--processes",
            "1",
            "--no-plots",
            "=FILE",
        ),
        ("study", "metric", "--load", "stretch", "--blocks", "3", "3", "--data", "FILE", "--no-plots"),
        ("study", "convergence", "--load", "stretch", "--blocks", "3", "3", "--data", "FILE", "--no-plots"),
    ],
    "csv": [
        (
            *("import-csv", "FILE", "--column", "eps_yy=strain:%", "--column", "sigma_yy=stress:kPa"),
            *("--zero", "eps_xx,eps_zz,eps_yz,eps_xz,eps_xy,sigma_xx,sigma_zz,sigma_yz,sigma_xz,sigma_xy", "H5"),
        )
    ],
    "curve": [("calibrate", "--data", "FILE", "--fit", "bar-force", "--no-plots")],
    "mesh": [
        ("solve", "--data", "DATA", "--mesh", "FILE", "--no-plots"),
        ("fe2", "--mesh", "FILE", "--no-plots"),
    ],
    "tsgfem": [("bench", "tsgfem", "--cases", "FOLDER")],
    "tissue": [
        ("structure", "--cells", "1", "1", "1", "--no-plots", "--tissue", "FILE"),
        ("cell", "--steps", "1", "--no-plots", "--tissue", "FILE"),
        ("dns", "--blocks", "1", "1", "--steps", "1", "--no-plots", "--tissue", "FILE"),
        ("sample", "--paths", "1", "--steps", "1", "--processes", "1", "--no-plots", "--tissue", "FILE", "H5"),
        ("fe2", "--elements", "1", "1", "1", "--no-plots", "--tissue", "FILE"),
    ],
    "profile": [("spheroid", "--radius", "1.5", "--steps", "1", "--no-plots", "--profile", "FILE")],
    "stl": [("mesh", "voxels", "--surface", "FILE", "--unit", "um", "--size", "0.5um", "--no-plots", "MSH")],
    "ply": [("mesh", "voxels", "--surface", "FILE", "--unit", "um", "--size", "0.5um", "--no-plots", "MSH")],
    "obj": [("mesh", "voxels", "--surface", "FILE", "--unit", "um", "--size", "0.5um", "--no-plots", "MSH")],
    "tif": [
        ("mesh", "voxels", "--labels", "FILE", "--size", "1um", "--spacing", *["1um"] * 3, "--no-plots", "MSH"),
    ],
}
_FOREIGN = {
    "png": b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR",
    "gzip": b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\x03",
    "hdf5 head": b"\x89HDF\r\n\x1a\n" + bytes(40),
    "zip head": b"PK\x03\x04" + bytes(30),
    "bom": b"\xff\xfe" + "strain,stress\n1,2\n".encode("utf-16-le"),
    "nul": bytes(5000),
    "long line": b"1," * 200_000,
    "brackets": b"[" * 100_000,
    "latin 1": b"\xe9\xe8,\xfc\n1,2\n",
}


def _files(rng: random.Random, sources: Sources, folder: Path) -> Iterator[BadInput]:
    """A damaged file for a command that reads one."""
    readers = [(role, command) for role, commands in _READERS.items() for command in commands]
    k = 0
    while True:
        k += 1
        role, command = readers[(k * 7) % len(readers)]
        good = sources.files[role]
        place = folder / f"file{k}-{rng.randrange(10**9)}"
        place.mkdir()
        path = place / good.name
        damage = rng.choice(list(_DAMAGE))
        content = good.read_bytes()
        _DAMAGE[damage](rng, path, content)
        yield BadInput(f"{role}: {damage}", _filled(command, path, place, sources), damage in _MAY_PASS)


def _filled(command: tuple[str, ...], path: Path, place: Path, sources: Sources) -> tuple[str, ...]:
    """The command with its places filled in; where it says nothing of its output that is a folder."""
    last: dict[str, list[str]] = {
        "H5": ["--out", str(place / "out.h5")],
        "MSH": ["--out", str(place / "out.msh")],
        "=FILE": ["--out", str(path)],
    }
    words = {"FILE": str(path), "FOLDER": str(path.parent), "DATA": str(sources.files["data"])}
    made = [words.get(word, word) for word in command if word not in last]
    return (*made, *last.get(command[-1], ["--out", str(place / "out")]))


def _truncated(rng: random.Random, path: Path, content: bytes) -> None:
    path.write_bytes(content[: rng.randrange(1, max(2, len(content) - 1))])


def _bytes(rng: random.Random, path: Path, content: bytes) -> None:
    path.write_bytes(rng.randbytes(rng.choice([1, 10, 1000, 100_000])))


def _flipped(rng: random.Random, path: Path, content: bytes) -> None:
    changed = bytearray(content)
    for _ in range(rng.choice([1, 10, 200])):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    path.write_bytes(changed)


def _cut_out(rng: random.Random, path: Path, content: bytes) -> None:
    begin = rng.randrange(len(content))
    path.write_bytes(content[:begin] + content[begin + rng.randrange(1, 200) :])


def _digits(rng: random.Random, path: Path, content: bytes) -> None:
    """Some numbers of the text are others."""
    words = rng.choice([b"nan", b"inf", b"-1e308", b"1e999", b"99999999999999999999", b"", b"x", b"-7", b"0"])
    found = list(re.finditer(rb"[\d.]+", content))
    for match in reversed(rng.sample(found, min(len(found), rng.choice([1, 3])))):
        content = content[: match.start()] + words + content[match.end() :]
    path.write_bytes(content)


def _foreign(rng: random.Random, path: Path, content: bytes) -> None:
    path.write_bytes(rng.choice(list(_FOREIGN.values())))


def _twice(rng: random.Random, path: Path, content: bytes) -> None:
    path.write_bytes(content + content)


def _hdf5(rng: random.Random, path: Path, content: bytes) -> None:
    """An HDF5 file that says it is a data set, with arrays of other kinds."""
    import h5py
    import numpy as np

    with h5py.File(path, "w") as file:
        file.attrs.update({"format": "tsgdd-dataset", "schema": 1, "stress_measure": "first_piola"})
        file.attrs["parameters"] = rng.choice(["{}", "[]", "{", "null", '{"joined": 3}', '{"tissue": {"cell": 5}}'])
        n = rng.choice([0, 1, 3])
        for name in ("strain", "stress", "path", "step"):
            shape = rng.choice([(n, 6), (n,), (6, n), (), (n, 6, 6)])
            kind = rng.choice(["f8", "i4", "S5", "c16", "bool"])
            made = file.create_dataset(name, data=np.zeros(shape, dtype=kind))
            made.attrs["unit"] = rng.choice(["1", "Pa", "kPa", 3])


_DAMAGE: dict[str, Callable[[random.Random, Path, bytes], None]] = {
    "truncated": _truncated,
    "random bytes": _bytes,
    "bits flipped": _flipped,
    "cut out": _cut_out,
    "other numbers": _digits,
    "of another kind": _foreign,
    "twice": _twice,
    "hdf5": _hdf5,
    "empty": lambda rng, path, content: path.touch(),
    "missing": lambda rng, path, content: None,
    "folder": lambda rng, path, content: path.mkdir(),
    "link to itself": lambda rng, path, content: path.symlink_to(path),
    "link to nothing": lambda rng, path, content: path.symlink_to(path.with_name("nothing")),
    "pipe": lambda rng, path, content: os.mkfifo(path),
    "endless": lambda rng, path, content: path.symlink_to("/dev/zero"),
}
_MAY_PASS = ("truncated", "bits flipped", "cut out", "other numbers", "twice", "empty", "missing", "link to nothing")
"""Text may be right without its end; what is not there is made, where it is to be added to."""


# Folders of runs


def _runs(rng: random.Random, sources: Sources, folder: Path) -> Iterator[BadInput]:
    """A run of which a file is damaged, for a command that reads it."""
    k = 0
    while True:
        k += 1
        role = rng.choice(["dd", "dns"])
        place = folder / f"run{k}-{rng.randrange(10**9)}"
        shutil.copytree(sources.folder / role, place / role)
        files = [path for path in sorted((place / role).iterdir()) if path.suffix in (".json", ".h5")]
        path = rng.choice(files)
        content = path.read_bytes()
        path.unlink()
        if path.suffix == ".json" and rng.random() < 0.6:
            what = f"{path.name}: {_json(rng, path, content)}"
        else:
            damage = rng.choice(list(_DAMAGE))
            _DAMAGE[damage](rng, path, content)
            what = f"{path.name}: {damage}"
        folders = {name: str((place if name == role else sources.folder) / name) for name in ("dd", "dns")}
        compare = ("compare", "--dd", folders["dd"], "--dns", folders["dns"], "--no-plots", "--out", str(place / "out"))
        study = ("study", "metric", "--load", "stretch", "--blocks", "3", "3", "--dns", folders["dns"], "--no-plots")
        given = (*study, "--data", str(sources.files["data"]), "--out", str(place / "out"))
        readers = {0: given if role == "dns" else compare, 1: (rng.choice(["show", "table"]), str(place / role))}
        yield BadInput(f"{role} {what}", readers.get(k % 4, compare), may_pass=True)


def _json(rng: random.Random, path: Path, content: bytes) -> str:
    """A summary one value of which, or of its parameters, is of another kind."""
    summary = json.loads(content)
    inside = rng.choice([summary, summary["parameters"]])
    name = rng.choice(sorted(inside))
    if rng.random() < 0.3:
        del inside[name]
        what = f"no {name}"
    else:
        inside[name] = rng.choice([None, "x", [], {}, -1, 1e308, [[1]], True, float("nan"), 10**30])
        what = f"{name} {inside[name]}"
    path.write_text(json.dumps(summary))
    return what


# Values

_COMMANDS: dict[str, tuple[str, ...]] = {
    "structure": ("structure", "--cells", "1", "1", "1", "--no-plots"),
    "sample": ("sample", "--paths", "1", "--steps", "1", "--processes", "1", "--no-plots", "H5"),
    "dns": ("dns", "--blocks", "1", "1", "--steps", "1", "--no-plots"),
    "solve": ("solve", "--data", "DATA", "--elements", "1", "1", "1", "--no-plots"),
    "adapt": (
        "solve",
        "--adapt",
        "--bar-force",
        "1e-8",
        "--rve-budget",
        "2",
        "--elements",
        "1",
        "1",
        "1",
        "--no-plots",
    ),
    "fe2": ("fe2", "--elements", "1", "1", "1", "--no-plots"),
    "cell": ("cell", "--steps", "1", "--no-plots"),
    "monolayer": ("monolayer", "--blocks", "1", "1", "--steps", "1", "--strain", "0.01", "--no-plots"),
    "spheroid": ("spheroid", "--radius", "1.5", "--steps", "1", "--no-plots"),
    "calibrate": ("calibrate", "--data", "CURVE", "--fit", "bar-force", "--no-plots"),
    "import-csv": _READERS["csv"][0],
    "voxels": ("mesh", "voxels", "--surface", "STL", "--unit", "um", "--size", "0.5um", "--no-plots", "MSH"),
    "study rve-size": ("study", "rve-size", "--largest", "2", "--no-plots"),
    "study trust": ("study", "trust", "--scenes", "1", "--largest", "2", "--most", "10", "--no-plots"),
    "study data-size": ("study", "data-size", "--load", "stretch", "--blocks", "3", "3", "--paths", "1", "--no-plots"),
    "study sampling": (
        "study",
        "sampling",
        "--load",
        "stretch",
        "--data",
        "DATA",
        "--elements",
        "1",
        "1",
        "--no-plots",
    ),
    "study edges": ("study", "edges", "--blocks", "5", "5", "--no-plots"),
    "study data-error": ("study", "data-error", "--blocks", "3", "3", "--states", "8", "--no-plots"),
    "bench accuracy": ("bench", "accuracy", "--case", "1", "--no-parts", "--no-plots"),
    "bench stability": ("bench", "stability", "--micro", "1", "--sheets", "0", "--macro", "0", "--no-plots"),
    "demo": ("demo", "--blocks", "1", "1", "--paths", "1"),
    "paper": ("paper", "--blocks", "1", "1", "--paths", "1", "--steps", "1", "--sizes", "1", "--draws", "1"),
}
_CELL = ("--bar-force", "--e-bar", "--e-tendon", "--half-diagonal", "--d-bar", "--d-tendon", "--height")
_NUMBERS: dict[str, tuple[str, ...]] = {
    "structure": (*_CELL, "--cells", "--radius"),
    "sample": (*_CELL, "--paths", "--steps", "--seed", "--blocks", "--processes"),
    "dns": (*_CELL, "--blocks", "--steps", "--strain"),
    "solve": ("--strain", "--elements", "--order", "--degree", "--max-iterations", "--over-relaxation", "--max-error"),
    "adapt": (*_CELL, "--rve-budget", "--adapt-tolerance", "--strain", "--max-error"),
    "fe2": (*_CELL, "--strain", "--steps", "--tolerance", "--degree", "--elements"),
    "cell": (*_CELL, "--force", "--steps"),
    "monolayer": (*_CELL, "--blocks", "--layers", "--strain", "--steps", "--write-every", "--convergence", "--band"),
    "spheroid": (*_CELL[1:], "--radius", "--f-max", "--decay", "--level", "--steps"),
    "calibrate": (*_CELL, "--skip"),
    "import-csv": ("--skip",),
    "voxels": ("--size", "--spacing"),
    "study rve-size": ("--largest", "--bar-force"),
    "study trust": ("--scenes", "--first", "--largest", "--most"),
    "study data-size": ("--blocks", "--strain", "--bar-force", "--paths", "--steps", "--seed"),
    "study sampling": ("--elements", "--bar-force"),
    "study edges": ("--blocks", "--strain", "--bar-force"),
    "study data-error": ("--states", "--draws", "--budget", "--strain", "--paths"),
    "bench accuracy": ("--case",),
    "bench stability": ("--micro", "--sheets", "--macro", "--seed", "--limit", "--processes"),
    "demo": ("--blocks", "--paths"),
    "paper": ("--largest", "--sizes", "--draws", "--blocks", "--strain", "--bar-force", "--paths", "--steps", "--seed"),
}
_THREE, _TWO = ("--cells", "--elements", "--spacing"), ("--blocks",)
_NEVER = ("nan", "inf", "-inf", "x", "", "1e", "-1", "--", "1e400", "0x10", "1,5", "None", "[1]", "1e-400")
_SOMETIMES = ("0", "1e308", "-1e-300", "99999999999999999999", "1e30", "1e-30", "3.5")


def _values(rng: random.Random, sources: Sources, folder: Path) -> Iterator[BadInput]:
    """An option with a number that is none, or that nothing can be done with."""
    names = [(command, option) for command, options in _NUMBERS.items() for option in options]
    rng.shuffle(names)
    k = 0
    while True:
        command, option = names[k % len(names)]
        k += 1
        place = folder / f"value{k}-{rng.randrange(10**9)}"
        place.mkdir()
        value = rng.choice(_NEVER + _SOMETIMES)
        count = 3 if option in _THREE else 2 if option in _TWO else 1
        if command in ("sample", "study rve-size") and option == "--blocks":
            count = 3
        if command == "study sampling" and option == "--elements":
            count = 2
        values = ["1"] * count
        values[rng.randrange(count)] = value
        given = _filled(_with_sources(_COMMANDS[command], sources), place, place, sources)
        may = value in _SOMETIMES or option in ("--skip", "--size", "--spacing", "--convergence", "--band", "--strain")
        may = may or value in ("-1", "1e-400", "")
        at = len(given) - 2
        yield BadInput(f"{command} {option} {value!r}", (*given[:at], option, *values, *given[at:]), may)


def _with_sources(command: tuple[str, ...], sources: Sources) -> tuple[str, ...]:
    words = {"CURVE": "curve", "STL": "stl", "FILE": "csv"}
    return tuple(str(sources.files[words[word]]) if word in words else word for word in command)


# Wrong kinds

_WORDS: tuple[str, ...] = (
    "--load",
    "--kind",
    "--shape",
    "--kinematics",
    "--clamp",
    "--element",
    "--metric",
    "--method",
    "--images",
)
_WORDS += ("--stress-measure", "--linear-solver", "--top", "--profile", "--scene", "--fit", "--unit", "--axes")
_WORDS += ("--column", "--zero", "--silent", "--delimiter", "--decimal", "--mesh-unit", "--tissue", "--mesh", "--data")
_PLACES: tuple[tuple[str, Callable[[Path], Path]], ...] = (
    ("output is in a file", lambda place: _touched(place / "file") / "out"),
    ("output is a file or a folder", lambda place: _touched(place / "out") if place.name < "kind5" else _made(place)),
    ("output is in proc", lambda place: Path("/proc/nowhere/out")),
    ("output is a device", lambda place: Path("/dev/null")),
    ("output has a long name", lambda place: place / ("x" * 300)),
    ("output is a link to itself", lambda place: _loop(place / "loop")),
    ("output is in a folder that is read only", lambda place: Path("/sys/out")),
)


_PASS = ("output is a file or a folder",)


def _touched(path: Path) -> Path:
    path.touch()
    return path


def _made(place: Path) -> Path:
    (place / "out.h5").mkdir(exist_ok=True)
    return place / "out.h5"


def _loop(path: Path) -> Path:
    path.symlink_to(path)
    return path


def _kinds(rng: random.Random, sources: Sources, folder: Path) -> Iterator[BadInput]:
    """An output that cannot be, a word that is not known, an option of another command or without its value."""
    k = 0
    while True:
        k += 1
        place = folder / f"kind{k}-{rng.randrange(10**9)}"
        place.mkdir()
        command = rng.choice([name for name in _COMMANDS if name not in ("demo", "paper", "study data-error")])
        given = _filled(_with_sources(_COMMANDS[command], sources), place, place, sources)
        choice = rng.randrange(4)
        if choice < 2:
            what, made = _PLACES[rng.randrange(len(_PLACES))]
            suffix = {"H5": ".h5", "MSH": ".msh"}.get(_COMMANDS[command][-1], "")
            out = made(place)
            out = out.with_name(out.name + suffix) if what in ("output is in proc", "output has a long name") else out
            yield BadInput(f"{command}: {what}", (*given[:-1], str(out)), may_pass=what in _PASS)
        elif choice == 2:
            option = rng.choice(_WORDS)
            word = rng.choice(["nonsense", "", "ä" * 50, "sheet sheet sheet", "a=b:c", ",", "=", "../..", "%s{0}\\"])
            yield BadInput(f"{command} {option} {word!r}", (*given[:-2], option, word, *given[-2:]), may_pass=True)
        else:
            yield BadInput(f"{command}: options without values", (*given[:-2], rng.choice(_CELL)))


# Running them


@dataclass(frozen=True)
class Outcome:
    """How a bad input ended; ``fault`` is empty where it ended as it should."""

    fault: str
    code: int | None
    err: str


def judge(bad: BadInput, code: int | None, err: str) -> Outcome:
    """Whether it ended by itself with 1 or 2 and one line, or, where it may be right, with 0."""
    lines = [line for line in err.replace("\r", "\n").splitlines() if line.strip() and not line.startswith("sampling")]
    ours = [line for line in lines if line.startswith("tsgdd: ")]
    fault = ""
    if code is None:
        fault = "hang"
    elif "Traceback" in err or "this is a defect" in err:
        fault = "traceback"
    elif code not in ((0, 1, 2) if bad.may_pass else (1, 2)):
        fault = "accepted" if code == 0 else "crash"
    elif code and (len(ours) != 1 or lines[-1:] != ours):
        fault = "not one line"
    return Outcome(fault, code, err)


def run_alone(bad: BadInput, seconds: float, folder: Path) -> Outcome:
    """Run it in a process of its own, forked from this one."""
    err = folder / f"err-{os.getpid()}"
    child = os.fork()
    if child == 0:
        _become(bad.arguments, err)
    begin, code = time.monotonic(), None
    while code is None and time.monotonic() - begin < seconds:
        ended, status = os.waitpid(child, os.WNOHANG)
        code = os.waitstatus_to_exitcode(status) if ended else None
        time.sleep(0.01)
    if code is None:
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
    return judge(bad, code, err.read_text(errors="replace"))


def _become(arguments: tuple[str, ...], err: Path) -> None:
    """In a forked process: run the command line and end."""
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_RDWR), 1)
    os.dup2(os.open(err, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
    sys.argv = ["tsgdd", *arguments]
    code: object = 99
    try:
        from workflows.cli import main

        main()
        code = 0
    except SystemExit as end:
        code = end.code
    finally:
        sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 98)


def _call(*arguments: object) -> int:
    child = os.fork()
    if child == 0:
        _become(tuple(map(str, arguments)), Path(os.devnull))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main() -> None:
    """The script."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    import h5py  # noqa: F401  (once, before processes are forked)
    import scipy.sparse  # noqa: F401

    options.out.mkdir(parents=True)
    os.chdir(options.out)
    sources = make_sources(options.out / "sources", _call)
    ends: Counter[str] = Counter()
    for bad in bad_inputs(sources, options.out / "inputs", options.count, options.seed):
        begin = time.monotonic()
        found = run_alone(bad, SECONDS, options.out)
        ends[found.fault or f"exit {found.code}"] += 1
        with (options.out / "outcomes.txt").open("a") as log:
            last = found.err.strip().splitlines()[-1:] or [""]
            log.write(f"{found.fault or found.code}\t{bad.what}\t{last[0]}\n")
        if found.fault or found.code == 0 or time.monotonic() - begin > 15:
            what = f"{found.fault or 'accepted'} ({found.code}, {time.monotonic() - begin:.1f} s): {bad.what}"
            print(f"{what}\n    tsgdd {' '.join(bad.arguments)}\n    {found.err.strip()[-600:]}", flush=True)
    print(dict(ends))


if __name__ == "__main__":
    main()
