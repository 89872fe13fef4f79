"""How material data cover the strain box they were sampled in, and where a data-driven solution is relative to them.

Distances in the box are over its sides, so that the box is a unit square.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tsg_micro.continuum.sampling import BOXES
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import COMPONENTS

__all__ = ["FEWEST", "BoxCoverage", "Visited", "box_coverage", "box_strain", "visited_states"]

Array = NDArray[np.float64]
_FINE, _CELLS = 201, 10
_DRAWS = 5
FEWEST = 40
"""Points that the subsets of growing size need."""


@dataclass(frozen=True)
class BoxCoverage:
    """How well points fill the unit square; lengths over the sides of the box."""

    counts: NDArray[np.int64]
    """Points in 10 x 10 equal cells; rows go along the first component."""
    outside: int
    """Points outside the box."""
    fill_distance: float
    """Radius of the largest empty disc: over the square, the largest distance to the nearest point."""
    mean_gap: float
    """Over the square, the mean distance to the nearest point."""
    mean_neighbour: float
    """Mean distance of a point to its nearest neighbour; 0.5 / sqrt(N) for uniformly random points."""
    sizes: NDArray[np.int64]
    """Sizes of random subsets (k,), the last is all points."""
    fill_by_size: Array
    """Fill distance of each (k,), mean of several draws."""
    gap_by_size: Array
    """Mean gap of each (k,), mean of several draws."""

    def slope(self, values: Array) -> float:
        """Slope of log ``values`` (k,) over log N; -1/2 in two dimensions, but for a logarithm in the fill distance."""
        return float(np.polyfit(np.log(self.sizes), np.log(values), 1)[0])


@dataclass(frozen=True)
class Visited:
    """The states of a data-driven solution beside the data; volume means over the quadrature points."""

    share_used: float
    """Data that are chosen somewhere, over all data."""
    outside_box: float
    """Volume whose mechanical strain is outside the sampled box."""
    outside_range: Array
    """By component (6,): volume whose mechanical strain is outside the range of the data."""
    rms: dict[str, Array]
    """By component (6,), Mandel, root mean square of the strain: mechanical, material, data, and the gap between the
    mechanical and the material state."""
    rms_stress: dict[str, Array]
    """The same of the stress, Pa."""
    unspanned: float
    """Of the mean square of the mechanical strain, the part in components that are zero in all data."""


def box_strain(strain: Array, load: str) -> Array:
    """The two sampled components (..., 2) of Mandel strains (..., 6), over the box of ``load``: in it, in [0, 1]."""
    ranges = BOXES[load].ranges
    columns = [COMPONENTS.index(name) for name in ranges]
    scale = np.where(np.array(columns) < 3, 1.0, np.sqrt(2.0))
    low, high = np.array(list(ranges.values())).T
    return (strain[..., columns] / scale - low) / (high - low)


def box_coverage(points: Array, *, seed: int = 0) -> BoxCoverage:
    """Coverage of the unit square by ``points`` (N, 2), and by random subsets of them drawn from ``seed``.

    Raises:
        InputError: fewer points than subsets of growing size need.
    """
    if len(points) < FEWEST:
        raise InputError(f"data: expected at least {FEWEST} points to tell how they cover the box, got {len(points)}")
    fine = np.linspace(0.0, 1.0, _FINE)
    grid = np.stack(np.meshgrid(fine, fine, indexing="ij"), axis=-1).reshape(-1, 2)
    random = np.random.default_rng(seed)
    sizes = np.unique(np.geomspace(FEWEST // 2, len(points), 8).round().astype(np.int64))
    fill, gap = np.zeros(len(sizes)), np.zeros(len(sizes))
    for k, size in enumerate(sizes):
        draws = _DRAWS if size < len(points) else 1
        for _ in range(draws):
            distance, _ = cKDTree(points[random.permutation(len(points))[:size]]).query(grid)
            fill[k] += distance.max() / draws
            gap[k] += distance.mean() / draws
    inside = _inside(points)
    cell = np.clip((_CELLS * points[inside]).astype(np.int64), 0, _CELLS - 1)
    counts = np.bincount(_CELLS * cell[:, 0] + cell[:, 1], minlength=_CELLS**2).reshape(_CELLS, _CELLS)
    neighbour, _ = cKDTree(points).query(points, k=2)
    return BoxCoverage(
        counts=counts,
        outside=int((~inside).sum()),
        fill_distance=float(fill[-1]),
        mean_gap=float(gap[-1]),
        mean_neighbour=float(neighbour[:, 1].mean()),
        sizes=sizes,
        fill_by_size=fill,
        gap_by_size=gap,
    )


def _inside(points: Array) -> NDArray[np.bool_]:
    """Points (..., 2) in the unit square; round-off of what was sampled on its boundary is no way out."""
    return ((points >= -1e-9) & (points <= 1.0 + 1e-9)).all(axis=-1)


def visited_states(fields: Any, dataset: Dataset, load: str) -> Visited:
    """Where the solution ``fields`` (dd_macro.QuadratureFields) is, relative to the data it was made with.

    Raises:
        InputError: the solution was not made with these data.
    """
    strain, material = (a.reshape(-1, 6) for a in (fields.mechanical_strain, fields.material_strain))
    stress, chosen = (a.reshape(-1, 6) for a in (fields.mechanical_stress, fields.material_stress))
    datum = fields.datum.ravel()
    size = np.abs(dataset.strain).max()
    if datum.max() >= len(dataset) or np.abs(dataset.strain[datum] - material).max() > 1e-12 * size:
        raise InputError("dd, data: expected a solution made with these data, its material states are not among them")
    weight = fields.weight.ravel() / fields.weight.sum()
    spread = np.abs(dataset.strain).max(axis=0)
    none = spread <= 1e-8 * size
    low, high = dataset.strain.min(axis=0), dataset.strain.max(axis=0)
    beyond = (strain < low - 1e-9 * size) | (strain > high + 1e-9 * size)
    square = weight @ strain**2
    return Visited(
        share_used=len(np.unique(datum)) / len(dataset),
        outside_box=min(float(weight @ ~_inside(box_strain(strain, load))), 1.0),
        outside_range=np.minimum(weight @ beyond, 1.0),
        rms=_rms(weight, strain, material, dataset.strain),
        rms_stress=_rms(weight, stress, chosen, dataset.stress),
        unspanned=float(square[none].sum() / square.sum()),
    )


def _rms(weight: Array, mechanical: Array, material: Array, data: Array) -> dict[str, Array]:
    """Root mean squares (6,) of the states, the data, and the gap."""
    states = {"mechanical": mechanical, "material": material, "gap": mechanical - material}
    means = {name: np.sqrt(weight @ values**2) for name, values in states.items()}
    return means | {"data": np.sqrt((data**2).mean(axis=0))}
