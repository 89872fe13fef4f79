"""Regions at the sides of a body: how many cells are where, on any number of ranks."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import dd_macro as dd

CLAMPS = {"bottom", "top"}


def counts(comm, elements, size, axes=(0, 1, 2), **sides):
    """Cells of every place, on all ranks, the size in blocks."""
    domain = dd.box(comm, elements=elements, size=size)
    free = set(domain.names) - CLAMPS
    regions = dd.edge_regions(domain, **{"held": CLAMPS, "free": free, "block": 1.0, "axes": axes, **sides})
    assert regions.places[0] == dd.INSIDE
    assert len(set(regions.places)) == len(regions.places)
    assert all(places == regions.places for places in comm.allgather(regions.places))
    mine = Counter(regions.places[k] for k in regions.cell)
    found: Counter[dd.Place] = Counter()
    for part in comm.allgather(mine):
        found.update(part)
    return dict(found)


def test_a_sheet(comm):
    found = counts(comm, (5, 4, 1), (5.0, 4.0, 1.0), axes=(0, 1))
    assert found == {
        ("", "", ""): 6,
        ("", "held", ""): 6,
        ("free", "", ""): 4,
        ("free", "held", ""): 4,
    }


def test_a_cube_has_faces_edges_and_corners(comm):
    found = counts(comm, (4, 4, 4), (4.0, 4.0, 4.0))
    assert found[dd.INSIDE] == 8
    assert found["", "held", ""] == found["free", "", ""] == found["", "", "free"] == 8
    assert found["free", "held", ""] == found["", "held", "free"] == found["free", "", "free"] == 8
    assert found["free", "held", "free"] == 8
    assert sum(found.values()) == 64


def test_finer_elements_share_the_edge_of_their_block(comm):
    assert counts(comm, (6, 8, 1), (3.0, 4.0, 1.0), axes=(0, 1))["", "held", ""] == 2 * 2 * 2 * 1
    assert counts(comm, (3, 12, 1), (3.0, 4.0, 1.0), axes=(0, 1))["", "held", ""] == 2 * 3 * 1


def test_one_block_across_is_an_edge_twice(comm):
    found = counts(comm, (1, 1, 1), (1.0, 1.0, 1.0), axes=(0, 1))
    assert found == {("free twice", "held twice", ""): 1}
    found = counts(comm, (4, 1, 1), (4.0, 1.0, 1.0), axes=(0, 1))
    assert found == {("", "held twice", ""): 2, ("free", "held twice", ""): 2}


def test_a_clamp_wins_where_both_meet(comm):
    found = counts(comm, (1, 3, 1), (1.0, 3.0, 1.0), axes=(0, 1), held={"left"}, free={"right"})
    assert found == {("held twice", "", ""): 3}


def test_elements_larger_than_a_block_have_no_edges(comm):
    assert counts(comm, (4, 4, 1), (4.4, 4.4, 1.0), axes=(0, 1)) == {dd.INSIDE: 16}
    # along one axis alone
    found = counts(comm, (4, 4, 1), (4.4, 4.0, 1.0), axes=(0, 1))
    assert found == {dd.INSIDE: 8, ("", "held", ""): 8}


def test_sides_that_are_neither(comm):
    found = counts(comm, (4, 4, 1), (4.0, 4.0, 1.0), axes=(0, 1), held=(), free={"left"})
    assert found == {dd.INSIDE: 12, ("free", "", ""): 4}


def test_places_without_data(comm):
    """A corner is what its clamp makes it, then of the inside."""
    domain = dd.box(comm, elements=(4, 4, 1), size=(4.0, 4.0, 1.0))
    regions = dd.edge_regions(domain, held=CLAMPS, free={"left", "right"}, block=1.0, axes=(0, 1))
    clamp, side, corner = ("", "held", ""), ("free", "", ""), ("free", "held", "")

    def cells(*there):
        found = regions.only(lambda place: place in there)
        assert found.places == (dd.INSIDE, *sorted(there))
        numbers = np.bincount(found.cell, minlength=len(found.places))
        return {p: int(n) for p, n in zip(found.places, comm.allreduce(numbers), strict=True)}

    assert cells(clamp, side, corner) == {dd.INSIDE: 4, clamp: 4, side: 4, corner: 4}
    assert cells(clamp, side) == {dd.INSIDE: 4, clamp: 8, side: 4}
    assert cells(clamp) == {dd.INSIDE: 8, clamp: 8}
    assert cells(side) == {dd.INSIDE: 12, side: 4}
    assert cells() == {dd.INSIDE: 16}


@pytest.mark.parametrize("points", [1, 8])
def test_the_region_of_points(comm, points):
    domain = dd.box(comm, elements=(3, 3, 1), size=(3.0, 3.0, 1.0))
    regions = dd.edge_regions(domain, held=CLAMPS, free=(), block=1.0)
    np.testing.assert_array_equal(regions.points(points).reshape(-1, points).T, np.tile(regions.cell, (points, 1)))
