"""Points of a solution that stand for all of it: drawn with chances of one's choice, the same on any number of ranks.

A field f with the sum S = sum w f over the points of volume w is known at a few points only. If point i is among them
with the chance pi_i, then the sum of w_i f_i / pi_i over those drawn is S in the mean, whatever f is, and varies least
where pi goes with w f. So the chances are half of the volume, and half of where f is expected to be large.

The points are drawn without replacement by Rosen's Pareto sampling: those with the least u (1 - pi) / (pi (1 - u)),
u a pseudo-random number of the point. u is made of the number of the cell in the mesh that was read or built, so
neither the number of ranks nor the run decides what is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro.methods.points import point_keys
from dd_macro.parallel import total
from dd_macro.scene.spaces import StrainOperator

__all__ = ["Drawn", "draw", "shares"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Drawn:
    """The points drawn, k of all ranks, the same on every rank: ``weight`` (k,) in m^3 is the volume w / pi that each
    stands for, ``strain`` (k, 6), ``stress`` (k, 6) in Pa, ``region`` (k,) and ``bar_force`` (k,) in N are theirs; the
    last is 0 where it is one in the region.
    """

    weight: Array
    strain: Array
    stress: Array
    region: NDArray[np.int64]
    bar_force: Array


def shares(comm: MPI.Comm, weights: Array, expected: Array) -> Array:
    """Chances (n,), up to a factor, of points of volume ``weights`` (n,): half of them of volume, half of ``expected``.

    ``expected`` (n,) is what f is thought to go with, from 0 upwards; collective.
    """
    sums = total(comm, [float(weights.sum()), float(weights @ expected)])
    return weights / sums[0] + (weights * expected / sums[1] if sums[1] > 0 else 0.0)


def draw(
    operator: StrainOperator,
    share: Array,
    count: int,
    *,
    strain: Array,
    stress: Array,
    region: NDArray[np.int64],
    bar_force: Array | None = None,
) -> Drawn:
    """Draw ``count`` points, or all there are, with chances that go with ``share`` (n,), positive; collective."""
    comm, n = operator.comm, len(share)
    force = np.zeros(n) if bar_force is None else bar_force
    count = min(count, int(total(comm, n)))
    chance = _chances(comm, share, count)
    u = (point_keys(operator) >> np.uint64(11)).astype(float) / 2.0**53
    with np.errstate(divide="ignore"):
        turn = np.where(chance < 1.0, u * (1.0 - chance) / (chance * (1.0 - u)), -1.0)
    first = np.argsort(turn, kind="stable")[:count]
    mine = np.column_stack([turn, operator.weights / chance, strain, stress, region, force])[first]
    rows = np.concatenate(comm.allgather(mine))
    rows = rows[np.lexsort((rows[:, 2], rows[:, 0]))[:count]]
    return Drawn(rows[:, 1], rows[:, 2:8], rows[:, 8:14], rows[:, 14].astype(np.int64), rows[:, 15])


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
