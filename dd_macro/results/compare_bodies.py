"""A continuum solution against the tensegrity on any body of blocks: which element is in which block, and errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import COMPONENTS, pressure, von_mises

__all__ = ["BodyErrors", "block_means", "body_errors", "inner_blocks", "relative_errors"]

Array = NDArray[np.float64]
_FULL = 1e-3


def block_means(element: Array, volume: Array, values: Array, midpoint: Array, edge: float) -> Array:
    """Volume means (b, ...) over blocks of ``values`` (n, ...) of elements.

    Args:
        element: midpoints of the elements (n, 3), m.
        volume: of the elements (n,), m^3.
        values: of the elements (n, ...).
        midpoint: of the blocks (b, 3), m, cubes on one grid.
        edge: of a block, m.

    Raises:
        InputError: an element is in no block, or those in a block do not fill it.
    """
    low = midpoint.min(axis=0)
    place = np.rint((midpoint - low) / edge).astype(np.int64) + 1
    table = np.full(place.max(axis=0) + 2, -1, dtype=np.int64)
    table[tuple(place.T)] = np.arange(len(midpoint))
    at = np.rint((element - low) / edge).astype(np.int64) + 1
    block = table[tuple(np.clip(at, 0, np.array(table.shape) - 1).T)]
    outside = np.flatnonzero(block < 0)
    if outside.size:
        where = ", ".join(f"{x:.4g}" for x in element[outside[0]])
        raise InputError(
            f"elements: expected each in a block of the tensegrity, got one around ({where}) m that is in none "
            f"({outside.size} of {len(element)})"
        )
    filled = np.bincount(block, volume, len(midpoint))
    short = np.flatnonzero(np.abs(filled / edge**3 - 1.0) > _FULL)
    if short.size:
        where = ", ".join(f"{x:.4g}" for x in midpoint[short[0]])
        raise InputError(
            f"elements: expected those in a block to fill it, got {filled[short[0]]:.4g} m^3 of {edge**3:.4g} m^3 in "
            f"that around ({where}) m ({short.size} of {len(midpoint)})"
        )
    means = np.zeros((len(midpoint), *values.shape[1:]))
    np.add.at(means, block, values * (volume / filled[block]).reshape(-1, *[1] * (values.ndim - 1)))
    return means


def inner_blocks(midpoint: Array, edge: float) -> NDArray[np.bool_]:
    """Which blocks (b,) have no outer face, from their midpoints (b, 3); an axis along which all are one layer is none.

    So those of a sheet are the ones that are not at the sides of its plane.

    Example:
        >>> places = np.stack(np.meshgrid(*(np.arange(n) for n in (4, 3, 1)), indexing="ij"), axis=-1).reshape(-1, 3)
        >>> int(dd.inner_blocks(2e-5 * (places + 0.5), 2e-5).sum())
        2
    """
    place = np.rint((midpoint - midpoint.min(axis=0)) / edge).astype(np.int64) + 1
    there = np.zeros(place.max(axis=0) + 2, dtype=bool)
    there[tuple(place.T)] = True
    inner = np.ones(len(place), dtype=bool)
    for axis in range(3):
        if np.ptp(place[:, axis]):
            for step in (-1, 1):
                inner &= there[tuple((place + step * np.eye(3, dtype=np.int64)[axis]).T)]
    return inner


def relative_errors(a: Array, b: Array) -> tuple[float, float] | None:
    """|a - b| / |b| of all, and its mean over rows, of fields (n, k) or (n,); None of no row, or where b is zero.

    Rows with b = 0 are left out of the mean.
    """
    size, apart = (np.linalg.norm(x, axis=1) if x.ndim > 1 else np.abs(x) for x in (b, a - b))
    if not size.any():
        return None
    counted = size > 1e-12 * size.max()
    return float(np.linalg.norm(apart) / np.linalg.norm(size)), float((apart[counted] / size[counted]).mean())


@dataclass(frozen=True)
class BodyErrors:
    """Errors of a solution over ``blocks`` blocks, relative to the reference; None where that is zero."""

    blocks: int
    p: tuple[float, float] | None
    """|a - b| / |b| of all, and the mean of it over blocks."""
    q: tuple[float, float] | None
    stress: tuple[float, float] | None
    """Of all components at once, in the norm of tensors."""
    components: dict[str, float]
    """|a - b| of a component over |b| of the whole stress: the squares add up to that of the error of ``stress``."""

    def as_dict(self) -> dict[str, object]:
        """The same, ready for JSON."""
        named = {name: getattr(self, name) for name in ("p", "q", "stress")}
        pairs = {name: None if e is None else {"l2": e[0], "mean": e[1]} for name, e in named.items()}
        return {"blocks": self.blocks, **pairs, "components": self.components}


def body_errors(stress: Array, reference: Array) -> BodyErrors:
    """Errors of Mandel stress (n, 6) against ``reference`` (n, 6) of the same blocks, Pa; 1 is all of the reference."""
    size = float(np.linalg.norm(reference))
    apart = np.linalg.norm(stress - reference, axis=0)
    return BodyErrors(
        blocks=len(reference),
        p=relative_errors(pressure(stress), pressure(reference)),
        q=relative_errors(von_mises(stress), von_mises(reference)),
        stress=relative_errors(stress, reference),
        components={name: float(e / size) for name, e in zip(COMPONENTS, apart, strict=True)} if size else {},
    )
