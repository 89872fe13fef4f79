"""A field on a body of hexahedra in space: its outer faces, the eighth towards the eye cut out, to scale."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from tsg_micro.data.figure_style import FIELD, MICRO, STYLE, finite, limits, new_figure
from tsg_micro.figures.sheet import frame, scale_bar, triad
from tsg_micro.figures.space import camera_of

__all__ = ["plot_hexahedra"]

Array = NDArray[np.float64]

_FACES = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
"""Corners, in VTK's order, of the faces of a hexahedron, counter-clockwise seen from outside."""
_WIDTH = 6.0
_SAME = 1e-6


def plot_hexahedra(
    corners: Array, values: ArrayLike, label: str, *, azimuth: float = -64.0, elevation: float = 22.0
) -> Figure:
    """Values (n,) of hexahedra with corners (n, 8, 3), m, in VTK's order; ``label`` names them and their unit.

    Faces that look away from the light are darker; the scale is that of the faces that are seen. Parallel projection;
    angles of the camera in degrees.

    Raises:
        InputError: another number of values, or some that are not finite.
    """
    field = finite("values", values, (len(corners),))
    camera = camera_of(azimuth, elevation)
    eye = camera[:, 2]
    middle = corners.mean(axis=1)
    beside = middle - 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    deep = np.ptp(corners.reshape(-1, 3), axis=0) > 2.5 * np.ptp(corners, axis=1).max(axis=0)
    kept = ~((beside * eye > 0.0) | ~deep).all(axis=1) if deep.any() else np.ones(len(corners), dtype=bool)
    corners, field = corners[kept], field[kept]
    face, owner = _outer_faces(corners)
    normal = np.cross(face[:, 2] - face[:, 0], face[:, 3] - face[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    seen = normal @ eye > 1e-9
    face, owner, normal = face[seen], owner[seen], normal[seen]
    drawn = MICRO * face @ camera  # (f, 4, 3) in µm
    order = np.argsort(drawn[..., 2].mean(axis=1))  # far ones first
    light = 0.72 + 0.28 * np.abs(normal @ np.array([0.2, 0.25, 0.95]))
    scale = ScalarMappable(Normalize(*limits([field[owner]])), FIELD)
    colours = np.clip(scale.to_rgba(field[owner])[:, :3] * light[:, None], 0.0, 1.0)
    low, high = drawn.reshape(-1, 3).min(axis=0), drawn.reshape(-1, 3).max(axis=0)
    extent = high - low
    with mpl.rc_context(STYLE):
        size = np.maximum(extent[:2] / extent[:2].max() * _WIDTH + (1.4, 1.2), 3.0)
        figure = new_figure(size[0], size[1])
        axes = figure.subplots()
        faces = PolyCollection(list(drawn[order][..., :2]), facecolors=colours[order], linewidths=0.2)
        faces.set_edgecolor(0.85 * colours[order])
        axes.add_collection(faces)
        frame(axes, low, high, 0.02)
        axes.set_axis_off()
        scale_bar(axes, low, extent)
        triad(axes, camera)
        figure.colorbar(scale, ax=axes, label=label, shrink=0.7)
    return figure


def _outer_faces(corners: Array) -> tuple[Array, NDArray[np.int64]]:
    """Faces (f, 4, 3) of hexahedra (n, 8, 3) that no two share, and whose each is (f,)."""
    edge = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).min()
    places = np.rint((corners.reshape(-1, 3) - corners.min(axis=(0, 1))) / (_SAME * edge)).astype(np.int64)
    node = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1, 8)
    faces = node[:, _FACES].reshape(-1, 4)
    _, which, count = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    outer = np.flatnonzero(count[which.reshape(-1)] == 1)
    return corners[:, _FACES].reshape(-1, 4, 3)[outer], outer // 6
