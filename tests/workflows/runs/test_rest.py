"""The unstrained state is among the data of RVEs once, with its tangent, whatever their measure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES, join_paths, sample_paths
from tsg_micro.data.dataset import convert_dataset, join_datasets
from workflows.runs.rest import with_rest

INSIDE = RVESpec(Tissue(bar_force=5e-9), free=())


def sampled(spec, box="full", paths=2):
    done = sample_paths(spec.build(), BOXES[box], paths=range(paths), steps=2, seed=0)
    return join_paths(done, seed=0, parameters=spec.parameters(), versions={})


@pytest.mark.parametrize("measure", ["first_piola", "cauchy"])
def test_it_is_added_with_its_tangent_and_only_once(measure):
    data = convert_dataset(sampled(INSIDE), measure)
    found = with_rest(data)
    assert len(found) == len(data) + 1
    assert found.stress_measure == measure
    np.testing.assert_array_equal([found.strain[-1], found.stress[-1]], np.zeros((2, 6)))
    state = INSIDE.build().solve_strain(np.zeros(6))
    assert found.tangent is not None
    assert state.tangent is not None
    np.testing.assert_allclose(found.tangent[-1], state.tangent, rtol=1e-9, atol=1e-9 * np.abs(state.tangent).max())
    assert with_rest(found) is found
    assert RVESpec.of(found) == RVESpec.of(data)


def test_data_that_hold_it_stay_as_they_are():
    data = sampled(INSIDE)
    rest = RVESource(INSIDE).states(np.zeros((1, 6)), np.zeros((1, 6)))
    assert rest is not None
    joined = join_datasets(data, rest)
    assert with_rest(joined) is joined


def test_silent_components_stay_silent():
    data = sampled(RVESpec(Tissue(bar_force=5e-9)), box="inplane", paths=3)
    assert data.silent == ("yz", "xz")
    assert with_rest(data).silent == data.silent


def test_every_rve_has_its_own():
    """Data of the inside and of a held edge, whose clamps carry nothing at rest."""
    edge = INSIDE.with_axes("periodic held free")
    found = with_rest(join_datasets(sampled(INSIDE), sampled(edge)))
    still = np.flatnonzero(~found.strain.any(axis=1))
    assert len(still) == 2
    assert found.support is not None
    assert found.source is not None
    assert found.tangent is not None
    assert not found.support[still].any()
    specs = [RVESpec.from_parameters(found.sources[run]) for run in found.source[still]]
    assert [spec.faces for spec in specs if spec is not None] == [INSIDE.faces, edge.faces]
    assert np.abs(found.tangent[still[0]] - found.tangent[still[1]]).max() > 1.0


def test_points_without_tangents_and_measured_data():
    data = sampled(INSIDE)
    points = with_rest(replace(data, tangent=None))
    assert (len(points), points.tangent) == (len(data) + 1, None)
    measured = replace(data, parameters={}, source=None)
    assert with_rest(measured) is measured


def test_a_small_load_on_data_without_small_strains():
    """Random strains, the least of them 3 %: order 2 let a cube under 5 Pa swell; now it does as the tangent says."""
    spec = RVESpec.of_kind("bulk", Tissue(bar_force=1e-8))
    strains = np.random.default_rng(0).uniform(-0.06, 0.06, (60, 6)) * [1, 1, 1, 0.3, 0.3, 0.3]
    strains = strains[np.linalg.norm(strains, axis=1) > 0.03]
    source = RVESource(spec)
    data = source.states(strains, strains)
    assert data is not None
    rest = with_rest(data).tangent
    assert rest is not None
    operator = dd.StrainOperator(dd.box(MPI.COMM_SELF, elements=(2, 2, 2), size=(4e-5, 4e-5, 4e-5)))
    roller = [dd.Displacement(side, (0.0,), (axis,)) for axis, side in enumerate(("left", "bottom", "back"))]
    push = [dd.Traction("right", (-5.0, 0.0, 0.0)), dd.Traction("top", (0.0, -5.0, 0.0))]
    problem = dd.Problem(operator, roller, [*push, dd.Traction("front", (0.0, 0.0, -5.0))])
    right = -5.0 / rest[-1][0, :3].sum()
    errors = {}
    for name, given in (("without", data), ("with", with_rest(data))):
        solution = dd.METHODS["second order"].prepare(problem, dd.Material(given)).solve()
        errors[name] = abs(solution.mechanical.strain[:, 0].mean() / right - 1.0)
        estimate = dd.check_by_source(solution, [RVESource(spec)]).error
        assert (estimate > 0.3) == (name == "without")
    assert errors["without"] > 0.5
    assert errors["with"] < 0.02
