"""Kills at random moments, and full disks: what is on the disk afterwards is whole, of one run, and loses no work.

As a script, which takes minutes: ``python tests/workflows/cli/kills.py --kills 100 --disks 20 --out FOLDER``. Disks are
full at a random size of a file; where small disks can be mounted, they are that as well.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py

from dd_macro import read_quadrature
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.errors import InputError

DATA = Path(__file__).parents[2] / "data" / "cases" / "hdf5" / "stretch_data.h5"
PROGRAM = (sys.executable, "-c", "from workflows.cli import main; main()")
ZERO = "eps_xx,eps_zz,eps_yz,eps_xz,eps_xy,sigma_xx,sigma_zz,sigma_yz,sigma_xz,sigma_xy"


@dataclass(frozen=True)
class Scene:
    """A command that writes over what ``first`` made: ``again`` is ended, ``check`` finds what is wrong then."""

    name: str
    first: Callable[[Path], tuple[object, ...]]
    again: Callable[[Path, int], tuple[object, ...]]
    check: Callable[[Path, Path], str]
    """Of the folder after the end of the command, and of the folder before it."""


def _solve(folder: Path, metric: str) -> tuple[object, ...]:
    scene = ("--elements", 3, 3, 1, "--metric", metric, "--no-plots")
    return ("solve", "--data", DATA, *scene, "--out", folder / "O")


def _sample(folder: Path, seed: int) -> tuple[object, ...]:
    size = ("--paths", 12, "--steps", 8, "--processes", 1, "--no-plots", "--seed", seed)
    return ("sample", "--append", *size, "--out", folder / "d.h5")


def _dns(folder: Path, strain: float) -> tuple[object, ...]:
    return ("dns", "--blocks", 3, 3, "--steps", 6, "--strain", strain, "--no-plots", "--out", folder / "O")


def _import(folder: Path, rows: int) -> tuple[object, ...]:
    csv = folder / f"m{rows}.csv"
    if not csv.exists():
        csv.write_text("e,s\n" + "".join(f"{i * 1e-6},{i}\n" for i in range(rows)))
    columns = ("--column", "eps_yy=e:1", "--column", "sigma_yy=s:Pa", "--zero", ZERO)
    return ("import-csv", csv, *columns, "--out", folder / "m.h5")


def _opens(path: Path) -> str:
    """What is wrong with a file that is there."""
    if path.name.startswith("."):
        return ""  # of a write that was cut; the next start removes it
    try:
        if path.suffix == ".json":
            json.loads(path.read_text())
        elif path.name == "quadrature.h5":
            read_quadrature(path)
        elif path.name in ("d.h5", "m.h5"):
            read_dataset(path)
        elif path.suffix in (".h5", ".vtkhdf"):
            with h5py.File(path) as file:
                file.visititems(lambda name, item: item[()].size if isinstance(item, h5py.Dataset) else None)
        elif path.suffix == ".png":
            assert path.read_bytes().endswith(b"IEND\xaeB`\x82")
        elif path.suffix in (".vtu", ".pvd"):
            assert path.read_text().rstrip().endswith("</VTKFile>")
    except (InputError, OSError, ValueError, AssertionError, UnicodeDecodeError) as error:
        return f"corrupt {path.name}: {error}"
    return ""


def _whole(folder: Path) -> str:
    return next((text for path in sorted(folder.rglob("*")) if path.is_file() and (text := _opens(path))), "")


def _check_solve(after: Path, before: Path) -> str:
    """A summary stands beside the fields of its own run alone."""
    summary, fields = after / "O" / "summary.json", after / "O" / "quadrature.h5"
    if not summary.exists():
        return _whole(after)
    said = json.loads(summary.read_text())["normalised_distance"]
    found = read_quadrature(fields).normalised_distance if fields.exists() else None
    return _whole(after) if found == said else f"mixed: the summary says {said}, the fields {found}"


def _check_sample(after: Path, before: Path) -> str:
    """All that was in the file is, and all of the new paths or none; a summary says how many."""
    if text := _whole(after):
        return text
    old, new = read_dataset(before / "d.h5"), read_dataset(after / "d.h5")
    seeds = [source["seed"] for source in old.sources]
    if [source["seed"] for source in new.sources][: len(seeds)] != seeds or len(new) < len(old):
        return "lost: data that were in the file"
    summary = after / "d.summary.json"
    if summary.exists() and json.loads(summary.read_text())["points_in_file"] != len(new):
        return "mixed: the summary counts other points than the file holds"
    return ""


def _check_dns(after: Path, before: Path) -> str:
    """A summary stands beside data of its own strain."""
    if text := _whole(after):
        return text
    summary = after / "O" / "summary.json"
    if summary.exists():
        strain = json.loads(summary.read_text())["parameters"]["strain"]
        data = after / "O" / "data.h5"
        if data.exists() and read_dataset(data).parameters.get("strain", strain) != strain:
            return "mixed: summary and data of different strains"
    return ""


def _check_import(after: Path, before: Path) -> str:
    if text := _whole(after):
        return text
    count, summary = len(read_dataset(after / "m.h5")), after / "m.summary.json"
    if count not in (40, 4000):
        return f"lost: {count} points"
    if summary.exists() and json.loads(summary.read_text())["points"] != count:
        return "mixed: the summary counts other points than the file holds"
    return ""


SCENES = (
    Scene("solve", lambda f: _solve(f, "auto"), lambda f, k: _solve(f, ("secant", "tangent")[k % 2]), _check_solve),
    Scene("sample --append", lambda f: _sample(f, 0), lambda f, k: _sample(f, 1 + k), _check_sample),
    Scene("dns", lambda f: _dns(f, 0.02), lambda f, k: _dns(f, (0.03, 0.04)[k % 2]), _check_dns),
    Scene("import-csv", lambda f: _import(f, 40), lambda f, k: _import(f, 4000), _check_import),
)


def run(arguments: tuple[object, ...], **more: object) -> subprocess.Popen[bytes]:
    """Start the command line with ``arguments``; in a session of its own, stderr kept."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "start_new_session": True}
    return subprocess.Popen([*PROGRAM, *map(str, arguments)], **(quiet | more))  # type: ignore[call-overload, no-any-return]


def prepare(scene: Scene, folder: Path) -> float:
    """Make what is to be written over, and measure how long the command takes, in s."""
    folder.mkdir(parents=True)
    for k, arguments in enumerate((scene.first(folder), scene.again(folder, 10**6), scene.first(folder))):
        if k == 1:
            copy = folder.with_name(f"{folder.name}-copy")
            shutil.copytree(folder, copy)
            arguments = scene.again(copy, 10**6)
        if k == 2:
            break
        begin = time.monotonic()
        process = run(arguments)
        _, err = process.communicate(timeout=300)
        assert process.returncode == 0, err.decode()
    return time.monotonic() - begin


def kill_once(scene: Scene, start: Path, folder: Path, delay: float, number: int) -> str:
    """Write over a copy of ``start`` in ``folder``, kill that after ``delay`` s: what is wrong with what is there."""
    shutil.copytree(start, folder)
    process = run(scene.again(folder, number), stderr=subprocess.DEVNULL)
    try:
        process.wait(delay)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    return scene.check(folder, start)


def finish(scene: Scene, folder: Path, number: int) -> str:
    """The same command again ends well, and leaves no temporary file."""
    process = run(scene.again(folder, number))
    _, err = process.communicate(timeout=300)
    again = b"expected another than that of the data" in err  # all of it was there already
    if process.returncode != 0 and not again:
        return f"not gone on from: {err.decode()[-300:]}"
    left = [path.name for path in folder.rglob(".*") if not path.name.endswith(".lock") and path.is_file()]
    return f"left over: {left}" if left and not again else ""


def full_disk(scene: Scene, start: Path, folder: Path, room: int, number: int) -> str:
    """Write over a copy of ``start`` where a file may have ``room`` bytes: one line, exit 1, and nothing lost."""
    shutil.copytree(start, folder)

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    # MPI maps files of some MB when it starts, which are no output
    process = run(scene.again(folder, number), preexec_fn=None if scene.name == "solve" else limit)
    _, err = process.communicate(timeout=300)
    return _judge_disk(process.returncode, err.decode()) or scene.check(folder, start)


def mounted_disk(scene: Scene, start: Path, folder: Path, room: int, number: int) -> str:
    """The same on a disk with ``room`` bytes left, which is mounted for it."""
    folder.mkdir()
    used = sum(-(-path.stat().st_size // 4096) * 4096 for path in start.rglob("*") if path.is_file())
    size = used + room + 16 * 4096
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], check=True)
    try:
        shutil.copytree(start, folder, dirs_exist_ok=True)
        process = run(scene.again(folder, number))
        _, err = process.communicate(timeout=300)
        return _judge_disk(process.returncode, err.decode()) or scene.check(folder, start)
    finally:
        subprocess.run(["umount", folder], check=True)


def _judge_disk(code: int, err: str) -> str:
    lines = [line for line in err.replace("\r", "\n").splitlines() if line.startswith("tsgdd: ")]
    if code == 0:
        return ""  # there was room
    if code != 1 or len(lines) != 1 or "Traceback" in err or "defect" in err:
        return f"exit {code}: {err[-300:]}"
    return ""


def can_mount(folder: Path) -> bool:
    """Whether this user may mount a small disk."""
    folder.mkdir(parents=True, exist_ok=True)
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder], capture_output=True, check=False)
    if made.returncode == 0:
        subprocess.run(["umount", folder], check=True)
    return made.returncode == 0


def main() -> None:
    """The script."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--disks", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    rng = random.Random(options.seed)
    options.out.mkdir(parents=True)
    takes = {scene.name: prepare(scene, options.out / scene.name.split()[0]) for scene in SCENES}
    print({name: round(seconds, 2) for name, seconds in takes.items()}, flush=True)
    ends: Counter[str] = Counter()
    for k in range(options.kills):
        scene = SCENES[k % len(SCENES)]
        start, folder = options.out / scene.name.split()[0], options.out / f"kill{k}"
        delay = takes[scene.name] * rng.uniform(0.2, 1.05)
        fault = kill_once(scene, start, folder, delay, k) or finish(scene, folder, k) or scene.check(folder, start)
        ends[fault.split()[0] if fault else "well"] += 1
        if fault:
            print(f"kill {k}, {scene.name} after {delay:.2f} s: {fault}", flush=True)
        shutil.rmtree(folder)
    print("kills", dict(ends), flush=True)
    ends.clear()
    mount = can_mount(options.out / "mount")
    for k in range(options.disks):
        scene = SCENES[k % len(SCENES)]
        start, folder = options.out / scene.name.split()[0], options.out / f"disk{k}"
        room = int(10 ** rng.uniform(2.5, 5.5))
        fill = mounted_disk if mount and (k % 8 < 4 or scene.name == "solve") else full_disk
        fault = fill(scene, start, folder, room, k)
        ends[fault.split()[0] if fault else "well"] += 1
        if fault:
            print(f"disk {k}, {scene.name}, {room} bytes: {fault}", flush=True)
        shutil.rmtree(folder)
    print("full disks", dict(ends), f"({'mounted and ' if mount else ''}limited)", flush=True)


if __name__ == "__main__":
    main()
