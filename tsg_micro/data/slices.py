"""Fields of a body of equal cubes on slices through its middle, x-y and x-z."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from tsg_micro.data.figure_style import (
    FIELD,
    MICRO,
    STYLE,
    draw_field,
    finite,
    limits,
    new_figure,
)

__all__ = ["Slice", "middle_slice", "plot_slices", "slices_of_blocks", "slices_of_cells"]

Array = NDArray[np.float64]
Field = tuple[ArrayLike, str]
_CELL_FACES = np.array([[[0, 3, 7, 4], [1, 2, 6, 5]], [[0, 1, 5, 4], [3, 2, 6, 7]], [[0, 1, 2, 3], [4, 5, 6, 7]]])
"""Corners, in VTK's order, of opposite faces of a hexahedron, three pairs."""


@dataclass(frozen=True)
class Slice:
    """Cells (k,) that a plane across the axis ``normal`` at ``place`` (m) meets, and their ``outline`` (k, 4, 2), m.

    The plane has x to the right and the axis ``up`` upwards.
    """

    cells: NDArray[np.int64]
    outline: Array
    up: str
    normal: str
    place: float


def middle_slice(midpoint: Array, edge: float, axis: int) -> tuple[NDArray[np.int64], float]:
    """Blocks (k,) of the layer across ``axis`` that is in the middle of the layers, and where it is, m."""
    layer = np.rint((midpoint[:, axis] - midpoint[:, axis].min()) / edge).astype(np.int64)
    there = np.unique(layer)
    chosen = np.flatnonzero(layer == there[len(there) // 2])
    return chosen, float(midpoint[chosen[0], axis])


def slices_of_blocks(midpoint: Array, edge: float) -> list[Slice]:
    """The slices x-y and x-z through the middle of blocks with midpoints (b, 3), m, on a grid of this ``edge``."""
    corners = 0.5 * edge * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    found = []
    for across, up in ((2, 1), (1, 2)):
        blocks, place = middle_slice(midpoint, edge, across)
        found.append(Slice(blocks, midpoint[blocks][:, None, [0, up]] + corners, "xyz"[up], "xyz"[across], place))
    return found


def slices_of_cells(corners: Array, drawn: Array | None = None) -> list[Slice]:
    """The same of hexahedra with corners (n, 8, 3), m, in VTK's order, each as the layer through its middle.

    Where the corners are ``drawn`` (n, 8, 3) at other places, of the deformed body, the layers are those of the body at
    rest.
    """
    found = []
    low, high = corners.min(axis=1), corners.max(axis=1)
    for across, up in ((2, 1), (1, 2)):
        # a hair off the middle, which may be between two layers
        place = float(low[:, across].min() + 0.5001 * np.ptp(corners[..., across]))
        cells = np.flatnonzero((low[:, across] <= place) & (high[:, across] > place))
        layers = corners[cells][:, _CELL_FACES].mean(axis=2)  # (k, 3 pairs, 4, 3)
        flat = np.ptp(layers[..., across], axis=2).argmin(axis=1)
        shown = layers if drawn is None else drawn[cells][:, _CELL_FACES].mean(axis=2)
        outline = shown[np.arange(len(cells)), flat][..., [0, up]]
        found.append(Slice(cells, outline, "xyz"[up], "xyz"[across], place))
    return found


def plot_slices(slices: Sequence[Slice], fields: Mapping[str, Field], *, cmap: str = FIELD) -> Figure:
    """Fields per cell on slices, a row for each field; those of one label share a scale.

    Args:
        slices: of a body.
        fields: title -> (values of all its cells (n,), label with the unit); stresses in Pa.
        cmap: colours.

    Raises:
        InputError: a field of another length, or not finite.
    """
    n = len(np.asarray(next(iter(fields.values()))[0]))
    values = {title: finite(f"field {title}", field, (n,)) for title, (field, _) in fields.items()}
    with mpl.rc_context(STYLE):
        tallest = max(np.divide(*np.ptp(one.outline.reshape(-1, 2), axis=0)[::-1]) for one in slices)
        height = 1.6 + 3.6 * float(np.clip(tallest, 0.08, 1.5))
        figure = new_figure(9.6, height * len(fields))
        grid = figure.subplots(len(fields), len(slices), squeeze=False)
        for row, (title, field) in zip(grid, values.items(), strict=True):
            label = fields[title][1]
            alike = [values[other] for other, (_, of) in fields.items() if of == label]
            ends = limits([one_field[one.cells] for one_field in alike for one in slices])
            for axes, one in zip(row, slices, strict=True):
                drawn = draw_field(axes, one.outline, field[one.cells], ends, cmap)
                axes.set_title(f"{title}\n${one.normal}$ = {MICRO * one.place:.3g} µm", fontsize=12)
                axes.set(xlabel="$x$ / µm", ylabel=f"${one.up}$ / µm")
            figure.colorbar(drawn, ax=list(row), label=label, aspect=float(np.clip(8 * height, 8, 25)))
    return figure
