"""A material by regions: searches and laws of the parts, put together, say what each says of its own points."""

from __future__ import annotations

import numpy as np
import pytest

import dd_macro as dd
from dd_macro.material.regional import RegionalLaw, RegionalTangentSearch, join_parts, search_in_regions

METRIC = dd.Metric(dd.isotropic(young=1e3, poisson=0.3).C, "steel")


@pytest.fixture
def parts(rng, make_dataset):
    """Data of three tissues, 20, 30 and 40 points."""
    found = []
    for k, n in enumerate((20, 30, 40)):
        A = rng.normal(size=(n, 6, 6))
        strain = 0.01 * rng.normal(size=(n, 6))
        data = {"strain": strain, "stress": (k + 1) * strain @ METRIC.C, "tangent": A + A.transpose(0, 2, 1)}
        found.append(make_dataset(**data, parameters={"tissue": k}))
    return found


@pytest.fixture
def points(rng):
    strain = 0.01 * rng.normal(size=(200, 6))
    return rng.integers(0, 3, 200), strain, strain @ METRIC.C


@pytest.mark.parametrize("kind", [dd.MaterialSearch, dd.TangentSearch])
def test_nearest_data_are_those_of_the_parts(kind, parts, points):
    region, strain, stress = points
    search = search_in_regions([kind(part, METRIC) for part in parts], region)
    z = METRIC.whiten(strain, stress)
    index, distance = search.nearest(z)
    joined = join_parts(parts)
    assert joined.source is not None
    assert len(search.dataset) == len(joined) == 90
    for k, (part, begin) in enumerate(zip(parts, (0, 20, 50), strict=True)):
        at = region == k
        alone, away = kind(part, METRIC).nearest(z[at])
        np.testing.assert_array_equal(index[at], begin + alone)
        np.testing.assert_array_equal(distance[at], away)
        np.testing.assert_array_equal(joined.stress[index[at]], part.stress[alone])
        assert (joined.source[index[at]] == k).all()
    assert search.queries == 200


def test_tangent_spaces_are_those_of_the_parts(parts, points):
    region, strain, stress = points
    search = search_in_regions([dd.TangentSearch(part, METRIC) for part in parts], region)
    assert isinstance(search, RegionalTangentSearch)
    spaces = search.spaces(strain, stress)
    again = search.of(spaces.index)
    for k, (part, begin) in enumerate(zip(parts, (0, 20, 50), strict=True)):
        at = region == k
        alone = dd.TangentSearch(part, METRIC).spaces(strain[at], stress[at])
        for name in ("strain", "stress", "tangent", "reach"):
            np.testing.assert_array_equal(getattr(spaces, name)[at], getattr(alone, name))
            np.testing.assert_array_equal(getattr(again, name)[at], getattr(alone, name))
        np.testing.assert_array_equal(spaces.index[at], begin + alone.index)


def test_one_part_is_itself(parts):
    search = dd.MaterialSearch(parts[0], METRIC)
    assert search_in_regions([search], np.zeros(5, dtype=np.int64)) is search


def test_a_law_of_equal_parts_is_the_law(points):
    region, strain, _ = points
    law = dd.LinearLaw(METRIC.C, np.arange(6.0))
    regional = RegionalLaw([law, law, law], region)
    for found, expected in zip(regional.stress_and_tangent(strain), law.stress_and_tangent(strain), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-14)
    np.testing.assert_array_equal(regional.support(strain), 0.0)


def test_a_sheet_whose_regions_are_alike_is_one_without(comm):
    """Newton's method and two methods with data, whose parts hold the same."""
    law = dd.LinearLaw(METRIC.C, np.zeros(6))
    solutions = []
    for held in ((), ("bottom", "top")):
        domain = dd.box(comm, elements=(4, 4, 1), size=(4.0, 4.0, 1.0))
        regions = dd.edge_regions(domain, held=held, free=held and ("left",), block=1.0, axes=(0, 1))
        assert len(regions.places) == (4 if held else 1)
        clamps = [dd.Displacement("bottom"), dd.Displacement("top", (0.01, 0.05, 0.0))]
        problem = dd.Problem(dd.THEORIES["small"].operator(domain), clamps, regions=regions)
        parts = tuple(dd.Material(law=law) for _ in regions.places)
        solutions.append(dd.LawMethod().prepare(problem, dd.Material(law=law, parts=parts)).solve())
    a, b = (solution.mechanical for solution in solutions)
    np.testing.assert_allclose(b.strain, a.strain, atol=1e-13)
    np.testing.assert_allclose(b.stress, a.stress, atol=1e-13 * 1e3)
