"""The RVE as a constitutive law: FE2 asks it for stress and tangent at every quadrature point.

Every point keeps its last RVE state: unknowns, their rate d y / d strain, stress and tangent. A point that moves
starts from the state nearest in strain, its own or one just found: those to solve for form a tree, the minimum
spanning tree of the strains with a root that stands for what they had, so that the jumps are as small as they can be.
A point within 1e-7 of a state takes that one along its tangent, which is exact to 1e-14 times the curvature; on the
reference state, which all points share at first, and where points see the same strain, nothing is solved twice.

With ``follow`` a point may be further off: by that part of its jump from what it had to where it is asked now. What the
tangent leaves out of its stress there is ``follow`` squared of what Newton's method leaves out by its own tangent, so
that it converges as fast and to the same, and needs few RVEs as long as it is far off.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial import cKDTree

from tsg_micro.continuum.rve import RVE
from tsg_micro.continuum.warm_rve import WarmRVE
from tsg_micro.continuum.warm_states import WarmStates
from tsg_micro.data.errors import ConvergenceError, InputError

__all__ = ["FOLLOW", "RVELaw", "leaders", "solution_tree"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_SAME, _NEIGHBOURS = 1e-7, 6
FOLLOW = 0.1
"""For Newton's method: what following leaves is hundredths of its own error."""


class RVELaw:
    """Symmetric first Piola stress and its tangent of an RVE under a symmetric displacement gradient.

    That is the definition of the material data; a datum with free components is one where their stress vanishes.

    Example:
        >>> law = tsg.RVELaw(tsg.RVESpec(free=()).build())
        >>> stress, tangent = law.stress_and_tangent(np.zeros((2, 6)))
        >>> stress.shape, tangent.shape
        ((2, 6), (2, 6, 6))
    """

    def __init__(self, rve: RVE, *, follow: float = 0.0) -> None:
        """``rve`` has no free components; it is moved about. ``follow`` is from 0 to less than 1.

        Raises:
            InputError: ``follow`` is out of range.
        """
        if not 0.0 <= follow < 1.0:
            raise InputError(f"follow: expected a number from 0 to less than 1, got {follow}")
        self.rve, self._warm, self.follow = rve, WarmRVE(rve), follow
        self.effort = self._warm.effort
        self._states: WarmStates | None = None

    def stress_and_tangent(self, strain: Array) -> tuple[Array, Array]:
        """Stress (n, 6) and tangent (n, 6, 6) in Pa of the strain (n, 6); point i starts from what it had before.

        Another number of points than in the last call starts from the reference state.

        Raises:
            ConvergenceError: an RVE lost its equilibrium; what was found until then is kept.
        """
        if self._states is None or len(self._states) != len(strain):
            self._states = self._warm.reference.take([0] * len(strain))
        states = self._states
        with self.effort.of(len(strain)):
            self._update(states, strain)
        change = strain - states.strain
        return states.stress + np.einsum("nij,nj->ni", states.tangent, change), states.tangent.copy()

    def support(self, strain: Array) -> Array:
        """What clamps carry beside the stress (n, 6), Pa, at the strain (n, 6) of the last call."""
        assert self._states is not None
        states = self._states
        return states.support + np.einsum("nij,nj->ni", states.support_tangent, strain - states.strain)

    @property
    def unstable(self) -> int:
        """Number of points whose RVE has negative pivots, which only motions without energy leave."""
        return 0 if self._states is None else int((self._states.negative_pivots > 0).sum())

    def _update(self, states: WarmStates, strain: Array) -> None:
        """Bring every state to within ``_SAME`` of its strain."""
        jump = _distance(strain, states.strain)
        moving = np.flatnonzero(jump > _SAME)
        leader = leaders(strain[moving], np.maximum(self.follow * jump[moving], _SAME))
        led = leader != np.arange(len(moving))
        leading = moving[~led]
        _, parent = solution_tree(strain[leading], states.strain[leading])
        solved, left = np.zeros(len(leading), dtype=bool), np.arange(len(leading))
        while len(left):  # generation by generation, each at once
            next_ones = (parent[left] < 0) | solved[parent[left]]
            k, left = left[next_ones], left[~next_ones]
            self._step(states, strain[leading[k]], leading[k], leading[np.where(parent[k] < 0, k, parent[k])])
            solved[k] = True
        states.put(moving[led], states.take(moving[leader[led]]))

    def _step(self, states: WarmStates, strain: Array, places: Index, sources: Index) -> None:
        """Put states at ``strain`` into ``places``, from those in the places ``sources``."""
        found, reached, failures = self._warm.solve_many(strain, states.take(sources))
        states.put(places[reached], found)
        if failures:
            first = min(failures)
            lost = np.array2string(strain[first], precision=4)
            raise ConvergenceError(f"RVE at strain {lost}: {failures[first]}")


def leaders(strain: Array, radius: Array) -> Index:
    """For each of n strains (n, 6) the number of one that leads it, itself or one within its ``radius`` (n,).

    Leaders lead themselves. Those of small radius are the first to become one, and the others then follow.
    """
    n = len(strain)
    leader = np.arange(n)
    if n < 2:
        return leader
    tree = cKDTree(strain)
    near, _ = tree.query(strain, k=2)
    together = np.flatnonzero(near[:, 1] <= radius.max())
    unled = np.zeros(n, dtype=bool)
    unled[together] = True
    for k in together[np.argsort(radius[together], kind="stable")]:
        if not unled[k]:
            continue
        unled[k] = False
        around = np.array(tree.query_ball_point(strain[k], 2.0 * radius[k]))
        around = around[unled[around]]
        led = around[_distance(strain[around], strain[k]) <= radius[around]]
        leader[led], unled[led] = k, False
    return leader


def solution_tree(strain: Array, previous: Array) -> tuple[Index, Index]:
    """Order in which to solve for ``strain`` (n, 6), and where each point starts from: a point before it, or -1.

    -1 is the point's ``previous`` state (n, 6). The sum of the jumps in strain is the least among the tree's edges to
    the nearest neighbours and to the previous states.
    """
    n = len(strain)
    if n == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    points = np.arange(n)
    row, column, length = points, np.full(n, n), _distance(strain, previous)
    if n > 1:
        near, neighbour = cKDTree(strain).query(strain, k=min(_NEIGHBOURS, n - 1) + 1)
        row = np.concatenate([row, np.repeat(points, near.shape[1])])
        column, length = np.concatenate([column, neighbour.ravel()]), np.concatenate([length, near.ravel()])
    keep = row != column
    low, high = np.minimum(row, column)[keep], np.maximum(row, column)[keep]
    edges, first = np.unique(low * (n + 1) + high, return_index=True)
    ends = np.stack([edges // (n + 1), edges % (n + 1)]).astype(np.int32)  # older SciPy knows no other integers here
    # an edge of length 0 would be none
    graph = sp.csr_array((length[keep][first] + 1e-15, tuple(ends)), shape=(n + 1, n + 1))
    order, parent = breadth_first_order(minimum_spanning_tree(graph), n, directed=False)
    parent = np.where(parent[:n] == n, -1, parent[:n])
    return order[1:].astype(np.int64), parent.astype(np.int64)


def _distance(a: Array, b: Array) -> Array:
    return np.asarray(np.linalg.norm(a - b, axis=-1))
