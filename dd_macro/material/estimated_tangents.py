"""Tangents of data that came without: local principal components of the strain, and least squares in their directions.

At each datum the neighbours' strains and stresses, whitened by a metric C, are taken about their means with the weights
(1 - r^2/R^2)^2, R the distance of the outermost neighbour. The principal components of the strain with more than 2 %
of the largest variance are the directions t that the data span, the others, n, are silent. In these directions
D = [[D_tt, D_tn], [D_nt, D_nn]]:

    D_tt, D_tn    least squares of stress over strain, D symmetric: the data give t . sigma and n . sigma of a strain t
    D_nn          D_nt D_tt^-1 D_tn + C_nn: nothing of it is in the data; C_nn is the stiffness of n while the stress
                  along t is held

A datum whose neighbours all have its strain, as in a hold, but for a tremble, takes the nearest data of other strains.

So D is positive definite, and C_nn does not matter where the body leaves n free of stress, as the faces of a sheet do.
Where it does matter, as for the shear of a sheet that was only stretched, it is an assumption. In components that the
data declare silent it is next to nothing (dd_macro.material.metric): the stress there stays at zero.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dd_macro.material.metric import Metric, secant_modulus
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["estimate_tangents"]

Array = NDArray[np.float64]

_SPANNED = 0.02  # of the largest variance
_ROUND_OFF = 1e-12  # of the strain
_HELD = 1e-2  # a spread of strain over that of stress, whitened, that tells no modulus
_FLOOR = 1e-2  # smallest eigenvalue of D_tt, relative to the largest


def estimate_tangents(dataset: Dataset, *, neighbours: int = 16, metric: Metric | None = None) -> Dataset:
    """``dataset`` with tangents (N, 6, 6) in Pa estimated from the data; any that it had are not used.

    Args:
        dataset: more than ``neighbours`` data.
        neighbours: how many each tangent is made from; noise wants more of them, curvature fewer.
        metric: of the distance between data; its C is the stiffness of strain directions that the neighbours do not
            span. The secant modulus of the data if None, which takes the mean of what they do span.

    Raises:
        InputError: a number is out of range, or all data have the same strain.

    Example:
        >>> strain = np.random.default_rng(0).uniform(-0.02, 0.02, (60, 6))
        >>> C = dd.isotropic(young=1e3, poisson=0.3).C
        >>> data = tsg.Dataset(strain, strain @ C, "first_piola", path=np.zeros(60, int), step=np.arange(60))
        >>> found = dd.estimate_tangents(data, neighbours=20)
        >>> bool(np.allclose(found.tangent[0], C))
        True
    """
    if not 3 <= neighbours < len(dataset):
        raise InputError(f"neighbours: expected 3 to {len(dataset) - 1}, less than there are data, got {neighbours}")
    metric = metric or secant_modulus(dataset)
    whitened = np.sqrt(2.0) * metric.whiten(dataset.strain, dataset.stress)
    distance, index = cKDTree(whitened).query(whitened, k=neighbours + 1)
    weight = (1.0 - (distance / np.maximum(distance[:, -1:], 1e-300)) ** 2) ** 2
    weight[(weight > 0).sum(axis=1) < 3] = 1.0  # all equally far
    weight /= weight.sum(axis=1, keepdims=True)
    local = whitened[index]
    smallest = _ROUND_OFF**2 * (whitened[:, :6] ** 2).sum(axis=1).max()
    for _ in range(2):
        local -= np.einsum("nk,nki->ni", weight, local)[:, None]
        E, S = local[..., :6], local[..., 6:]
        variance, directions = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weight, E, E))
        spread = np.einsum("nk,nki->n", weight, S**2)
        held = np.flatnonzero(variance[:, -1] <= np.maximum(smallest, _HELD**2 * spread))
        if not held.size:
            break
        for datum in held:
            near = max(smallest, 1e4 * variance[datum, -1])  # and what trembles with it
            local[datum], weight[datum] = _beyond(whitened, int(datum), neighbours, near)
    moment = np.einsum("nk,nki,nkj->nij", weight, E @ directions, S @ directions)
    tangent = np.empty_like(moment)
    spanned = (variance > _SPANNED * variance[:, -1:]).sum(axis=1)
    for d in np.unique(spanned):
        here = spanned == d
        tangent[here] = _tangent(variance[here][:, -d:], moment[here])
    axes = metric.factor @ directions
    return replace(dataset, tangent=axes @ tangent @ axes.swapaxes(1, 2))


def _beyond(whitened: Array, datum: int, neighbours: int, near: float) -> tuple[Array, Array]:
    """A datum at a strain that was held, at the mean of all stresses there, and its nearest data of other strains.

    Points (neighbours + 1, 12) and weights as :func:`estimate_tangents` has them; weight 0 where there are no more.
    """
    other = ((whitened[:, :6] - whitened[datum, :6]) ** 2).sum(axis=1) > near
    if not other.any():
        raise InputError(f"data set: expected different strains, got the same in all neighbours of datum {datum}")
    centre, others = whitened[~other].mean(axis=0), whitened[other]
    distance = np.linalg.norm(others - centre, axis=1)
    nearest = np.argsort(distance, kind="stable")[:neighbours]
    spread = np.linalg.svd((others[nearest] - centre)[:, :6], compute_uv=False) ** 2
    nearest = nearest[: max(3, 2 * int((spread > _SPANNED * spread[0]).sum()))]  # the curve may bend beyond
    points, weight = np.tile(centre, (neighbours + 1, 1)), np.zeros(neighbours + 1)
    points[1 : len(nearest) + 1] = others[nearest]
    # as far out as one more would be, so that even a single one counts
    weight[0], radius = 1.0, 1.5 * distance[nearest[-1]]
    weight[1 : len(nearest) + 1] = (1.0 - (distance[nearest] / radius) ** 2) ** 2
    return points, weight / weight.sum()


def _tangent(variance: Array, moment: Array) -> Array:
    """Whitened tangents (n, 6, 6) in the principal directions, the last d of them spanned with ``variance`` (n, d)."""
    d = variance.shape[1]
    M = moment[:, -d:, -d:]
    tt = (M + M.swapaxes(1, 2)) / (variance[:, :, None] + variance[:, None, :])  # min |E D - S| over symmetric D
    values, vectors = np.linalg.eigh(tt)
    values = np.maximum(values, _FLOOR * np.abs(values).max(axis=1, keepdims=True))
    tt = (vectors * values[:, None, :]) @ vectors.swapaxes(1, 2)
    tn = moment[:, -d:, :-d] / variance[:, :, None]
    D = np.empty_like(moment)
    D[:, -d:, -d:], D[:, -d:, :-d], D[:, :-d, -d:] = tt, tn, tn.swapaxes(1, 2)
    D[:, :-d, :-d] = tn.swapaxes(1, 2) @ np.linalg.solve(tt, tn) + np.eye(6 - d)
    return D
