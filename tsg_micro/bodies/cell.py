"""One cell pressed down on a fixed base (paper, Section 3.1).

The nodes of the bottom face are fixed. The force is shared by those of the top face and points down. The
paper does not say whether the indenter holds the top sideways; by default it does not (``top="free"``), and the top
face turns and shrinks as it sinks. ``top="guided"`` lets its nodes move up and down only; the cell then sinks about a
sixth less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import side_nodes
from tsg_micro.cells.structure import Structure
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.response import compressed_tendons, face_rotation, stiffness_under_load
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver

__all__ = ["TOPS", "Indentation", "check_top", "indent_cell"]

Array = NDArray[np.float64]
TOPS = ("free", "guided")
_LARGEST_SINKING = 0.03


@dataclass(frozen=True)
class Indentation:
    """One cell under a rising force; index 0 is the cell at rest."""

    tissue: Tissue
    structure: Structure
    force: Array
    """Downward force (steps + 1,), N."""
    states: tuple[Equilibrium, ...]
    initial_stiffness: float
    """dF/dd at rest, N/m."""
    tangent_stiffness: float
    """dF/dd at the full force, N/m."""

    @property
    def theta(self) -> float:
        """Twist of the faces at rest, rad."""
        return self.tissue.unit_cell.theta

    @property
    def displacement(self) -> Array:
        """Mean downward displacement of the top nodes (steps + 1,), m."""
        top = side_nodes(self.structure, 2, end="high")
        return np.array([0.0 - state.displacement[top, 2].mean() for state in self.states])

    @property
    def secant_stiffness(self) -> float:
        """F/d at the full force, N/m."""
        return float(self.force[-1]) / float(self.displacement[-1])

    @property
    def apparent_modulus(self) -> float:
        """(F / h^2) / (d / h) at the full force, Pa."""
        return self.secant_stiffness / self.tissue.cell.height

    @property
    def twist_angle(self) -> Array:
        """Angle in degrees (steps + 1,) between the side faces' diagonals and the axes of the cube, mean of the four.

        15.037 at rest with the default shape. As seen from outside, each face is turned by it: clockwise, but in a cell
        that is a mirror image anticlockwise.
        """
        unit = self.tissue.unit_cell
        x, y, _ = unit.nodes[unit.faces[2][1][0]]
        sense = -1.0 if np.sin(4.0 * np.arctan2(y, x)) > 0.0 else 1.0
        sides = [(axis, end) for axis in (0, 1) for end in ("low", "high")]
        turned = [
            np.mean([face_rotation(self.structure, state.displacement, axis=axis, end=end) for axis, end in sides])  # type: ignore[arg-type]
            for state in self.states
        ]
        return np.degrees(self.theta - sense * np.array(turned))

    @property
    def compressed_tendons(self) -> list[int]:
        """Tendons with a negative force, in every state."""
        return [compressed_tendons(self.structure, state.members) for state in self.states]


def check_top(top: str) -> None:
    """Raise InputError where the top is not known."""
    if top not in TOPS:
        raise InputError(f"top: expected {' or '.join(TOPS)}, got {top!r}")


def indent_cell(tissue: Tissue, forces: Sequence[float] | Array, *, top: str = "free") -> Indentation:
    """Press one cell down with rising ``forces`` (k,), N, from rest.

    In between the force grows by no more than would sink the cell by 3 % of its height if its stiffness stayed as it
    is: at a small bar force the stiffness at rest is so low that a guess along the tangent would turn the cell inside
    out.

    Raises:
        InputError: the top is not known.
        ConvergenceError: the equilibrium was lost, or the top was pushed through the base.

    Example:
        >>> found = tsg.indent_cell(tsg.Tissue(bar_force=1e-8), [1e-9, 2e-9])
        >>> found.displacement.round(8)
        array([0.0e+00, 3.0e-07, 5.6e-07])
    """
    check_top(top)
    structure, height = tissue.box((1, 1, 1)), tissue.cell.height
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
            reached = min(float(force), reached + max(_LARGEST_SINKING * height * stiffness, 1e-3 * force))
            state = solver.solve(force=reached * unit, stable=True)
            stiffness = stiffness_under_load(solver, unit)
        if -state.displacement[loaded, 2].mean() >= height:
            raise ConvergenceError(f"cell: a force of {force:.3g} N pushes the top of the cell through its base")
        states.append(state)
    return Indentation(tissue, structure, np.append(0.0, forces), tuple(states), initial, stiffness)
