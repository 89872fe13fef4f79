"""tsgdd bench tsgfem: the public MATLAB code TsgFEM replayed load step by load step, agreement and time.

A case is an NPZ file of that code's results (tests/data/tsgfem/README.md describes the keys). Its tolerance is an
absolute residual, so each case can also be replayed with TsgFEM's own out-of-balance force as an extra load: under it
TsgFEM's positions are an exact equilibrium.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.structure import from_arrays
from tsg_micro.cells.unit_cell import BAR, EDGE_TENDON
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from tsg_micro.equilibrium.load_path import EquilibriumSolver
from tsg_micro.equilibrium.members import MACRO, MemberSystem
from workflows.store.record import write_summary

__all__ = ["PINNED", "Replay", "bench_tsgfem"]

Array = NDArray[np.float64]

# D-bar may turn freely about x: the y of node 2 (degree of freedom 7) is prescribed as TsgFEM has it.
PINNED = {"dbar_s1_slack0": (7,)}


class Replay:
    """One case of TsgFEM, and our solution of the same load steps."""

    def __init__(self, path: Path, *, pinned: tuple[int, ...] = ()) -> None:
        """``pinned`` degrees of freedom follow TsgFEM's positions."""
        with np.load(path) as data:
            self.data = {key: data[key] for key in data.files}
        data = self.data
        kind = np.full(len(data["members"]), EDGE_TENDON, dtype=np.uint8)
        kind[data["bars"]] = BAR
        self.structure = from_arrays(
            data["nodes"], data["members"], kind=kind, EA=data["E"] * data["A"], rest_length=data["l0"]
        )
        self.slack = int(data["slack_model"]) == 1
        self.fixed = np.zeros(data["nodes"].size, dtype=bool)
        self.fixed[data["fixed_dof"]] = True
        self.pinned = list(pinned)
        self.fixed[self.pinned] = True
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
    curves = {}
    for path in paths:
        replay = Replay(path, pinned=PINNED.get(path.stem, ()))
        begin = time.perf_counter()
        solved = replay.run()
        ours = (time.perf_counter() - begin) / replay.steps
        theirs = float(np.median(replay.data["wall_s"])) / replay.steps
        direct, corrected = replay.errors(*solved), replay.errors(*replay.run(corrected=True))
        curves[path.stem] = (direct, corrected)
        rows[path.stem] = {
            "steps": replay.steps,
            "position_error": direct[0].max(),
            "force_error": direct[1].max(),
            "position_error_with_their_residual": corrected[0].max(),
            "force_error_with_their_residual": corrected[1].max(),
            "seconds_per_step": ours,
            "tsgfem_seconds_per_step": theirs,
        }
        say(
            f"{path.stem}: positions {direct[0].max():.1e}, forces {direct[1].max():.1e} (with TsgFEM's residual as a "
            f"load {corrected[0].max():.1e}, {corrected[1].max():.1e}); {1e3 * ours:.2f} ms a step, "
            f"TsgFEM {1e3 * theirs:.0f} ms"
        )
    _draw(out, curves)
    return write_summary(out, command="bench tsgfem", parameters={"cases": cases}, figures={"replayed": (rows, "1, s")})


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
