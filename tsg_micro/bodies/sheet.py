"""A sheet of cells between two clamped sides: its bottom (y = 0) is fixed, its top is moved as one.

The faces across x and z are free. Strain is the displacement of the top side over the height of the sheet, nominal
stress the force on the top side along its motion over the undeformed cross-section.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import side_nodes
from tsg_micro.cells.structure import Structure
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.response import compressed_tendons, stiffness_under_motion
from tsg_micro.data.errors import InputError
from tsg_micro.equilibrium.linear_solvers import choose_backend
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver
from tsg_micro.equilibrium.members import MACRO, MemberState
from tsg_micro.equilibrium.newton import NewtonOptions

__all__ = [
    "FILL",
    "STRETCH",
    "ClampedSheet",
    "Motion",
    "Sheet",
    "SheetStep",
    "Stretch",
    "memory_needed",
    "stretch_sheet",
]

Array = NDArray[np.float64]
Motion = tuple[float, float, float]
"""Displacement of the top side at strain 1, over the height of the sheet."""
STRETCH: Motion = (0.0, 1.0, 0.0)
FILL = {"pardiso": 1.0, "mumps": 1.1, "superlu": 6.0}
"""Of the factor, over that of PARDISO."""


@dataclass(frozen=True)
class Sheet:
    """What is loaded.

    With ``flat`` the nodes of the mid-plane cannot leave it; by symmetry they need no force for that, so the result is
    an equilibrium of the free sheet too, the one that a model without buckling can be compared with.

    Raises:
        InputError: on construction: a count below 1, an odd number of layers in a flat sheet, or a linear solver that
            is not known or not installed.

    Example:
        >>> sheet = tsg.Sheet((4, 2), tissue=tsg.Tissue(bar_force=1e-8))
        >>> sheet.cells, sheet.unknowns
        ((8, 4, 2), 2592)
    """

    blocks: tuple[int, int]
    """Blocks of 2x2 cells along x and y."""
    layers: int = 2
    """Layers of cells along z."""
    tissue: Tissue = field(default_factory=Tissue)
    flat: bool = False
    linear_solver: str = "auto"

    def __post_init__(self) -> None:
        if min(self.blocks) < 1:
            raise InputError(f"blocks: expected at least 1 along x and y, got {self.blocks[0]} {self.blocks[1]}")
        if self.layers < 1:
            raise InputError(f"layers: expected at least 1, got {self.layers}")
        choose_backend(self.unknowns, self.linear_solver)
        if self.flat and self.layers % 2:
            raise InputError(f"flat: expected an even number of layers, with nodes between them, got {self.layers}")

    @property
    def cells(self) -> tuple[int, int, int]:
        """Cells along x, y, z."""
        return (2 * self.blocks[0], 2 * self.blocks[1], self.layers)

    @property
    def unknowns(self) -> int:
        """Number of free displacements, not flat: those of the faces and inside of the cells, bottom and top held."""
        (nx, ny, nz), unit = self.cells, self.tissue.unit_cell
        x, y, z = (len(low) for low, _ in unit.faces)
        inside = len(unit.nodes) - 2 * (x + y + z)
        return 3 * (inside * nx * ny * nz + x * (nx + 1) * ny * nz + y * nx * (ny - 1) * nz + z * nx * ny * (nz + 1))


def memory_needed(unknowns: int, backend: str) -> int:
    """Estimate of the memory, bytes, that a sheet takes with the linear solver ``backend``.

    With n unknowns 130 MB + n (200 log2 n + 960) B: Python and its libraries, the factor of a sheet in nested
    dissection (measured with PARDISO 2.7, 3.1, 3.3 and 3.8 kB per unknown for 17, 67, 150 and 603 thousand), and the
    60 Lanczos vectors and their modes, 8 B a number, of a sheet that buckles. The fill of MUMPS and of SuperLU beside
    that of PARDISO is measured for 67 thousand.
    """
    return int(130e6 + unknowns * (200.0 * FILL[backend] * math.log2(unknowns) + 960.0))


@dataclass(frozen=True)
class SheetStep:
    """The sheet at one strain."""

    strain: float
    nominal_stress: float
    """Pa."""
    state: Equilibrium


class ClampedSheet:
    """A sheet and where it stands on the path of its load; it begins at rest.

    Every equilibrium is stable: an unstable one is left downhill, so a sheet that buckles does.

    Example:
        >>> sheet = tsg.ClampedSheet(tsg.Sheet((1, 1)))
        >>> round(sheet.load(0.02).nominal_stress, 1)
        19.3
    """

    def __init__(self, sheet: Sheet, motion: Motion = STRETCH) -> None:
        self.sheet = sheet
        self.structure: Structure = sheet.tissue.box(sheet.cells)
        nodes, size = self.structure.nodes, self.structure.size
        bottom, self._top = side_nodes(self.structure, 1, end="low"), side_nodes(self.structure, 1, end="high")
        fixed = np.zeros(nodes.shape, dtype=bool)
        fixed[bottom] = fixed[self._top] = True
        self.middle = np.isclose(nodes[:, 2], 0.5 * (nodes[:, 2].min() + nodes[:, 2].max()), atol=1e-12)
        """Whether a node is in the mid-plane (n,)."""
        self._loose = self.middle & ~fixed[:, 2]
        fixed[self._loose, 2] = sheet.flat
        options = NewtonOptions(linear_solver=sheet.linear_solver)
        self.solver = EquilibriumSolver(self.structure, fixed=fixed, options=options)
        self.height, self.area = float(size[1]), float(size[0] * size[2])
        """Of the sheet along y, m, and of its cross-section, m^2."""
        self._motion = np.zeros(nodes.shape)
        self._motion[self._top] = motion
        self._along = np.array(motion)

    @property
    def dofs(self) -> int:
        """Number of unknowns."""
        return self.solver.newton.pattern.size

    def resume(self, displacement: Array) -> None:
        """Go to an equilibrium (n, 3) that was reached before."""
        self.solver.move_to(np.append(displacement, np.zeros(MACRO)), self.solver.force)

    def load(self, strain: float) -> SheetStep:
        """Follow the equilibrium to ``strain``.

        Raises:
            ConvergenceError: the equilibrium was lost.
        """
        state = self.solver.solve(displacement=strain * self.height * self._motion, stable=True)
        return SheetStep(strain, float((state.reaction[self._top] @ self._along).sum()) / self.area, state)

    def tangent_modulus(self) -> float:
        """Derivative of the nominal stress by the strain, from the solver's tangent, Pa."""
        return stiffness_under_motion(self.solver, self._motion) * self.height / self.area

    @property
    def members(self) -> MemberState:
        """Of all members, where the sheet stands."""
        return self.solver.system.state(self.solver.y)

    def midplane_force(self) -> float:
        """Largest force across the sheet at the nodes of its mid-plane, over the mean member force."""
        system, members = self.solver.system, self.members
        force = system.gradient(members)[: system.nodal_size].reshape(-1, 3)[self._loose, 2]
        return float(np.abs(force).max(initial=0.0) / np.abs(members.force).mean())


class StretchStep(NamedTuple):
    """What is kept of a step of a stretch."""

    strain: float
    nominal_stress: float
    """Pa."""
    tangent_modulus: float
    """Pa."""
    compressed_tendons: int
    negative_pivots: int
    iterations: int
    factorisations: int
    residual: float


@dataclass(frozen=True)
class Stretch:
    """A sheet that was stretched; step 0 is the sheet at rest."""

    sheet: Sheet
    structure: Structure
    steps: list[StretchStep]
    final: Equilibrium
    dofs: int

    def column(self, name: str) -> list[Any]:
        """One field of all steps."""
        return [getattr(step, name) for step in self.steps]

    @property
    def edge_contraction(self) -> float:
        """How far the two free edges across x have moved inwards where they have most, mean of both, m."""
        u = self.final.displacement[:, 0]
        left, right = side_nodes(self.structure, 0, end="low"), side_nodes(self.structure, 0, end="high")
        return float(0.5 * (u[left].max() - u[right].min()))


def stretch_sheet(
    sheet: Sheet,
    strains: Sequence[float] | Array,
    *,
    say: Callable[[str], None] = lambda text: None,
    record: Callable[[int, Structure, Equilibrium], None] = lambda step, structure, state: None,
) -> Stretch:
    """Follow the equilibrium of ``sheet`` from rest through ``strains`` (k,); ``record`` sees rest and every step.

    Raises:
        ConvergenceError: the equilibrium was lost.

    Example:
        >>> found = tsg.stretch_sheet(tsg.Sheet((1, 1)), [0.01, 0.02])
        >>> np.round(found.column("nominal_stress")[1:], 1)
        array([ 9.6, 19.3])
    """
    begin = time.perf_counter()
    body = ClampedSheet(sheet)
    choice = body.solver.newton.choice
    say(f"{len(body.structure.cells)} cells, {body.dofs} unknowns, {choice.backend} ({choice.reason})")
    steps = []
    for number, strain in enumerate([0.0, *map(float, strains)]):
        at = body.load(strain)
        state, compressed = at.state, compressed_tendons(body.structure, at.state.members)
        how = (state.negative_pivots or 0, state.iterations, state.factorisations, state.residual)
        step = StretchStep(strain, at.nominal_stress, body.tangent_modulus(), compressed, *how)
        steps.append(step)
        record(number, body.structure, state)
        say(
            f"step {number} of {len(strains)}: strain {strain:.2%}, nominal stress {step.nominal_stress:.4g} Pa, "
            f"tangent modulus {step.tangent_modulus:.4g} Pa, {step.iterations} iterations, "
            f"{compressed} compressed tendons, {time.perf_counter() - begin:.0f} s"
        )
    return Stretch(sheet, body.structure, steps, state, body.dofs)
