"""The scene of a run: what its clamps hold, and what is refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from dd_macro.results.compare_bodies import block_means, inner_blocks
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.dataset import Dataset, take
from tsg_micro.data.dataset_file import write_dataset
from tsg_micro.data.errors import InputError
from workflows.runs.scene import ELEMENTS, Scene

BLOCK = Tissue().block
C = dd.isotropic(young=1e3, poisson=0.3).C


def strains(scene):
    """Strains of a linear elastic sheet whose width is held."""
    problem = scene.problem(MPI.COMM_SELF)
    sides = [dd.Displacement(side, (0.0,), (0,)) for side in ("left", "right")]
    result = dd.solve_law(problem.operator, dd.LinearLaw(C, np.zeros(6)), [*sides, *problem.supports])
    return problem.operator, result


@pytest.mark.parametrize(("nz", "degree", "flat"), [(1, 1, False), (2, 1, True), (1, 2, False), (1, 1, True)])
def test_sheet_held_in_its_plane_is_in_plane_strain_and_stress(nz, degree, flat):
    """Its width held and its thickness free: eps_zz = -nu / (1 - nu) eps_yy everywhere, at the clamps too."""
    scene = Scene("stretch", 0.02, (3, 4, nz), clamp="inplane", degree=degree, flat=flat)
    operator, result = strains(scene)
    expected = np.zeros(6)
    expected[1], expected[2] = 0.02, -0.3 / 0.7 * 0.02
    np.testing.assert_allclose(
        result.mechanical.strain, np.broadcast_to(expected, (len(operator.weights), 6)), atol=1e-12
    )
    force = 1e3 / (1 - 0.3**2) * 0.02 * 3 * BLOCK * nz * BLOCK
    np.testing.assert_allclose(result.reactions["top"], [0.0, force, 0.0], atol=1e-9 * force)


def test_full_clamp_holds_the_thickness():
    operator, full = strains(Scene("stretch", 0.02, (3, 4, 1)))
    _, inplane = strains(Scene("stretch", 0.02, (3, 4, 1), clamp="inplane"))
    y = operator.node_coordinates()[:, 1]
    ends = (y < 1e-9) | (y > y.max() - 1e-9)
    nodal = slice(3 * operator.owned_nodes)
    assert not full.mechanical.u[nodal].reshape(-1, 3)[ends, 2].any()
    assert inplane.mechanical.u[nodal].reshape(-1, 3)[ends, 2].any()
    assert full.reactions["top"][1] > inplane.reactions["top"][1]


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_element_of_the_scene(kinematics):
    """It is the one asked for, the default or none of degree 2, as the summary says."""
    for more, name, unknowns in (
        ({}, ELEMENTS[0], {"trilinear": 96, "enhanced": 96 + 9 * 9}[ELEMENTS[0]]),
        ({"element": "trilinear"}, "trilinear", 96),
        ({"element": "enhanced"}, "enhanced", 96 + 9 * 9),
        ({"degree": 2}, None, 3 * 7 * 7 * 3),
    ):
        scene = Scene("stretch", 0.02, (3, 3, 1), kinematics=kinematics, graded=False, **more)
        assert scene.parameters()["element"] == name
        assert scene.problem(MPI.COMM_SELF).operator.owned_dofs == unknowns


def test_halved_blocks_come_nearer_to_a_fine_mesh():
    """Beside the corners of a clamped sheet: means of blocks, the outer ones left out, of one and the same law."""

    def stress(**more):
        problem = Scene("stretch", 0.02, (6, 6, 1), **more).problem(MPI.COMM_SELF)
        result = dd.solve_law(problem.operator, dd.LinearLaw(C, np.zeros(6)), problem.supports)
        operator = problem.operator
        volume = operator.weights.reshape(-1, operator.points_per_cell).sum(axis=1)
        blocks = np.stack(np.meshgrid(*[np.arange(6) + 0.5] * 2, [0.5], indexing="ij"), axis=-1).reshape(-1, 3) * BLOCK
        mean = operator.cell_mean(result.mechanical.stress)
        found = block_means(operator.cell_corners.mean(axis=1), volume, mean, blocks, BLOCK)
        return found[inner_blocks(blocks, BLOCK)]

    fine = stress(refine=4, graded=False)
    coarse, graded = (np.linalg.norm(stress(graded=on) - fine) for on in (False, True))
    assert graded < 0.5 * coarse


def test_default_scenes_are_graded_where_it_pays():
    for given, on in (
        (Scene("stretch", 0.02, (6, 4, 1)), True),
        (Scene("stretch", 0.02, (6, 4, 2)), False),
        (Scene("stretch", 0.02, (6, 4, 1), element="trilinear"), False),
        (Scene("stretch", 0.02, (6, 4, 1), degree=2), False),
        (Scene("stretch", 0.02, (6, 4, 1), graded=False), False),
        (Scene("stretch", 0.02, (6, 4, 2), graded=True), True),
        (Scene("stretch", 0.02, mesh=Path("any.msh")), False),
    ):
        assert given.parameters()["graded"] is on
    whole = Scene("stretch", 0.02, (6, 4, 2), graded=True, flat=True).build(MPI.COMM_SELF)
    assert whole.global_cells == 10 * 8 * 4
    with pytest.raises(InputError, match="graded: expected a box"):
        Scene("stretch", 0.02, mesh=Path("any.msh"), graded=True)


def test_a_flat_sheet_needs_its_back():
    scene = Scene("stretch", 0.02, (3, 3, 1), flat=True)
    domain = scene.build(MPI.COMM_SELF)
    sides = {name: tag for name, tag in domain.names.items() if name in ("bottom", "top")}
    with pytest.raises(InputError, match="flat: expected a side named back in the mesh, got bottom, top"):
        scene.supports(dataclasses.replace(domain, names=sides))


def test_tangents_of_few_data(tsgdd, tmp_path):
    strain, n = 0.01 * np.vstack([np.eye(6), -np.eye(6)]), np.arange(12)
    few = Dataset(strain, strain @ C, "first_piola", path=n, step=n)
    found = dd.TangentMethod().search(few, dd.Metric(C, "of the law")).dataset
    assert found.tangent is not None  # of less than 16 neighbours
    assert np.isfinite(found.tangent).all()
    write_dataset(tmp_path / "three.h5", take(few, n[:3]))
    scene = ("--elements", 3, 3, 1, "--load", "stretch", "--strain", 0.005, "--order", 2)
    done = tsgdd("solve", "--data", tmp_path / "three.h5", *scene, "--out", tmp_path / "out")
    assert done.code == 2
    assert "data: expected tangents, or at least 4 points" in done.err


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"kinematics": "large"}, "kinematics: expected small or finite, got 'large'"),
        ({"clamp": "none"}, "clamp: expected full or inplane, got 'none'"),
        ({"degree": 3}, "degree: expected 1 or 2, got 3"),
        ({"element": "cubic"}, "element: expected .*, of degree 1, got 'cubic' of degree 1"),
        ({"element": "enhanced", "degree": 2}, "element: expected .* got 'enhanced' of degree 2"),
    ],
)
def test_errors(wrong, text):
    with pytest.raises(InputError, match=text):
        Scene("stretch", 0.05, (3, 3, 1), **wrong)
