"""Write the meshes and the surface that the scenes beside it need: python make_meshes.py [FOLDER]."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import meshes

BLOCK = 20e-6
"""Edge of a block, m."""


def make_meshes(folder: Path) -> None:
    """Write hole.msh, inclusion.msh, arc.msh (in mm) and organ.stl (in um) into the folder."""
    meshes.quarter_with_hole(
        folder / "hole.msh", elements=(3, 5, 1), size=(6 * BLOCK, 8 * BLOCK, BLOCK), radius=2 * BLOCK
    )
    cube = 4 * BLOCK
    meshes.box_with_inclusion(folder / "inclusion.msh", elements=(4, 4, 4), size=(cube, cube, cube), radius=0.9 * BLOCK)
    meshes.curved_sheet(
        folder / "arc.msh",
        elements=(12, 3, 2),
        size=(0.24, 0.06, 0.04),
        radius=0.16,
        thickness_ratio=0.5,
        region=lambda x: np.where(x[:, 0] < 0.12, "root", "tip"),
    )
    (folder / "organ.stl").write_text(_stl(*_bean(rings=12)))


def _bean(rings: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points (n, 3) in um of a round body with a dent on one side, and its triangles (t, 3)."""
    latitude, longitude = np.linspace(0.0, np.pi, rings + 1), np.linspace(0.0, 2.0 * np.pi, 2 * rings + 1)[:-1]
    polar, around = (grid.reshape(-1) for grid in np.meshgrid(latitude, longitude, indexing="ij"))
    sphere = np.column_stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)])
    dent = 1.0 - 0.5 * np.exp(-4.0 * ((sphere - [1.0, 0.0, 0.0]) ** 2).sum(axis=1))
    points = (sphere * dent[:, None] * [60.0, 50.0, 70.0]).round(6)  # all of a pole are one point
    n = 2 * rings
    i, j = (grid.reshape(-1) for grid in np.meshgrid(np.arange(rings), np.arange(n), indexing="ij"))
    a, b, c, d = i * n + j, i * n + (j + 1) % n, (i + 1) * n + j, (i + 1) * n + (j + 1) % n
    lower, upper = np.column_stack([a, c, d])[i < rings - 1], np.column_stack([a, d, b])[i > 0]
    return points, np.concatenate([lower, upper])


def _stl(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> str:
    """The surface as text of STL; normals are left to whoever reads it."""
    lines = ["solid organ"]
    for triangle in points[triangles]:
        corners = [f"  vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangle]
        lines += ["facet normal 0 0 0", " outer loop", *corners, " endloop", "endfacet"]
    return "\n".join([*lines, "endsolid organ", ""])


if __name__ == "__main__":
    make_meshes(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
