"""Block-by-block comparison of the data-driven stresses with those of the full tensegrity (paper, Section 4.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import pressure, von_mises

__all__ = [
    "BlockStress",
    "Comparison",
    "ErrorMap",
    "FieldError",
    "compare_blocks",
    "error_map",
    "grid_index",
    "interior_blocks",
    "match_blocks",
    "ring_index",
]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BlockStress:
    """Mean Mandel stress (n, 6) in Pa of blocks with midpoints (n, 3) in m, and which stress it is.

    Raises:
        InputError: on construction, where shapes do not fit or a number is not finite.
    """

    midpoint: Array
    stress: Array
    stress_measure: str

    def __post_init__(self) -> None:
        n = len(self.midpoint)
        for name, array, shape in (("midpoint", self.midpoint, (n, 3)), ("stress", self.stress, (n, 6))):
            if n == 0 or array.shape != shape or not np.isfinite(array).all():
                raise InputError(
                    f"block {name}: expected finite numbers of shape {shape}, n > 0, got {array.shape} or NaN"
                )


@dataclass(frozen=True)
class FieldError:
    """Relative errors of a field a against b: l2 = |a - b| / |b| and mean = mean(|a - b| / |b|).

    Of the interior blocks, and of all with the suffix ``_all``; blocks with b = 0 are left out of the mean.
    """

    l2: float
    mean: float
    l2_all: float
    mean_all: float


@dataclass(frozen=True)
class Comparison:
    """Errors of p and q of the mechanical and the material solution against the reference."""

    error_p_mech: FieldError
    error_p_mat: FieldError
    error_q_mech: FieldError
    error_q_mat: FieldError
    blocks: int
    interior_blocks: int

    def as_dict(self) -> dict[str, object]:
        """The same as nested dictionaries, ready for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class ErrorMap:
    """Where the squared error |a - b|^2 of a field sits, over n blocks in rings around the middle.

    ``share`` (n,) of every block and ``rings`` (k,) of every ring, the outermost first, add up to 1 (to 0 of no error);
    so do ``clamped_rows``, the first and last row in y, ``free_sides``, the first and last column without those rows,
    and the inner rings. ``error`` (k,) is |a - b| / |b| of the blocks that are left with 0, 1, 2, ... rings left out;
    it is shorter where b is zero in all of these.
    """

    share: Array
    rings: Array
    clamped_rows: float
    free_sides: float
    error: Array

    def as_dict(self) -> dict[str, object]:
        """The numbers, without the map, ready for JSON."""
        numbers = {"clamped_rows": self.clamped_rows, "free_sides": self.free_sides}
        return {"rings": self.rings.tolist(), **numbers, "error": self.error.tolist()}


def grid_index(midpoint: Array) -> NDArray[np.int64]:
    """Column, row and layer (n, 3) of blocks on a regular grid, from their midpoints (n, 3) in m.

    Raises:
        InputError: the midpoints are not those of a full regular grid.
    """
    index = np.empty(midpoint.shape, dtype=np.int64)
    extent = np.ptp(midpoint, axis=0).max()
    for axis in range(3):
        x = midpoint[:, axis]
        order = np.argsort(x)
        jump = np.diff(x[order]) > max(1e-3 * extent / len(x), 1e-9 * extent)
        index[order, axis] = np.concatenate([[0], np.cumsum(jump)])
        places = [x[index[:, axis] == i].mean() for i in range(index[:, axis].max() + 1)]
        steps = np.diff(places)
        if len(steps) and np.ptp(steps) > 0.01 * steps.mean():
            raise InputError(
                f"block midpoints: expected an even grid along {'xyz'[axis]}, "
                f"got steps of {steps.min():.3g} to {steps.max():.3g} m"
            )
    shape = index.max(axis=0) + 1
    if len(np.unique(index, axis=0)) != len(index) or shape.prod() != len(index):
        raise InputError(
            f"block midpoints: expected one block per place of a {_times(shape)} grid, got {len(index)} blocks"
        )
    return index


def match_blocks(a: BlockStress, b: BlockStress) -> NDArray[np.int64]:
    """Index into the blocks of ``b`` for every block of ``a``, both on the same grid.

    Raises:
        InputError: the grids or the stress measures differ.
    """
    if a.stress_measure != b.stress_measure:
        raise InputError(
            f"stress measure: expected the same in both solutions, got {a.stress_measure} and {b.stress_measure}"
        )
    ia, ib = grid_index(a.midpoint), grid_index(b.midpoint)
    shape_a, shape_b = ia.max(axis=0) + 1, ib.max(axis=0) + 1
    if not np.array_equal(shape_a, shape_b):
        raise InputError(
            f"blocks: expected the same grid in both solutions, got {_times(shape_a)} and {_times(shape_b)}"
        )
    match = np.empty(len(ia), dtype=np.int64)
    match[np.ravel_multi_index(ia.T, shape_a)] = np.arange(len(ia))  # block of a at each place
    order_b = np.empty(len(ib), dtype=np.int64)
    order_b[np.ravel_multi_index(ib.T, shape_b)] = np.arange(len(ib))
    found = np.empty(len(ia), dtype=np.int64)
    found[match] = order_b
    extent = np.ptp(b.midpoint, axis=0) + np.ptp(b.midpoint, axis=0).max() / shape_b.max()
    if (np.abs(a.midpoint - b.midpoint[found]) > 0.25 * extent / shape_b).any():
        raise InputError(
            "blocks: expected the same midpoints in both solutions, got blocks more than a quarter of their size apart"
        )
    return found


def ring_index(midpoint: Array) -> NDArray[np.int64]:
    """How many rings of blocks in x and y are around each block (n,), 0 in the outermost one, from midpoints (n, 3).

    Raises:
        InputError: no regular grid.
    """
    index = grid_index(midpoint)[:, :2]
    return np.asarray(np.minimum(index, index.max(axis=0) - index).min(axis=1))


def interior_blocks(midpoint: Array) -> NDArray[np.bool_]:
    """Which blocks (n,) are not in the outer ring in x and y, from the midpoints (n, 3) of a regular grid.

    Raises:
        InputError: no regular grid, or no interior block (less than 3 x 3).
    """
    interior = ring_index(midpoint) > 0
    if not interior.any():
        shape = grid_index(midpoint)[:, :2].max(axis=0) + 1
        raise InputError(f"blocks: expected at least 3 x 3, to leave the outer ones out, got {_times(shape)}")
    return interior


def error_map(solution: BlockStress, reference: BlockStress, invariant: Callable[[Array], Array]) -> ErrorMap:
    """Where the error of an invariant of the stress, p or q, sits; blocks in the order of ``solution``.

    Raises:
        InputError: grids or stress measures differ, or the invariant of the reference is zero.
    """
    b = invariant(reference.stress)[match_blocks(solution, reference)]
    square, size = (invariant(solution.stress) - b) ** 2, b**2
    ring, row = ring_index(solution.midpoint), grid_index(solution.midpoint)[:, 1]
    share = square / (square.sum() or 1.0)
    clamped = (row == 0) | (row == row.max())
    # sums over the ring and all inside it
    error, norm = (np.cumsum(np.bincount(ring, a)[::-1])[::-1] for a in (square, size))
    if norm[0] == 0:
        raise InputError("reference stress: expected p and q other than zero, to relate errors to, got zero")
    known = norm > 1e-24 * norm[0]
    return ErrorMap(
        share=share,
        rings=np.bincount(ring, share),
        clamped_rows=float(share[clamped].sum()),
        free_sides=float(share[(ring == 0) & ~clamped].sum()),
        error=np.sqrt(error[known] / norm[known]),
    )


def compare_blocks(mechanical: BlockStress, material: BlockStress, reference: BlockStress) -> Comparison:
    """Errors of the data-driven p and q, block by block; the outer ring of blocks in x and y is the boundary.

    Raises:
        InputError: grids or stress measures differ, or there is no interior block (less than 3 x 3).
    """
    interior = interior_blocks(reference.midpoint)
    errors = {}
    for name, solution in (("mech", mechanical), ("mat", material)):
        found = match_blocks(solution, reference)
        stress = np.empty_like(reference.stress)
        stress[found] = solution.stress
        for symbol, invariant in (("p", pressure), ("q", von_mises)):
            a, b = invariant(stress), invariant(reference.stress)
            errors[f"error_{symbol}_{name}"] = FieldError(*_errors(a[interior], b[interior]), *_errors(a, b))
    return Comparison(**errors, blocks=len(interior), interior_blocks=int(interior.sum()))


def _errors(a: Array, b: Array) -> tuple[float, float]:
    size = np.linalg.norm(b)
    if size == 0:
        raise InputError(
            "reference stress: expected p and q other than zero, to relate errors to, got zero in all blocks"
        )
    counted = np.abs(b) > 1e-12 * np.abs(b).max()
    return float(np.linalg.norm(a - b) / size), float(np.mean(np.abs(a - b)[counted] / np.abs(b)[counted]))


def _times(shape: NDArray[np.int64]) -> str:
    return " x ".join(map(str, shape))
