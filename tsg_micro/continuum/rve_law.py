"""The RVE as a constitutive law: FE2 asks it for stress and tangent at every quadrature point.

Every point keeps its last RVE state: unknowns, their rate d y / d strain, stress and tangent. A point that moves
starts from the state nearest in strain, its own or one just found: those to solve for form a tree, the minimum
spanning tree of the strains with a root that stands for what they had, so that the jumps are as small as they can be.
A point within 1e-7 of a state takes that one along its tangent, which is exact to 1e-14 times the curvature; on the
reference state, which all points share at first, and where points see the same strain, nothing is solved twice.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, fields

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from tsg_micro.continuum.rve import RVE, RVEState, build_rve
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import to_mandel

__all__ = ["Effort", "RVELaw", "sheet_rve", "solution_tree"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_SAME, _NEIGHBOURS = 1e-7, 6


def sheet_rve(bar_force: float) -> RVE:
    """One block of a sheet whose strains are all six prescribed, bar force in N.

    Raises:
        InputError: the bar force is not valid.
    """
    return build_rve(bar_force=bar_force, free=())


@dataclass
class Effort:
    """What a law has done so far."""

    calls: int = 0
    points: int = 0
    """States that were asked for."""
    solves: int = 0
    """RVEs that were solved; the others followed a tangent."""
    iterations: int = 0
    """Newton iterations of the RVEs."""
    factorisations: int = 0
    seconds: float = 0.0

    def numbers(self) -> Array:
        """All of it as an array, which can be summed over ranks."""
        return np.array([getattr(self, field.name) for field in fields(self)], dtype=float)


class RVELaw:
    """Symmetric first Piola stress and its tangent of an RVE under a symmetric displacement gradient.

    That is the definition of the material data; a datum with free components is one where their stress vanishes.
    """

    def __init__(self, rve: RVE) -> None:
        """``rve`` has no free components; it is moved about."""
        self.rve = rve
        self.effort = Effort()
        rve.reset()
        self._reference = _States.of(rve.solve_strain(np.zeros(6)), rve)
        self._states: _States | None = None

    def stress_and_tangent(self, strain: Array) -> tuple[Array, Array]:
        """Stress (n, 6) and tangent (n, 6, 6) in Pa of the strain (n, 6); point i starts from what it had before.

        Another number of points than in the last call starts from the reference state.

        Raises:
            ConvergenceError: an RVE lost its equilibrium; what was found until then is kept.
        """
        begin = time.perf_counter()
        if self._states is None or len(self._states.strain) != len(strain):
            self._states = self._reference.repeated(len(strain))
        states = self._states
        try:
            with threadpool_limits(1):
                self._update(states, strain)
        finally:
            self.effort.calls += 1
            self.effort.points += len(strain)
            self.effort.seconds += time.perf_counter() - begin
        change = strain - states.strain
        return states.stress + np.einsum("nij,nj->ni", states.tangent, change), states.tangent.copy()

    @property
    def unstable(self) -> int:
        """Number of points whose RVE has negative pivots, which only motions without energy leave."""
        return 0 if self._states is None else int((self._states.negative_pivots > 0).sum())

    def _update(self, states: _States, strain: Array) -> None:
        """Bring every state to within ``_SAME`` of its strain."""
        moving = np.flatnonzero(_distance(strain, states.strain) > _SAME)
        order, parent = solution_tree(strain[moving], states.strain[moving])
        for k in order:
            i = moving[k]
            source = i if parent[k] < 0 else moving[parent[k]]
            if _distance(strain[i], states.strain[source]) <= _SAME:
                states.put(i, states, source)
            else:
                states.put(i, self._solve(states, source, strain[i]), 0)

    def _solve(self, states: _States, source: int, strain: Array) -> _States:
        """The state at ``strain``, from that in place ``source``."""
        solver = self.rve.solver
        solver.move_to(states.unknowns[source], np.zeros(solver.system.nodal_size))
        try:
            state = self.rve.solve_strain(strain, rate=states.rate[source])
        except (ConvergenceError, InputError) as error:  # inside out: a trial that went too far
            raise ConvergenceError(f"RVE at strain {np.array2string(strain, precision=4)}: {error}") from None
        self.effort.solves += 1
        self.effort.iterations += state.equilibrium.iterations
        self.effort.factorisations += state.equilibrium.factorisations
        return _States.of(state, self.rve)


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


@dataclass(frozen=True)
class _States:
    """States of n points, about 11 kB each for one block; every array has a leading axis n."""

    strain: Array
    unknowns: Array
    rate: NDArray[np.float32]
    """Single precision: it only makes a first guess."""
    stress: Array
    tangent: Array
    negative_pivots: Index

    @classmethod
    def of(cls, state: RVEState, rve: RVE) -> _States:
        """The state in which ``rve`` is now, of one point."""
        assert state.tangent is not None
        assert state.rate is not None
        return cls(
            state.strain[None],
            rve.solver.y[None].copy(),
            state.rate[None].astype(np.float32),
            to_mandel(state.first_piola)[None],
            state.tangent[None],
            np.array([state.equilibrium.negative_pivots or 0]),
        )

    def repeated(self, n: int) -> _States:
        """The first state, n times."""
        return _States(*(np.repeat(getattr(self, field.name)[:1], n, axis=0) for field in fields(self)))

    def put(self, i: int, other: _States, k: int) -> None:
        """State k of ``other`` in place i."""
        for field in fields(self):
            getattr(self, field.name)[i] = getattr(other, field.name)[k]
