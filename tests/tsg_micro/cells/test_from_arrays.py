"""Structures from arrays of other programs: whole doubles are numbers of nodes, all else is named."""

from __future__ import annotations

import numpy as np
import pytest

from tsg_micro.cells.structure import from_arrays
from tsg_micro.data.errors import InputError

NODES = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
MEMBERS = np.array([[0, 1], [1, 2], [2, 3], [0, 3]])
GOOD = {"nodes": NODES, "members": MEMBERS, "kind": [2, 0, 1, 1], "EA": np.ones(4), "rest_length": np.ones(4)}


def build(**change):
    values = {**GOOD, **change}
    return from_arrays(values.pop("nodes"), values.pop("members"), **values)


def test_whole_doubles_and_lists_are_taken():
    one, other = build(), build(members=MEMBERS.astype(float), kind=np.array([2.0, 0.0, 1.0, 1.0]), EA=[1, 1, 1, 1])
    for name in ("nodes", "members", "kind", "EA", "rest_length"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert getattr(one, name).dtype == getattr(other, name).dtype
    assert one.bars.tolist() == [True, False, False, False]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"members": MEMBERS + 1}, r"members: expected pairs of node numbers below 4, .* got 1 to 4"),
        ({"members": MEMBERS - 0.5}, "members: expected whole numbers, got -0.5"),
        ({"members": MEMBERS * np.nan}, "members: expected whole numbers, got NaN"),
        ({"members": [[0, 1], [1, 2], [2, 3], [0]]}, "members: expected whole numbers, got rows of different"),
        ({"members": np.vstack([MEMBERS[:3], [1, 0]])}, r"members: expected each once, got 0-1 2 times \(member 0\)"),
        ({"members": np.vstack([MEMBERS[:3], [2, 2]])}, r"got a member of length 0 \(member 3\)"),
        ({"members": np.zeros((0, 2))}, r"shape \(m, 2\), got none"),
        ({"members": MEMBERS.ravel()}, r"shape \(m, 2\), got 0 to 3 in shape \(8,\)"),
        ({"members": 3}, "members: expected"),
        ({"nodes": np.vstack([NODES, [5, 5, 5]])}, "nodes: expected a member at every node, got none at 4"),
        ({"nodes": NODES[:, :2]}, r"nodes: expected finite coordinates of shape \(n, 3\)"),
        ({"nodes": NODES + np.inf}, "nodes: expected finite coordinates"),
        ({"nodes": NODES + 1j}, "nodes: expected finite coordinates"),
        ({"kind": ["bar", "string", "string", "string"]}, r"kind: expected whole numbers, got \['bar'\]"),
        ({"kind": [2, 0, 1, 3]}, r"kind: expected 0 or 1 \(tendons\) or 2 \(bar\), got 3"),
        ({"kind": [2, 0, 1, 258]}, "got 258"),
        ({"kind": [2, 0, 1]}, r"kind: expected shape \(4,\), got \(3,\)"),
        ({"EA": "stiff"}, r"EA: expected positive numbers, got \['stiff'\]"),
        ({"EA": [1, 1, 1, 0]}, "EA: expected positive numbers, got a minimum of 0"),
        ({"rest_length": [1, 1, 1, None]}, "rest_length: expected positive numbers"),
    ],
)
def test_the_rest_is_named(change, message):
    with pytest.raises(InputError, match=message):
        build(**change)
