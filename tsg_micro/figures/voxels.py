"""Bodies of voxels in space: their outer faces, shaded by where they look and coloured by region, to scale."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.figure_style import MICRO, STYLE, finite, new_figure
from tsg_micro.data.voxels import VoxelBody, voxel_body
from tsg_micro.figures.sheet import frame, scale_bar, triad
from tsg_micro.figures.space import camera_of

__all__ = ["plot_voxels"]

Array = NDArray[np.float64]

_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#7f7f7f")
"""By region, told apart with any colour vision; more regions take them again."""
_NAMED = 8
"""Regions at most that the legend names."""
_SHADE = np.array([0.62, 0.62, 0.8, 0.8, 1.0, 1.0])
"""Brightness of faces that look to each of SIDES."""
_WIDTH = 6.0


def plot_voxels(
    body: VoxelBody,
    edge: float,
    regions: ArrayLike,
    names: list[str],
    *,
    azimuth: float = -64.0,
    elevation: float = 22.0,
) -> Figure:
    """The outer faces of a body whose voxels of ``edge`` m are of ``regions`` (m,), numbers in ``names``.

    A body of several regions has the eighth towards the eye cut out. Parallel projection; angles of the camera in
    degrees.

    Raises:
        InputError: an edge that is not positive, or regions that do not fit.
    """
    region = finite("regions", regions, (len(body.cells),)).astype(np.int64)
    if not (np.isfinite(edge) and edge > 0) or region.min() < 0 or region.max() >= len(names):
        raise InputError(f"edge, regions: expected a positive length, numbers of {len(names)} names, got {edge}")
    camera = camera_of(azimuth, elevation)
    if len(names) > 1:
        body, region = _without_near_eighth(body, region, camera[:, 2])
    outward = np.zeros((6, 3))
    outward[np.arange(6), np.arange(6) // 2] = np.tile([-1.0, 1.0], 3)
    seen = (outward @ camera[:, 2] > 1e-9)[body.towards]
    corners = MICRO * edge * body.nodes[body.faces[seen]] @ camera  # (f, 4, 3) in µm
    towards, own = body.towards[seen], region[body.owner[seen]]
    order = np.argsort(corners[..., 2].mean(axis=1))  # far ones first
    palette = np.array([to_rgb(colour) for colour in _COLOURS])
    colours = _SHADE[towards, None] * palette[own % len(palette)]
    low, high = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    extent = high - low
    points = 72 * _WIDTH * MICRO * edge / extent[:2].max()
    with mpl.rc_context(STYLE):
        size = np.maximum(extent[:2] / extent[:2].max() * _WIDTH + (0.5, 1.2), 3.0)
        figure = new_figure(size[0], size[1])
        axes = figure.subplots()
        faces = PolyCollection(
            list(corners[order][..., :2]), facecolors=colours[order], linewidths=min(0.4, 0.04 * points)
        )
        faces.set_edgecolor(0.55 * colours[order] if points > 4 else colours[order])
        axes.add_collection(faces)
        frame(axes, low, high, 0.02)
        axes.set_axis_off()
        scale_bar(axes, low, extent)
        triad(axes, camera)
        if 1 < len(names) <= _NAMED:
            handles = [Patch(color=palette[i], label=name) for i, name in enumerate(names)]
            figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _without_near_eighth(body: VoxelBody, region: NDArray[np.int64], eye: Array) -> tuple[VoxelBody, NDArray[np.int64]]:
    """The voxels that are not beyond the middle of the body along all three axes, towards the ``eye`` (3,)."""
    places = body.nodes[body.cells[:, 0]]
    beside = places + 0.5 - 0.5 * (body.nodes.min(axis=0) + body.nodes.max(axis=0))
    kept = ~(beside * eye > 0.0).all(axis=1)
    return voxel_body(places[kept]), region[kept]
