"""Scenes shared by the tests of the micro-solver."""

from __future__ import annotations

import numpy as np
import pytest

from tsg_micro.cells.lattice import box_cells, lattice, side_nodes
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import prestressed


@pytest.fixture
def cell():
    """Cell with the values of the paper's Table 1."""
    return CellParameters()


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.fixture
def box(cell):
    """A prestressed box: ``box(nx, ny, nz, bar_force=..., periodic=..., images=...)``."""

    def make(nx, ny, nz, *, bar_force=1e-8, **options):
        return prestressed(lattice(box_cells(nx, ny, nz), cell, **options), cell, bar_force)

    return make


@pytest.fixture
def clamped():
    """Mask (n, 3) of the displacements of both outer faces across an axis, and the nodes of the high face."""

    def make(structure, axis):
        high = side_nodes(structure, axis, end="high")
        fixed = np.zeros(structure.nodes.shape, dtype=bool)
        fixed[high] = fixed[side_nodes(structure, axis, end="low")] = True
        return fixed, high

    return make


@pytest.fixture
def short_column(box, clamped):
    """Sixteen cells in a row, which displacements held (n, 3), and how far they go where it is shortened by 6 %."""
    structure = box(1, 16, 1)
    fixed, top = clamped(structure, 1)
    u = np.zeros(structure.nodes.shape)
    u[top, 1] = -0.06 * structure.size[1]
    return structure, fixed, u
