"""Fields of a body of equal cubes on slices through its middle, x-y and x-z."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from tsg_micro.data.figure_style import (
    FIELD,
    MICRO,
    STYLE,
    aspect_ratio,
    draw_field,
    finite,
    limits,
    new_figure,
)

__all__ = ["middle_slice", "plot_slices"]

Array = NDArray[np.float64]
Field = tuple[ArrayLike, str]


def middle_slice(midpoint: Array, edge: float, axis: int) -> tuple[NDArray[np.int64], float]:
    """Blocks (k,) of the layer across ``axis`` that is in the middle of the layers, and where it is, m."""
    layer = np.rint((midpoint[:, axis] - midpoint[:, axis].min()) / edge).astype(np.int64)
    there = np.unique(layer)
    chosen = np.flatnonzero(layer == there[len(there) // 2])
    return chosen, float(midpoint[chosen[0], axis])


def plot_slices(
    midpoint: Array, edge: float, fields: Mapping[str, Field], *, same: bool = False, cmap: str = FIELD
) -> Figure:
    """Fields per block on both slices, a row for each, with one scale in a row.

    Args:
        midpoint: of the blocks (b, 3), m, on a grid of this ``edge``.
        edge: of a block, m.
        fields: title -> (values (b,), unit); stresses in Pa.
        same: one scale for all fields.
        cmap: colours.

    Raises:
        InputError: a field of another length, or not finite.
    """
    values = {title: finite(f"field {title}", field, (len(midpoint),)) for title, (field, _) in fields.items()}
    corners = 0.5 * edge * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    slices = []
    for across, up in ((2, 1), (1, 2)):
        blocks, place = middle_slice(midpoint, edge, across)
        slices.append((blocks, midpoint[blocks][:, None, [0, up]] + corners, "xyz"[up], "xyz"[across], place))
    with mpl.rc_context(STYLE):
        height = 0.9 + 3.2 * max(aspect_ratio(outline) for _, outline, *_ in slices)
        figure = new_figure(9.6, height * len(fields))
        grid = figure.subplots(len(fields), 2, squeeze=False)
        for row, (title, field) in zip(grid, values.items(), strict=True):
            ends = limits([f[blocks] for f in (values.values() if same else [field]) for blocks, *_ in slices])
            for axes, (blocks, outline, upwards, normal, place) in zip(row, slices, strict=True):
                drawn = draw_field(axes, outline, field[blocks], ends, cmap)
                axes.set_title(f"{title}\n${normal}$ = {MICRO * place:.4g} µm", fontsize=12)
                axes.set(xlabel="$x$ / µm", ylabel=f"${upwards}$ / µm")
            figure.colorbar(drawn, ax=list(row), label=fields[title][1], aspect=25)
    return figure
