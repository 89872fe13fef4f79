"""tsgdd cell: one cell pressed down on a fixed base (paper, Section 3.1), for one bar force or a band of them.

The four nodes of the bottom face are fixed. The force is shared by the four nodes of the top face and points down. The
paper does not say whether the indenter holds the top sideways; by default it does not (``top="free"``), and the top
face turns and shrinks as it sinks. ``top="guided"`` lets its nodes move up and down only; the cell then sinks about a
sixth less.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import box_cells, lattice, side_nodes
from tsg_micro.cells.parameters import CellParameters, check_bar_force
from tsg_micro.cells.prestress import prestressed
from tsg_micro.cells.structure import Structure
from tsg_micro.cells.truncated_octahedron import unit_cell
from tsg_micro.continuum.response import face_rotation, stiffness_under_load
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver
from workflows.store.record import peak_memory, write_summary

__all__ = ["DEFAULT_BAND", "TOPS", "Indentation", "cell", "check_indentation", "indent"]

DEFAULT_BAND = (1e-9, 2e-9, 5e-9, 1e-8, 2e-8, 5e-8)
"""Bar forces f_b, N: the paper prints none, and over this band the sinking changes from a tenth of h to a fiftieth."""
TOPS = ("free", "guided")
_LARGEST_SINKING = 0.03
UNITS = {
    "bar_force": "N",
    "force": "N",
    "displacement": "m",
    "energy": "J",
    "secant_stiffness": "N/m",
    "initial_stiffness": "N/m",
    "tangent_stiffness": "N/m",
    "stiffening": "1",
    "apparent_modulus": "Pa",
    "twist_angle": "degree",
    "residual": "mean member force",
}


@dataclass(frozen=True)
class Indentation:
    """One cell under a rising force; index 0 is the cell at rest."""

    structure: Structure
    bar_force: float
    force: NDArray[np.float64]
    """Downward force (steps + 1,), N."""
    states: tuple[Equilibrium, ...]
    initial_stiffness: float
    """dF/dd at rest, N/m."""
    tangent_stiffness: float
    """dF/dd at the full force, N/m."""
    theta: float
    """Twist of the square faces at rest, rad."""

    @property
    def displacement(self) -> NDArray[np.float64]:
        """Mean downward displacement of the top nodes (steps + 1,), m."""
        top = side_nodes(self.structure, 2, end="high")
        return np.array([0.0 - state.displacement[top, 2].mean() for state in self.states])

    @property
    def twist_angle(self) -> NDArray[np.float64]:
        """Angle in degrees (steps + 1,) between the side faces' diagonals and the axes of the cube, mean of the four.

        15.037 at rest with the default shape. As seen from outside, each face is turned clockwise by that angle.
        """
        sides = [(axis, end) for axis in (0, 1) for end in ("low", "high")]
        turned = [
            np.mean([face_rotation(self.structure, state.displacement, axis=axis, end=end) for axis, end in sides])  # type: ignore[arg-type]
            for state in self.states
        ]
        return np.degrees(self.theta - np.array(turned))

    def figures(self, height: float) -> dict[str, Any]:
        """What the summary says of it."""
        force, depth = float(self.force[-1]), float(self.displacement[-1])
        last = self.states[-1]
        return {
            "bar_force": self.bar_force,
            "force": self.force.tolist(),
            "displacement": self.displacement.tolist(),
            "energy": [state.energy for state in self.states],
            "secant_stiffness": force / depth,
            "initial_stiffness": self.initial_stiffness,
            "tangent_stiffness": self.tangent_stiffness,
            "stiffening": self.tangent_stiffness / self.initial_stiffness,
            "apparent_modulus": force / depth / height,  # (F / h^2) / (d / h)
            "negative_pivots": last.negative_pivots,
            "most_negative_pivots": max(state.negative_pivots or 0 for state in self.states),
            "twist_angle": self.twist_angle.tolist(),
            "compressed_tendons": [
                int((state.members.force[~self.structure.bars] < 0.0).sum()) for state in self.states
            ],
            "residual": max(state.residual for state in self.states),
        }


def check_indentation(force: float, steps: int, top: str) -> None:
    """Raise InputError where the force is not positive, there is no step, or the top is not known."""
    if not (math.isfinite(force) and force > 0.0):
        raise InputError(f"force: expected a positive number in N (it points down), got {force}")
    if steps < 1:
        raise InputError(f"steps: expected at least 1, got {steps}")
    if top not in TOPS:
        raise InputError(f"top: expected {' or '.join(TOPS)}, got {top!r}")


def indent(
    parameters: CellParameters, bar_force: float, forces: Sequence[float] | NDArray[np.float64], *, top: str = "free"
) -> Indentation:
    """Press one cell down with rising ``forces`` (k,), N, from rest.

    In between the force grows by no more than would sink the cell by 3 % of its height if its stiffness stayed as it
    is: at a small bar force the stiffness at rest is so low that a guess along the tangent would turn the cell inside
    out.

    Raises:
        ConvergenceError: the equilibrium was lost, or the top was pushed through the base.
    """
    structure = prestressed(lattice(box_cells(1, 1, 1), parameters), parameters, bar_force)
    loaded = side_nodes(structure, 2, end="high")
    fixed = np.zeros(structure.nodes.shape, dtype=bool)
    fixed[side_nodes(structure, 2, end="low")] = True
    if top == "guided":
        fixed[loaded, :2] = True
    unit = np.zeros(structure.nodes.shape)
    unit[loaded, 2] = -1.0 / len(loaded)
    solver = EquilibriumSolver(structure, fixed=fixed)
    states = [solver.solve(stable=True)]
    initial = stiffness = stiffness_under_load(solver, unit)
    reached = 0.0
    for force in forces:
        state = None
        while state is None or reached < force:
            reached = min(float(force), reached + max(_LARGEST_SINKING * parameters.height * stiffness, 1e-3 * force))
            state = solver.solve(force=reached * unit, stable=True)
            stiffness = stiffness_under_load(solver, unit)
        if -state.displacement[loaded, 2].mean() >= parameters.height:
            raise ConvergenceError(f"cell: a force of {force:.3g} N pushes the top of the cell through its base")
        states.append(state)
    return Indentation(
        structure=structure,
        bar_force=bar_force,
        force=np.append(0.0, forces),
        states=tuple(states),
        initial_stiffness=initial,
        tangent_stiffness=stiffness,
        theta=unit_cell(parameters.half_diagonal).theta,
    )


def cell(
    out: Path,
    *,
    bar_force: Sequence[float] = (),
    force: float = 3e-9,
    steps: int = 30,
    top: str = "free",
    parameters: CellParameters | None = None,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Indent one cell up to ``force`` (N) for every bar force (N), or for DEFAULT_BAND where none is given.

    The summary holds a list ``band`` with the figures of each bar force, and those of a single one at its top too.
    Writes figures, one VTU file per load step with a .pvd that lists them, and summary.json into ``out``.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: the equilibrium was lost.
    """
    parameters = parameters or CellParameters()
    check_indentation(force, steps, top)
    band = tuple(bar_force) or DEFAULT_BAND
    for value in band:
        check_bar_force(value, cells=1, EA_bar=parameters.EA_bar)
    if len(set(band)) != len(band):
        raise InputError(f"bar_force: expected each value once, got {', '.join(f'{f:g}' for f in band)}")
    out = output_folder(out)

    begin = time.perf_counter()
    results = []
    for value in band:
        results.append(indent(parameters, value, force * np.arange(1, steps + 1) / steps, top=top))
        last = results[-1].figures(parameters.height)
        say(
            f"bar force {1e9 * value:g} nN: sinks {1e6 * last['displacement'][-1]:.3f} µm under {1e9 * force:g} nN, "
            f"tangent stiffness {1e3 * last['tangent_stiffness']:.3g} mN/m, {last['negative_pivots']} negative pivots"
        )
    seconds = time.perf_counter() - begin
    figures: dict[str, tuple[Any, str]] = {}
    rows = [result.figures(parameters.height) for result in results]
    if len(rows) == 1:
        figures |= {name: (value, UNITS.get(name, "")) for name, value in rows[0].items()}
    else:
        figures["band_units"] = (UNITS, "")
    figures |= {
        "band": (rows, ""),
        "full_displacement": ([row["displacement"][-1] for row in rows], "m"),
        "twist_angle_at_rest": (math.degrees(results[0].theta), "degree"),
        "seconds": (seconds, "s"),
        "peak_memory": (peak_memory(), "B"),
    }
    summary = write_summary(
        out,
        command="cell",
        parameters={"bar_force": band, "force": force, "steps": steps, "top": top, "cell": asdict(parameters)},
        figures=figures,
    )
    if plots:
        from workflows.runs.cell_figures import draw_cell

        draw_cell(out, results, parameters.height)
    return summary
