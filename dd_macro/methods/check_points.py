"""Points of a solution that stand for all of it: drawn with chances of one's choice, the same on any number of ranks.

A field f with the sum S = sum w f over the points of volume w is known at a few points only. If point i is among them
with the chance pi_i, then the sum of w_i f_i / pi_i over those drawn is S in the mean, whatever f is, and varies least
where pi goes with w f. So the chances are half of the volume, and half of where f is expected to be large.

Points of one group, as those with the same datum, are alike. So the chances of the groups are laid end to end, and each
group gets as many points as there are whole numbers along its part (systematic sampling); a group whose chances sum to
1 is never left out. Within a group they are drawn without replacement by Rosen's Pareto sampling: those with the least
u (1 - c) / (c (1 - u)), c the chance among its group and u a pseudo-random number of the point. u is made of the number
of the cell in the mesh that was read or built, so neither the number of ranks nor the run decides what is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro.methods.points import point_keys
from dd_macro.parallel import total
from dd_macro.scene.spaces import StrainOperator

__all__ = ["Drawn", "Points", "draw", "shares"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_START = 0.381966
"""Where the whole numbers lie along the chances; no simple fraction, at which round-off would decide."""


@dataclass(frozen=True)
class Points:
    """What of the n points of this rank is kept of those drawn: ``strain`` (n, 6), ``stress`` (n, 6) in Pa and what
    clamps carry beside it, ``support`` (n, 6), ``region`` (n,), ``bar_force`` (n,) in N, 0 where it is one in the
    region; and the ``group`` (n,) of each, of so many ``groups``.
    """

    strain: Array
    stress: Array
    support: Array
    region: Index
    bar_force: Array
    group: Index
    groups: int


@dataclass(frozen=True)
class Drawn:
    """The points drawn, k of all ranks, the same on every rank: ``weight`` (k,) in m^3 is the volume w / pi that each
    stands for, the others are theirs as in :class:`Points`.
    """

    weight: Array
    strain: Array
    stress: Array
    support: Array
    region: Index
    bar_force: Array


def shares(comm: MPI.Comm, weights: Array, expected: Array) -> Array:
    """Chances (n,), up to a factor, of points of volume ``weights`` (n,): half of them of volume, half of ``expected``.

    ``expected`` (n,) is what f is thought to go with, from 0 upwards; collective.
    """
    sums = total(comm, [float(weights.sum()), float(weights @ expected)])
    return weights / sums[0] + (weights * expected / sums[1] if sums[1] > 0 else 0.0)


def draw(operator: StrainOperator, points: Points, share: Array, count: int) -> Drawn:
    """Draw ``count`` points, or all there are, with chances that go with ``share`` (n,), positive; collective."""
    comm, n = operator.comm, len(share)
    count = min(count, int(total(comm, n)))
    chance = _chances(comm, share, count)
    certain = chance >= 1.0
    group = points.group
    part = total(comm, np.bincount(group, np.where(certain, 0.0, chance), minlength=points.groups))
    wanted = np.diff(np.floor(np.cumsum(part) + _START), prepend=0.0).astype(np.int64)
    u = (point_keys(operator) >> np.uint64(11)).astype(float) / 2.0**53
    own = np.clip(wanted[group] * chance / np.maximum(part[group], 1e-300), 1e-300, 1.0 - 1e-9)
    turn = np.where(certain, -1.0, u * (1.0 - own) / (own * (1.0 - u)))
    of_points = (points.strain, points.stress, points.support, points.region, points.bar_force)
    mine = np.column_stack([turn, group, operator.weights / chance, *of_points])
    rows = _first(mine[certain | (wanted[group] > 0)], wanted)  # no more than this rank can have among all
    rows = _first(np.concatenate(comm.allgather(rows)), wanted)
    return Drawn(rows[:, 2], rows[:, 3:9], rows[:, 9:15], rows[:, 15:21], rows[:, 21].astype(np.int64), rows[:, 22])


def _first(rows: Array, wanted: Index) -> Array:
    """Of rows with their turn and group, those that are certain and the first ``wanted`` (groups,) of each group."""
    rows = rows[np.lexsort((rows[:, 3], rows[:, 0], rows[:, 1]))]
    certain, group = rows[:, 0] < 0.0, rows[:, 1].astype(np.int64)
    sizes = np.bincount(group, ~certain, minlength=len(wanted)).astype(np.int64)
    before = np.concatenate([[0], np.cumsum(sizes)[:-1]])  # certain ones, first of their group, do not count
    place = np.cumsum(~certain) - 1 - before[group]
    return np.asarray(rows[certain | (place < wanted[group])])


def _chances(comm: MPI.Comm, share: Array, count: int) -> Array:
    """Chances (n,) that sum to ``count``; those that would be above 1 are certain, and the others share the rest."""
    certain = np.zeros(len(share), dtype=bool)
    while True:
        taken, rest, points = total(comm, np.array([certain.sum(), share[~certain].sum(), (~certain).sum()]))
        if points == 0:
            return np.ones(len(share))
        chance = np.where(certain, 1.0, (count - taken) * share / rest)
        above = ~certain & (chance >= 1.0)
        if not total(comm, above.sum()):
            return chance
        certain |= above
