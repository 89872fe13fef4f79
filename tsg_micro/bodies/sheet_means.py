"""A loaded sheet as a continuum: means over its blocks as data sets, their balance, and the strain of every cell."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.bodies.sheet import Motion, Stretch
from tsg_micro.cells.structure import Structure
from tsg_micro.continuum.homogenise import BlockFields, cell_gradient
from tsg_micro.continuum.response import cell_displacement
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.mandel import to_mandel

__all__ = ["CellStrain", "block_data", "block_displacement", "cell_strain", "histogram_edges", "row_balance"]

Array = NDArray[np.float64]


def block_data(
    blocks: BlockFields, *, parameters: Mapping[str, Any], versions: Mapping[str, str]
) -> tuple[Dataset, Dataset]:
    """The block means as data sets of first Piola and of Kirchhoff stress.

    Each is a mean of its own over the members; for a block under varying F neither follows exactly from the other.
    """
    first_piola = Dataset(
        strain=to_mandel(blocks.F - np.eye(3)),
        stress=to_mandel(blocks.first_piola),
        stress_measure="first_piola",
        path=np.arange(len(blocks.F)),
        step=np.zeros(len(blocks.F), dtype=np.int64),
        deformation_gradient=blocks.F,
        midpoint=blocks.midpoint,
        parameters=dict(parameters),
        versions=dict(versions),
    )
    kirchhoff = dataclasses.replace(first_piola, stress=to_mandel(blocks.kirchhoff), stress_measure="kirchhoff")
    return first_piola, kirchhoff


def block_displacement(structure: Structure, displacement: Array) -> Array:
    """Mean displacement (b, 3) of the nodes of every block, from that of the nodes (n, 3), m."""
    of_cells = displacement[structure.cell_nodes].mean(axis=1)
    cells = np.bincount(structure.cell_block)
    sums = [np.bincount(structure.cell_block, weights=column) for column in of_cells.T]
    return np.column_stack(sums) / cells[:, None]


def row_balance(structure: Structure, blocks: BlockFields, motion: Motion, nominal_stress: float) -> float:
    """Largest difference, relative, of the mean traction P_iy of a row of blocks from the reaction over the area.

    It is 0 in equilibrium: what is cut at any height carries the whole force.
    """
    row = structure.blocks[:, 1] - structure.blocks[:, 1].min()
    traction = np.bincount(row, weights=blocks.first_piola[:, :, 1] @ np.array(motion)) / np.bincount(row)
    scale = max(abs(nominal_stress), float(np.abs(traction).max()))
    return float(np.abs(traction - nominal_stress).max() / scale) if scale else 0.0


@dataclass(frozen=True)
class CellStrain:
    """Every cell at the end of the stretch."""

    midpoint: Array
    """Reference midpoints (c, 3), m."""
    displacement: Array
    """Mean displacement of the cell's nodes (c, 3), m."""
    strain: Array
    """Infinitesimal strain sym(H) (c, 3, 3)."""

    def components(self) -> dict[str, Array]:
        """The in-plane strains by name (c,)."""
        return {f"eps_{'xyz'[i]}{'xyz'[j]}": self.strain[:, i, j] for i, j in ((0, 0), (1, 1), (0, 1))}


def cell_strain(result: Stretch) -> CellStrain:
    """Strain of every cell of the stretched sheet, from its own nodes."""
    structure, u = result.structure, result.final.displacement
    H = cell_gradient(structure, u)
    return CellStrain(
        midpoint=(structure.cells.astype(float) + 0.5) * result.sheet.tissue.cell.height,
        displacement=cell_displacement(structure, u),
        strain=0.5 * (H + np.swapaxes(H, 1, 2)),
    )


def histogram_edges(values: Array, bins: int = 40) -> Array:
    """Edges (bins + 1,) of equal bins that hold all values; of values that are all but equal, around them."""
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9:
        low, high = low - 1e-3, high + 1e-3
    return np.linspace(low, high, bins + 1)
