"""Bodies of voxels: volumes, areas, sides and regions in closed form, on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest

import dd_macro as dd
from dd_macro.parallel import total
from dd_macro.scene.boundary import side_dofs
from dd_macro.scene.loads import nodal_forces
from tsg_micro.cells.lattice import box_cells, spheroid_cells
from tsg_micro.data.errors import InputError

pytestmark = pytest.mark.mpi
A = 2e-5
ELL = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0)])


def areas(domain):
    """Area of every side, from the force of a unit traction on it."""
    operator = dd.StrainOperator(domain)
    return {
        name: float(total(domain.comm, nodal_forces(operator, [dd.Traction(name, (1.0, 0, 0))]).sum()))
        for name in domain.names
    }


def owned(domain, name):
    return domain.comm.allreduce(int((domain.regions[name] < domain.owned_cells).sum()))


@pytest.mark.parametrize("refine", [1, 2])
def test_an_ell_in_closed_form(comm, refine):
    body = dd.voxel_mesh(comm, ELL - 3, edge=A, refine=refine, origin=(1e-3, 0.0, 0.0))
    assert body.global_cells == 4 * refine**3
    assert body.parts is None
    assert total(comm, dd.StrainOperator(body).weights.sum()) == pytest.approx(4 * A**3, rel=1e-12)
    faces = {"surface": 18, "left": 2, "right": 1, "bottom": 3, "top": 1, "back": 4, "front": 4}
    assert {name: area / A**2 for name, area in areas(body).items()} == pytest.approx(faces, rel=1e-9)
    low, high, _ = body.extent("surface")
    np.testing.assert_allclose(low, [1e-3 - 3 * A, -3 * A, -3 * A], atol=1e-18)
    np.testing.assert_allclose(high - low, [3 * A, 2 * A, A], atol=1e-18)


def test_a_spheroid_of_blocks(comm):
    blocks = np.unique(spheroid_cells(5) // 2, axis=0)
    body = dd.voxel_mesh(comm, blocks, edge=A)
    assert body.global_cells == 552
    columns = len(np.unique(blocks[:, :2], axis=0))  # no column has a gap, so each has two ends
    assert areas(body)["surface"] == pytest.approx(6 * columns * A**2, rel=1e-9)
    outermost = int((blocks[:, 1] == 0).sum())
    for side in dd.SIDES:
        assert areas(body)[side] == pytest.approx(outermost * A**2, rel=1e-9)


def test_a_box_of_voxels_is_a_box(comm):
    body = dd.voxel_mesh(comm, box_cells(4, 3, 2), edge=A)
    box = dd.box(comm, elements=(4, 3, 2), size=(4 * A, 3 * A, 2 * A))
    assert dd.StrainOperator(body).global_dofs == dd.StrainOperator(box).global_dofs
    for side in dd.SIDES:
        assert areas(body)[side] == pytest.approx(areas(box)[side], rel=1e-9)
        np.testing.assert_allclose(body.extent(side), box.extent(side), atol=1e-18)
        dofs = [comm.allreduce(len(side_dofs(dd.StrainOperator(one), side))) for one in (body, box)]
        assert dofs[0] == dofs[1]


def test_regions_are_of_the_voxels_that_were_named(comm):
    places = box_cells(4, 3, 2)
    core = np.flatnonzero(places[:, 0] < 2)
    body = dd.voxel_mesh(comm, places, edge=A, refine=2, regions={"core": core, "first": [0], "all": np.arange(24)})
    assert {name: owned(body, name) for name in body.regions} == {"core": 12 * 8, "first": 8, "all": 24 * 8}
    x = body.mesh.geometry.x[dd.compat.geometry_nodes(body.mesh)].mean(axis=1)
    inside = np.isin(np.arange(body.owned_cells), body.regions["core"])
    assert np.array_equal(inside, x[:, 0] < 2 * A)


def test_further_sides(comm):
    body = dd.voxel_mesh(comm, ELL, edge=A, sides={"step": lambda x: np.isclose(x[:, 0], A) | np.isclose(x[:, 1], A)})
    assert areas(body)["step"] == pytest.approx(3 * A**2, rel=1e-9)
    assert areas(body)["surface"] == pytest.approx(18 * A**2, rel=1e-9)


def test_parts_and_hinges(comm):
    apart = dd.voxel_mesh(comm, [*ELL.tolist(), [5, 0, 0]], edge=A)
    assert apart.parts is not None
    counts = comm.allreduce(np.bincount(apart.parts[: apart.owned_cells], minlength=2))
    assert sorted(counts) == [1, 4]
    for hinged in ([*ELL.tolist(), [3, 1, 0]], [[0, 0, 0], [1, 1, 1]]):
        with pytest.raises(InputError, match="joined by faces, got 2 pieces in 1 part: some hang together at an edge"):
            dd.voxel_mesh(comm, hinged, edge=A)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"blocks": np.zeros((0, 3), dtype=int)}, "blocks: expected whole numbers of shape"),
        ({"blocks": np.zeros((2, 3))}, "blocks: expected whole numbers of shape .* got float64"),
        ({"blocks": [[0, 0, 0], [0, 0, 0]]}, "blocks: expected every voxel once"),
        ({"blocks": [[0, 0, 0], [2**30, 2**30, 2**30]]}, "blocks: expected places within a box"),
        ({"edge": -1.0}, "edge: expected a positive length"),
        ({"edge": np.nan}, "edge: expected a positive length"),
        ({"origin": (0.0, np.inf, 0.0)}, "origin: expected three finite"),
        ({"refine": 0}, "refine: expected a whole number of at least 1"),
        ({"regions": {"core": [7]}}, "region core: expected voxels from 0 to 3"),
        ({"regions": {"core": []}}, "region core: expected numbers of voxels"),
        ({"sides": {"left": lambda x: x[:, 0] > 0}}, "sides: expected names beside .* got 'left'"),
        ({"sides": {"none": lambda x: x[:, 0] > 1}}, "side none: expected some of 18 outer faces"),
    ],
)
def test_bad_input_is_told_to_all_ranks(comm, change, message):
    with pytest.raises(InputError, match=message):
        dd.voxel_mesh(comm, **({"blocks": ELL, "edge": A} | change))
