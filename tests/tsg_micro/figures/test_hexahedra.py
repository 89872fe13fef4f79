"""Outer faces of bodies of hexahedra: their area is that of the body's surface, whatever it is made of."""

from __future__ import annotations

import numpy as np
import pytest

from tsg_micro.cells.lattice import box_cells, spheroid_cells
from tsg_micro.data.errors import InputError
from tsg_micro.data.figure_style import save_figure
from tsg_micro.figures.hexahedra import _outer_faces, plot_hexahedra

CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], dtype=float)


def area(faces):
    """Vector areas (3,), summed, and the surface."""
    vectors = 0.5 * np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    return vectors.sum(axis=0), np.linalg.norm(vectors, axis=1).sum()


@pytest.mark.parametrize("blocks", [box_cells(4, 3, 2), np.unique(spheroid_cells(2.0) // 2, axis=0)])
def test_the_surface_is_closed_and_as_large_as_it_should_be(blocks):
    h = 2e-5
    faces, owner = _outer_faces(h * (blocks[:, None] + CUBE))
    there = {tuple(b) for b in blocks}
    sides = np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    expected = sum(tuple(b + s) not in there for b in blocks for s in sides)
    closed, surface = area(faces)
    np.testing.assert_allclose(closed, 0, atol=1e-18)
    assert surface == pytest.approx(expected * h**2)
    assert len(faces) == len(owner) == expected


def test_it_is_drawn(tmp_path):
    corners = 2e-5 * (box_cells(5, 5, 5)[:, None] + CUBE)
    save_figure(plot_hexahedra(corners, corners[:, 0, 0], "x / m"), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="values: expected finite numbers"):
        plot_hexahedra(corners, np.zeros(3), "x")
