"""tsgdd bench accuracy: how far default answers are from the full tensegrity, on a family of scenes, and why.

Each sheet is solved by adaptive data with default options, and by every bar and tendon, held flat. What is left between
them is taken apart: the data (the same model with an RVE at every point, FE2), the elements (against a mesh of half
their size), and the rest, which is the scale: a continuum of blocks, and its edges. All of it for the inner blocks,
the clamped rows, the free columns, and all blocks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_law import RVELaw
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from tsg_micro.data.mandel import pressure, von_mises
from workflows.runs.adaptation import rve_of, source_for
from workflows.runs.edges import in_parts, specs_of
from workflows.runs.loads import LOADS
from workflows.runs.scene import Scene
from workflows.runs.tensegrity import read_blocks
from workflows.store.record import read_summary, write_summary, write_table
from workflows.store.stages import Stages

__all__ = ["CASES", "ZONES", "Case", "accuracy"]

Array = NDArray[np.float64]
MEASURE = "first_piola"
ZONES = ("inner", "rows", "columns", "all")
"""Inner blocks, the two rows at the clamps, the two columns at the free sides without those rows, and all of them."""
_INVARIANTS = {"p": pressure, "q": von_mises}


@dataclass(frozen=True)
class Case:
    """A sheet of ``blocks`` along x and y whose bars carry ``bar_force`` (N) at rest, under 5 % of ``load``."""

    blocks: tuple[int, int]
    load: str
    bar_force: float
    strain: float = 0.05

    @property
    def name(self) -> str:
        """In words."""
        return f"{self.blocks[0]}x{self.blocks[1]} {self.load} {1e9 * self.bar_force:g} nN"

    @property
    def tissue(self) -> Tissue:
        """Its cells."""
        return Tissue(bar_force=self.bar_force)

    def dns(self, stages: Stages, say: Callable[[str], None]) -> Path:
        """The folder of the full tensegrity; computed unless it is there."""
        from workflows.runs.dns import dns

        run: dict[str, Any] = {"blocks": self.blocks, "load": self.load, "strain": self.strain, "flat": True}
        name = "-".join(["dns", *self.name.split()])
        solve = partial(dns, **run, tissue=self.tissue, plots=False, say=say)
        return stages.run(name, {**run, "bar_force": self.bar_force}, solve)


CASES = (
    Case((16, 8), "stretch", 2e-9),
    Case((16, 8), "shear", 5e-8),
    Case((24, 16), "stretch", 2e-8),
    Case((12, 20), "stretch", 1e-8),
    Case((12, 20), "shear", 1e-8),
    Case((24, 8), "shear", 5e-9),
    Case((20, 20), "stretch", 5e-8),
    Case((60, 30), "stretch", 1e-8),
    Case((60, 30), "shear", 1e-8),
)
"""Sizes, loads and prestresses unlike one another; the last two are the paper's."""


def accuracy(
    out: Path,
    *,
    cases: Sequence[Case] = CASES,
    options: Mapping[str, Any] | None = None,
    parts: bool = True,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Errors of p (stretch) or q (shear) of every case; accuracy.csv has a row for each case and zone.

    ``options`` are those of the macroscopic scene that differ from the defaults. Without ``parts`` the error is not
    taken apart, which saves FE2 and the fine mesh. Full tensegrities are stages, which a later run finds there.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: a full tensegrity did not converge.
    """
    if not cases:
        raise InputError("cases: expected at least one, got none")
    scenes = {case: _scene(case, options or {}) for case in cases}  # bad options come first
    stages = Stages(output_folder(out), say)
    rows: list[dict[str, Any]] = []
    for case, scene in scenes.items():
        dns = case.dns(stages, say)
        for row in _rows(case, scene, dns, parts=parts):
            rows.append(row)
            if row["zone"] in ("inner", "all"):
                shown = row["note"] if row["error"] is None else f"{row['error']:.2%}"
                say(f"{case.name:24} {row['zone']:6} {row['symbol']}: {shown}, {row['seconds']:.2f} s")
        write_table(out / "accuracy.csv", rows)
    first = next(iter(scenes.values())).parameters()
    model = {name: first[name] for name in ("kinematics", "clamp", "degree", "element", "flat", "edges")}
    worst = {zone: max(row["error"] or 0.0 for row in rows if row["zone"] == zone) for zone in ZONES}
    summary = write_summary(
        out,
        command="bench accuracy",
        parameters={"cases": [asdict(case) for case in cases], **model, "parts": parts},
        figures={
            "rows": (rows, "errors relative, times s"),
            "worst": (worst, "1"),
            "failed": ([row["case"] for row in rows if row["error"] is None and row["zone"] == "all"], ""),
        },
    )
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.accuracy_figure import plot_accuracy

        save_figure(plot_accuracy(rows, model), out / "accuracy.png")
    return summary


def _scene(case: Case, options: Mapping[str, Any]) -> Scene:
    """Default options; a sheet that could buckle, in finite strain, is held flat as the full tensegrity is."""
    held = {"flat": options.get("kinematics") == "finite"}
    return Scene(case.load, case.strain, elements=(*case.blocks, 1), **{**held, **options})


def _rows(case: Case, scene: Scene, dns: Path, *, parts: bool) -> list[dict[str, Any]]:
    """A row for every zone; errors None where the solve failed, with the reason."""
    blocks = read_blocks(dns, MEASURE)
    assert blocks.midpoint is not None
    place = _grid(blocks.midpoint, case)
    true = np.empty_like(blocks.stress)
    true[place] = blocks.stress
    symbol = LOADS[case.load].symbol
    full = float(read_summary(dns, "dns")["seconds"])
    named: dict[str, Any] = {"case": case.name, "symbol": symbol}
    begin = time.perf_counter()
    try:
        solution = _adaptive(case, scene)
        times = {"seconds": time.perf_counter() - begin, "dns_seconds": full, "note": ""}
        states = {"true": true, "ours": _block_stress(case, solution)}
        rves = solution.rounds[-1].rves
        if parts:
            states["exact"] = _block_stress(case, _fe2(case, scene))
            states["fine"] = _block_stress(case, _adaptive(case, replace(scene, refine=2)))
    except ConvergenceError as error:
        none = {**dict.fromkeys(("error", "data", "element", "rest", "rves")), "seconds": time.perf_counter() - begin}
        return [{**named, "zone": zone, **none, "dns_seconds": full, "note": str(error)} for zone in ZONES]
    values = {name: _INVARIANTS[symbol](stress) for name, stress in states.items()}
    pairs = {
        "error": ("ours", "true"),
        "data": ("ours", "exact"),
        "element": ("ours", "fine"),
        "rest": ("fine", "true"),
    }
    rows = []
    for zone, here in _zones(case).items():
        size = np.linalg.norm(values["true"][here])
        errors = {
            name: float(np.linalg.norm((values[a] - values[b])[here]) / size) if a in values and b in values else None
            for name, (a, b) in pairs.items()
        }
        rows.append({**named, "zone": zone, **errors, "rves": rves, **times})
    return rows


def _adaptive(case: Case, scene: Scene) -> dd.AdaptiveResult:
    """Adaptive data from nothing, with default numbers."""
    problem, specs = _problem(case, scene)
    parts = [dd.Material(source=source_for(scene, one, problem)) for one in specs]
    return dd.AdaptiveMethod().prepare(problem, in_parts(parts)).solve()


def _fe2(case: Case, scene: Scene) -> dd.Solution:
    """The same with an RVE at every quadrature point."""
    problem, specs = _problem(case, scene)
    parts = [dd.Material(law=RVELaw(one.build())) for one in specs]
    return dd.LawMethod().prepare(problem, in_parts(parts)).solve()


def _problem(case: Case, scene: Scene) -> tuple[dd.Problem, tuple[RVESpec, ...]]:
    """The problem, and the RVE of each of its regions."""
    inside = rve_of(case.tissue, None)
    problem = scene.problem(MPI.COMM_SELF, case.tissue, inside)
    return problem, specs_of(inside, problem)


def _grid(midpoint: Array, case: Case) -> NDArray[np.int64]:
    """Number of the block, column by column, at each midpoint (n, 3)."""
    index = np.floor(midpoint[:, :2] / case.tissue.block).astype(np.int64)
    return np.asarray(index[:, 0] * case.blocks[1] + index[:, 1])


def _block_stress(case: Case, solution: dd.Solution) -> Array:
    """Mean stress (blocks, 6) of the elements of every block, Pa, column by column."""
    operator, shown = solution.problem.operator, dd.in_space(solution, MEASURE)
    block = _grid(operator.cell_corners.mean(axis=1), case)
    volume = operator.weights.reshape(len(block), -1).sum(axis=1)
    mean = operator.cell_mean(shown.mechanical.stress) * volume[:, None]
    total = np.zeros((case.blocks[0] * case.blocks[1], 6))
    np.add.at(total, block, mean)
    return total / np.bincount(block, volume)[:, None]


def _zones(case: Case) -> dict[str, NDArray[np.bool_]]:
    """Which blocks are in which zone."""
    nx, ny = case.blocks
    i, j = np.divmod(np.arange(nx * ny), ny)
    rows, sides = (j == 0) | (j == ny - 1), (i == 0) | (i == nx - 1)
    return dict(zip(ZONES, (~rows & ~sides, rows, sides & ~rows, np.ones(nx * ny, dtype=bool)), strict=True))
