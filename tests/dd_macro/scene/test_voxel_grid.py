"""A mesh of voxels seen as a grid: places of cells, faces of sides, and meshes that are none."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from dd_macro import box, voxel_grid, voxel_mesh
from tsg_micro.data.errors import InputError

EDGE = 2e-5
STAIR = np.array([[5, -2, 0], [6, -2, 0], [6, -1, 0], [6, -1, 1]])


def test_cells_and_faces_are_where_the_mesh_has_them():
    domain = voxel_mesh(
        MPI.COMM_SELF, STAIR, edge=EDGE, origin=(1e-5, 0.0, 3e-5), sides={"step": lambda x: x[:, 2] > 3.4 * EDGE}
    )
    grid = voxel_grid(domain, EDGE)
    np.testing.assert_allclose(grid.origin, np.array([1e-5, 0.0, 3e-5]) + EDGE * STAIR.min(axis=0), atol=1e-12)
    original = np.asarray(domain.mesh.topology.original_cell_index)
    np.testing.assert_array_equal(grid.index, (STAIR - STAIR.min(axis=0))[original])
    every = grid.faces("surface")
    assert len(every) == 6 * 4 - 2 * 3
    assert len(np.unique(every, axis=0)) == len(every)
    there = {tuple(place) for place in grid.index}
    for cell, axis, end in every:
        assert tuple(grid.index[cell] + (2 * end - 1) * np.eye(3, dtype=int)[axis]) not in there
    (cell, axis, end), *others = grid.faces("left")
    assert (grid.index[cell].tolist(), axis, end, others) == ([0, 0, 0], 0, 0, [])
    assert {(tuple(grid.index[cell]), axis, end) for cell, axis, end in grid.faces("step")} == {((1, 1, 1), 2, 1)}


@pytest.mark.parametrize(
    ("elements", "size", "text"),
    [
        ((2, 2, 2), (4e-5, 4e-5, 2e-5), r"edge, 2e-05 m, on one grid, got cell 0 of 2e-05 x 2e-05 x 1e-05 m around"),
        ((3, 1, 1), (6.03e-5, 2e-5, 2e-5), r"got cell 0 of 2.01e-05 x 2e-05 x 2e-05 m around .* \(3 of 3 cells\)"),
    ],
)
def test_what_is_no_body_of_voxels(elements, size, text):
    with pytest.raises(InputError, match=text):
        voxel_grid(box(MPI.COMM_SELF, elements=elements, size=size), EDGE)


def test_a_cell_that_is_skewed_or_beside_the_grid():
    domain = box(MPI.COMM_SELF, elements=(3, 1, 1), size=(3 * EDGE, EDGE, EDGE))
    x = domain.mesh.geometry.x
    upper = x[:, 1] > 0.5 * EDGE
    x[upper, 0] += 0.01 * EDGE
    with pytest.raises(InputError, match="expected cubes of one block's edge"):
        voxel_grid(domain, EDGE)
    x[upper, 0] -= 0.01 * EDGE
    assert voxel_grid(domain, EDGE).index[:, 0].tolist() == [0, 1, 2]
    x[x[:, 0] > 1.5 * EDGE, 0] += 0.5 * EDGE
    with pytest.raises(InputError, match=r"got cell 1 of 3e-05 x 2e-05 x 2e-05 m around .* \(2 of 3 cells\)"):
        voxel_grid(domain, EDGE)


def test_several_ranks_are_refused(comm):
    if comm.size == 1:
        pytest.skip("needs ranks")
    with pytest.raises(InputError, match="expected one rank"):
        voxel_grid(box(comm, elements=(4, 1, 1), size=(4 * EDGE, EDGE, EDGE)), EDGE)
