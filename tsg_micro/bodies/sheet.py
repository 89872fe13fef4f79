"""One sheet of cells under stretch: the load path of ``tsgdd monolayer``, and what every cell sees of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import box_cells, lattice, side_nodes
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import prestressed
from tsg_micro.cells.structure import Structure
from tsg_micro.continuum.homogenise import cell_gradient
from tsg_micro.continuum.response import cell_displacement, stiffness_under_motion
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver
from tsg_micro.equilibrium.newton import NewtonOptions

__all__ = ["CellStrain", "Sheet", "Stretch", "cell_strain", "histogram_edges", "stretch"]

Array = NDArray[np.float64]
Record = Callable[[int, float, Structure, Equilibrium], None]


@dataclass(frozen=True)
class Sheet:
    """What is stretched."""

    blocks: tuple[int, int]
    """Blocks of 2x2 cells along x and y."""
    layers: int
    """Layers of cells along z."""
    bar_force: float
    """N."""
    parameters: CellParameters
    linear_solver: str = "auto"

    def build(self) -> Structure:
        """The prestressed lattice."""
        cells = box_cells(2 * self.blocks[0], 2 * self.blocks[1], self.layers)
        return prestressed(lattice(cells, self.parameters), self.parameters, self.bar_force)


@dataclass(frozen=True)
class Stretch:
    """A sheet that was stretched; entry 0 of each list is the sheet at rest."""

    sheet: Sheet
    structure: Structure
    final: Equilibrium
    strain: list[float]
    nominal_stress: list[float]
    """Reaction of the top side over the undeformed cross-section, Pa."""
    tangent_modulus: list[float]
    """Derivative of the nominal stress by the strain, from the solver's tangent, Pa."""
    compressed_tendons: list[int]
    """Tendons with a negative force, which would be slack in a model without compression in tendons."""
    negative_pivots: list[int]
    iterations: int
    factorisations: int
    residual: float
    """Largest over the steps."""
    dofs: int

    @property
    def edge_contraction(self) -> float:
        """How far the two free edges across x have moved inwards where they have most, mean of both, m."""
        u = self.final.displacement[:, 0]
        left, right = (side_nodes(self.structure, 0, end=end) for end in ("low", "high"))  # type: ignore[arg-type]
        return float(0.5 * (u[left].max() - u[right].min()))


def stretch(
    sheet: Sheet,
    strains: Sequence[float] | Array,
    *,
    say: Callable[[str], None] = lambda text: None,
    record: Record | None = None,
) -> Stretch:
    """Follow the equilibrium of ``sheet`` through nominal strains (k,); ``record`` sees every step, rest included.

    Every equilibrium is stable: the solver leaves unstable ones downhill.

    Raises:
        ConvergenceError: the equilibrium was lost.
    """
    begin = time.perf_counter()
    structure = sheet.build()
    bottom, top = side_nodes(structure, 1, end="low"), side_nodes(structure, 1, end="high")
    fixed = np.zeros(structure.nodes.shape, dtype=bool)
    fixed[bottom] = fixed[top] = True
    solver = EquilibriumSolver(structure, fixed=fixed, options=NewtonOptions(linear_solver=sheet.linear_solver))
    choice = solver.newton.choice
    say(f"{len(structure.cells)} cells, {solver.newton.pattern.size} unknowns, {choice.backend} ({choice.reason})")
    width, height, thickness = structure.size
    area = float(width * thickness)
    up = np.zeros(structure.nodes.shape)
    up[top, 1] = 1.0
    tendons = ~structure.bars
    states, stress, modulus, compressed = [], [], [], []
    for step, strain in enumerate([0.0, *strains]):
        state = solver.solve(displacement=strain * height * up, stable=True)
        stress.append(float(state.reaction[top, 1].sum()) / area)
        modulus.append(stiffness_under_motion(solver, up) * float(height) / area)
        compressed.append(int((state.members.force[tendons] < 0.0).sum()))
        states.append((state.negative_pivots or 0, state.iterations, state.factorisations, state.residual))
        if record:
            record(step, float(strain), structure, state)
        say(
            f"step {step} of {len(strains)}: strain {strain:.2%}, nominal stress {stress[-1]:.4g} Pa, tangent modulus "
            f"{modulus[-1]:.4g} Pa, {state.iterations} iterations, {compressed[-1]} compressed tendons, "
            f"{time.perf_counter() - begin:.0f} s"
        )
    pivots, iterations, factorisations, residuals = zip(*states, strict=True)
    return Stretch(
        sheet=sheet,
        structure=structure,
        final=state,
        strain=[0.0, *(float(strain) for strain in strains)],
        nominal_stress=stress,
        tangent_modulus=modulus,
        compressed_tendons=compressed,
        negative_pivots=list(pivots),
        iterations=sum(iterations),
        factorisations=sum(factorisations),
        residual=max(residuals),
        dofs=solver.newton.pattern.size,
    )


@dataclass(frozen=True)
class CellStrain:
    """Every cell at the end of the stretch."""

    midpoint: Array
    """Reference midpoints (c, 3), m."""
    displacement: Array
    """Mean displacement of the cell's 24 nodes (c, 3), m."""
    strain: Array
    """Infinitesimal strain sym(H) (c, 3, 3)."""

    def components(self) -> dict[str, Array]:
        """The in-plane strains by name (c,)."""
        return {f"eps_{'xyz'[i]}{'xyz'[j]}": self.strain[:, i, j] for i, j in ((0, 0), (1, 1), (0, 1))}


def histogram_edges(values: Array, bins: int = 40) -> Array:
    """Edges (bins + 1,) of equal bins that hold all values; of values that are all but equal, around them."""
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9:
        low, high = low - 1e-3, high + 1e-3
    return np.linspace(low, high, bins + 1)


def cell_strain(result: Stretch) -> CellStrain:
    """Strain of every cell of the stretched sheet, from its own nodes."""
    structure, u = result.structure, result.final.displacement
    H = cell_gradient(structure, u)
    height = result.sheet.parameters.height
    return CellStrain(
        midpoint=(structure.cells.astype(float) + 0.5) * height,
        displacement=cell_displacement(structure, u),
        strain=0.5 * (H + np.swapaxes(H, 1, 2)),
    )
