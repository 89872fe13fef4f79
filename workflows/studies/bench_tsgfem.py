"""tsgdd bench tsgfem: the public MATLAB code TsgFEM replayed load step by load step, agreement and time.

A case is an NPZ file of that code's results (tests/data/tsgfem/README.md describes the keys). Its tolerance is an
absolute residual, so each case can also be replayed with TsgFEM's own out-of-balance force as an extra load: under it
TsgFEM's positions are an exact equilibrium.
"""

from __future__ import annotations

import dataclasses
import time
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from tsg_micro.cells.structure import from_arrays
from tsg_micro.cells.unit_cell import BAR, EDGE_TENDON
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import check_regular, output_folder
from tsg_micro.equilibrium.load_path import EquilibriumSolver
from tsg_micro.equilibrium.members import MACRO, MemberSystem
from workflows.store.record import write_summary

__all__ = ["PINNED", "Agreement", "Replay", "bench_tsgfem"]

Array = NDArray[np.float64]

# D-bar may turn freely about x: the y of node 2 (degree of freedom 7) is prescribed as TsgFEM has it.
PINNED = {"dbar_s1_slack0": (7,)}


@dataclass(frozen=True)
class Agreement:
    """How two solutions of a case differ in their worst load step."""

    position: float
    """Largest difference of positions over the size."""
    force: float
    """Largest difference of member forces over the step's largest."""
    energy: float
    """Difference of stored energy, relative."""
    sorted_force: float
    """As ``force``, of the forces in rising order: blind to which member of a symmetric structure has which."""

    @property
    def mirrored(self) -> bool:
        """They are images of each other on the two branches of a symmetric bifurcation: same energy, same forces."""
        return self.force > 1e-4 and self.sorted_force < 1e-6 and self.energy < 1e-6


class Replay:
    """One case of TsgFEM, and our solution of the same load steps."""

    def __init__(self, path: Path, *, pinned: tuple[int, ...] = ()) -> None:
        """``pinned`` degrees of freedom follow TsgFEM's positions; of a body free in space, six that hold it."""
        self.data = data = _read_case(path)
        kind = np.full(len(data["members"]), EDGE_TENDON, dtype=np.uint8)
        kind[data["bars"]] = BAR
        self.structure = from_arrays(
            data["nodes"], data["members"], kind=kind, EA=data["E"] * data["A"], rest_length=data["l0"]
        )
        self.slack = int(data["slack_model"]) == 1
        self.fixed = np.zeros(data["nodes"].size, dtype=bool)
        self.fixed[data["fixed_dof"]] = True
        self.fixed[list(pinned)] = True
        free = [] if self.fixed.any() else _rigid_holds(data["nodes"])
        self.pinned = [*pinned, *free]
        self.fixed[free] = True
        self.size = float(np.ptp(data["nodes"], axis=0).max())
        self.steps = len(data["pos_steps"])

    def out_of_balance(self, step: int) -> Array:
        """The force (3n,) that TsgFEM's positions lack for equilibrium, as our gradient sees it."""
        at = dataclasses.replace(self.structure, rest_length=self.data["l0_steps"][step])
        system = MemberSystem(at, slack=self.slack)
        u = (self.data["pos_steps"][step] - self.structure.nodes).ravel()
        missing = system.gradient(system.state(np.append(u, np.zeros(MACRO))))[:-MACRO] - self.data["load_steps"][step]
        return np.where(self.fixed, 0.0, missing)

    def run(self, *, corrected: bool = False) -> tuple[Array, Array]:
        """Positions (K, n, 3) and member forces (K, m), every step from the one before."""
        shape = self.structure.nodes.shape
        positions, forces, reached = [], [], None
        for step in range(self.steps):
            at = dataclasses.replace(self.structure, rest_length=self.data["l0_steps"][step])
            solver = EquilibriumSolver(at, fixed=self.fixed.reshape(shape), slack=self.slack)
            if reached:
                solver.move_to(*reached)
            u = np.zeros(self.fixed.size)
            u[self.data["fixed_dof"]] = self.data["prescribed_disp_steps"][step]
            u[self.pinned] = (self.data["pos_steps"][step] - self.structure.nodes).ravel()[self.pinned]
            load = self.data["load_steps"][step] + (self.out_of_balance(step) if corrected else 0.0)
            result = solver.solve(displacement=u.reshape(shape), force=load.reshape(shape))
            reached = solver.y, solver.force
            positions.append(self.structure.nodes + result.displacement)
            forces.append(result.members.force)
        return np.array(positions), np.array(forces)

    def errors(self, positions: Array, forces: Array) -> tuple[Array, Array]:
        """By step (K,): largest difference of positions over the size, of forces over the step's largest force."""
        away = np.abs(positions - self.data["pos_steps"]).max(axis=(1, 2)) / self.size
        largest = np.abs(self.data["force_steps"]).max(axis=1)
        return away, np.abs(forces - self.data["force_steps"]).max(axis=1) / largest

    def agreement(self, positions: Array, forces: Array) -> Agreement:
        """What positions (K, n, 3) and member forces (K, m) have in common with TsgFEM's, on whichever branch."""
        theirs = self.data["force_steps"]
        largest = np.abs(theirs).max(axis=1, keepdims=True)
        in_order = np.abs(np.sort(forces, axis=1) - np.sort(theirs, axis=1)) / largest
        per_force = self.data["l0_steps"] / self.structure.EA
        ours, other = ((per_force * f**2).sum(axis=1) for f in (forces, theirs))
        away, force = (float(values.max()) for values in self.errors(positions, forces))
        return Agreement(away, force, float((np.abs(ours - other) / other).max()), float(in_order.max()))


def _rigid_holds(nodes: Array) -> list[int]:
    """Six degrees of freedom that hold the rigid motions of a body, and do so best."""
    x = nodes - nodes.mean(axis=0)
    turns = np.cross(np.eye(3)[:, None], x[None] / np.abs(x).max()).reshape(3, -1)
    return [int(i) for i in qr(np.vstack([np.tile(np.eye(3), len(x)), turns]), pivoting=True, mode="r")[1][:6]]


def _read_case(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a case, by name.

    Raises:
        InputError: the file cannot be read, or an array is missing or of another shape.
    """
    try:
        check_regular(path)
        with np.load(path) as stored:
            data = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, LookupError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise InputError(f"case {path}: expected results of TsgFEM (NPZ), they cannot be read ({error})") from None
    steps, nodes, members = (len(data.get(name, ())) for name in ("pos_steps", "nodes", "members"))
    shapes: dict[str, tuple[int, ...]] = {"nodes": (nodes, 3), "members": (members, 2), "pos_steps": (steps, nodes, 3)}
    shapes |= dict.fromkeys(("E", "A", "l0"), (members,)) | dict.fromkeys(("force_steps", "l0_steps"), (steps, members))
    shapes |= {"load_steps": (steps, 3 * nodes), "prescribed_disp_steps": (steps, len(data.get("fixed_dof", ())))}
    shapes |= dict.fromkeys(("bars", "fixed_dof", "slack_model", "wall_s"), (-1,))
    for name, shape in shapes.items():
        if name not in data or (shape != (-1,) and data[name].shape != shape) or not steps:
            found = data[name].shape if name in data else "none"
            raise InputError(f"case {path}: expected the array {name}, of shape {shape}, got {found}")
    for name, most in (("bars", members), ("fixed_dof", 3 * nodes)):
        data[name] = data[name].astype(np.int64)  # none of them is an empty array of doubles
        if data[name].size and (data[name].min() < 0 or data[name].max() >= most):
            raise InputError(f"case {path}: expected {name} from 0 to {most - 1}, got others")
    return data


def bench_tsgfem(out: Path, *, cases: Path, say: Callable[[str], None] = lambda text: None) -> dict[str, Any]:
    """Replay every case in the folder ``cases``; agreement by step, and our time a step beside TsgFEM's.

    Raises:
        InputError: there is no case in the folder.
    """
    paths = sorted(cases.glob("*.npz"))
    if not paths:
        raise InputError(f"cases: expected a folder of TsgFEM results (NPZ), got {cases} with none")
    out = output_folder(out)
    rows: dict[str, dict[str, Any]] = {}
    failed: dict[str, str] = {}
    curves = {}
    first: Exception | None = None
    for path in paths:
        try:
            rows[path.stem], curves[path.stem] = _replay(path)
        except (InputError, ConvergenceError) as error:  # costs this case alone
            failed[path.stem], first = str(error), first or error
            say(f"{path.stem}: failed: {error}")
        else:
            say(f"{path.stem}: {_in_words(rows[path.stem])}")
    if first is not None and not rows:
        raise first
    _draw(out, curves)
    figures = {"replayed": (rows, "1, s"), "failed": (failed, "")}
    return write_summary(out, command="bench tsgfem", parameters={"cases": cases}, figures=figures)


def _replay(path: Path) -> tuple[dict[str, Any], tuple[tuple[Array, Array], tuple[Array, Array]]]:
    """Figures of one case, and its differences by step, without and with TsgFEM's residual as a load."""
    replay = Replay(path, pinned=PINNED.get(path.stem, ()))
    begin = time.perf_counter()
    solved = replay.run()
    ours = (time.perf_counter() - begin) / replay.steps
    direct, agreement = replay.errors(*solved), replay.agreement(*solved)
    corrected = replay.errors(*replay.run(corrected=True))
    row = {
        "steps": replay.steps,
        "position_error": direct[0].max(),
        "force_error": direct[1].max(),
        "position_error_with_their_residual": corrected[0].max(),
        "force_error_with_their_residual": corrected[1].max(),
        "energy_error": agreement.energy,
        "sorted_force_error": agreement.sorted_force,
        "mirrored": agreement.mirrored,
        "seconds_per_step": ours,
        "tsgfem_seconds_per_step": float(np.median(replay.data["wall_s"])) / replay.steps,
    }
    return row, (direct, corrected)


def _in_words(row: dict[str, Any]) -> str:
    mirrored = (
        f"the mirrored branch of a symmetric bifurcation, its energy {row['energy_error']:.1e} and its forces in "
        f"rising order {row['sorted_force_error']:.1e} off; "
    )
    return (
        f"{mirrored if row['mirrored'] else ''}positions {row['position_error']:.1e}, forces {row['force_error']:.1e} "
        f"(with TsgFEM's residual as a load {row['position_error_with_their_residual']:.1e}, "
        f"{row['force_error_with_their_residual']:.1e}); {1e3 * row['seconds_per_step']:.2f} ms a step, "
        f"TsgFEM {1e3 * row['tsgfem_seconds_per_step']:.0f} ms"
    )


def _draw(out: Path, curves: dict[str, tuple[tuple[Array, Array], tuple[Array, Array]]]) -> None:
    """Differences of positions and forces, step by step."""
    import matplotlib as mpl

    from tsg_micro.data.figure_style import STYLE, new_figure, save_figure

    with mpl.rc_context(STYLE):
        figure = new_figure(12, 4.6)
        panels = figure.subplots(1, 2, sharey=True)
        for kind, axes in enumerate(panels):
            for number, (name, pair) in enumerate(curves.items()):
                for errors, style, note in zip(pair, ("-", ":"), ("", ", with its residual as a load"), strict=True):
                    shown = np.maximum(errors[kind], 1e-17)
                    fraction = np.arange(1, len(shown) + 1) / len(shown)
                    axes.semilogy(fraction, shown, style, color=f"C{number}", label=name.split("_")[0] + note)
            axes.set_xlabel("fraction of the load steps")
            axes.grid(color="0.92", linewidth=0.8)
        panels[0].set_ylabel("largest difference to TsgFEM")
        panels[0].set_title("positions, over the structure's size")
        panels[1].set_title("member forces, over the largest")
        panels[1].legend(fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        save_figure(figure, out / "tsgfem.png")
