"""Clusters of the strains of a scene where its data leave the most error: error-weighted k-means, on any ranks.

The tangent of a datum at distance r = |epsilon - epsilon_i| in the metric leaves an error of stress of second order in
r, so that of a scene is the sum of w r^4 over its quadrature points of volume w. The cluster of points around a centre
with the largest share of it is split along its principal direction, again and again; then all new centres move to the
mean of their points with the weights w r^2, which lowers that sum, while the data, also centres, stay where they are.
The ranks share nothing but sums over their points.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dd_macro.parallel import total

__all__ = ["cluster"]

Array = NDArray[np.float64]
_MOVES, _TIE, _NOTHING = 8, 1e-6, 1e-8
_UNEVEN = 1e-4
"""By which coordinates are told apart where a symmetry of the scene makes them equal but for round-off."""
_GENERIC = np.array([1.0, 0.83, 0.71, 0.59, 0.47, 0.37, 0.29])
"""No symmetry of a scene leaves it as it is: it says which of two ends of a line comes first."""


def cluster(comm: MPI.Comm, x: Array, weights: Array, fixed: Array, *, count: int) -> tuple[Array, NDArray[np.int64]]:
    """At most ``count`` new places (k, d) for points at ``x`` (n, d), and the datum that each one started from.

    Places are strains in the metric, epsilon L of C = L L^T, and further coordinates (dd_macro.material.graded).
    Points (of all ranks) have volumes ``weights`` (n,), ``fixed`` (N, d) are places that have a datum already.
    """
    centres = fixed
    parent = np.arange(len(fixed))
    owner, r2 = _assign(x, fixed)
    square, volume = total(comm, np.array([weights @ (x**2).sum(axis=1), weights.sum()]))
    scale = float(square / volume) if volume > 0 else 0.0  # a part of the body may be all edge
    for _ in range(count):
        cost = total(comm, np.bincount(owner, weights * r2**2, minlength=len(centres)))
        if cost.max() <= (_NOTHING * scale) ** 2 * volume:
            break
        split = int(np.flatnonzero(cost >= (1 - _TIE) * cost.max())[0])  # the first of those equal but for round-off
        mine = owner == split
        off, share = x[mine] - centres[split], (weights * r2)[mine]
        scatter = total(comm, np.einsum("n,ni,nj->ij", share, off, off))
        uneven = 1.0 + _UNEVEN * _GENERIC[: len(scatter)]
        axes = np.linalg.eigh(uneven[:, None] * scatter * uneven).eigenvectors
        axis = axes[:, -1] * np.where(axes[:, -1] @ _GENERIC[: len(axes)] < 0, -1.0, 1.0)
        along = off @ axis
        sides = (along > 0, along <= 0)
        ends = [total(comm, [share[i] @ along[i] ** 2, share[i].sum(), *(share[i] @ off[i])]) for i in sides]
        end = ends[1] if ends[1][0] > (1 + _TIE) * ends[0][0] else ends[0]
        if end[1] <= 0:
            break
        centres = np.vstack([centres, centres[split] + end[2:] / end[1]])
        parent = np.append(parent, parent[split])
        nearer = ((x - centres[-1]) ** 2).sum(axis=1)
        owner = np.where(nearer < r2, len(centres) - 1, owner)
        r2 = np.minimum(r2, nearer)
    old = len(fixed)
    for _ in range(_MOVES):
        share = weights * r2
        mass = np.bincount(owner, share, minlength=len(centres))
        moment = np.column_stack([np.bincount(owner, share * column, minlength=len(centres)) for column in x.T])
        sums = total(comm, np.column_stack([mass, moment]))[old:]
        moved = sums[:, 0] > 0
        centres[old:][moved] = sums[moved, 1:] / sums[moved, :1]
        owner, r2 = _assign(x, centres)
    return centres[old:], parent[old:]


def _assign(x: Array, centres: Array) -> tuple[NDArray[np.int64], Array]:
    """The nearest centre (n,) of points (n, 6), and the square of the distance."""
    distance, owner = cKDTree(centres).query(x)
    return np.asarray(owner, dtype=np.int64), np.asarray(distance) ** 2
