"""Out-of-balance forces by plain NumPy, from coordinates and rest lengths alone: nothing of the solvers is used.

Of a structure the forces of its members are summed at its nodes, a member's second end at the image that its shift
says. Of a body of bricks stress is integrated against the gradients of the eight products of linear functions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsg_micro.cells.structure import Structure

__all__ = ["brick_imbalance", "imbalance", "rounding"]

Array = NDArray[np.float64]
_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


def imbalance(
    structure: Structure,
    displacement: Array,
    H: ArrayLike,
    *,
    held: NDArray[np.bool_],
    free: tuple[int, ...] = (),
) -> float:
    """Largest force on a node that nothing holds, over the mean member force.

    ``displacement`` (n, 3) in m and the displacement gradient ``H`` (3, 3) are the state, ``held`` (n, 3) the supports.
    Of a periodic structure the faces across other axes are moved apart by forces that are the same at all their nodes,
    opposite at the other face; these are taken off. ``free`` are the strains, in the order xx, yy, zz, yz, xz, xy,
    whose mean stress must be none: it counts as force over the longest edge. Members are linear, EA (l - l0) / l0.
    """
    jump = structure.shift * structure.size
    force = _members(structure, displacement, jump + jump @ np.asarray(H, dtype=float).T)[1]
    i, j = structure.members.T
    node = np.zeros(structure.nodes.shape)
    np.add.at(node, i, -force)
    np.add.at(node, j, force)
    if any(structure.periodic):
        for axis in np.flatnonzero(~np.array(structure.periodic)):
            x = structure.nodes[:, axis]
            faces = [np.abs(x - end) < 1e-9 * structure.size[axis] for end in (x.min(), x.max())]
            pull = 0.5 * (node[faces[1]].mean(axis=0) - node[faces[0]].mean(axis=0))
            node[faces[1]] -= pull
            node[faces[0]] += pull
    scale = np.abs(np.linalg.norm(force, axis=1)).mean()
    largest = np.abs(node[~held]).max(initial=0.0)
    virial = np.einsum("ma,mb->ab", force, structure.nodes[j] + jump - structure.nodes[i])
    moment = [abs(virial[a, b] + virial[b, a]) / 2.0 for a, b in (_PAIRS[k] for k in free)]
    return float(max(largest, max(moment, default=0.0) / structure.size.max()) / scale)


def _members(structure: Structure, displacement: Array, jump: Array) -> tuple[Array, Array]:
    """Vectors (m, 3), m, and forces (m, 3), N, of the members; ``jump`` (m, 3) is where their images are now."""
    place = structure.nodes + displacement
    i, j = structure.members.T
    vector = place[j] + jump - place[i]
    length = np.linalg.norm(vector, axis=1)
    tension = structure.EA * (length - structure.rest_length) / structure.rest_length
    return vector, (tension / length)[:, None] * vector


def rounding(structure: Structure, displacement: Array) -> float:
    """What rounding of the positions alone can make of :func:`imbalance`, a few times over."""
    vector, force = _members(structure, displacement, structure.shift * structure.size)
    farthest = np.abs(structure.nodes + displacement).max() / np.linalg.norm(vector, axis=1).min()
    stiffest = structure.EA.max() / np.linalg.norm(force, axis=1).mean()
    return float(8.0 * np.finfo(float).eps * stiffest * (1.0 + farthest))


def brick_imbalance(corners: Array, points: Array, weights: Array, stress: Array) -> float:
    """Largest force on a node of a body of bricks that stand along the axes, over the largest of all.

    ``corners`` (c, 8, 3) in m, ``points`` (c, q, 3) in m with ``weights`` (c, q) in m^3, Mandel ``stress`` (c, q, 6) in
    Pa. Nodes are corners at one place; those at the lowest and the highest y are held.
    """
    low, high = corners.min(axis=1), corners.max(axis=1)
    size = high - low
    at = (points - low[:, None]) / size[:, None]
    tensor = np.zeros((*stress.shape[:2], 3, 3))
    for k, (a, b) in enumerate(_PAIRS):
        tensor[..., a, b] = tensor[..., b, a] = stress[..., k] / (1.0 if a == b else np.sqrt(2.0))
    force = np.zeros(corners.shape)
    upper = corners > 0.5 * (low + high)[:, None]  # (c, 8, 3)
    for corner in range(8):
        up = upper[:, corner][:, None]
        linear = np.where(up, at, 1.0 - at)
        slope = np.where(up, 1.0, -1.0) / size[:, None]
        gradient = slope * np.stack([np.prod(np.delete(linear, k, axis=2), axis=2) for k in range(3)], axis=2)
        force[:, corner] = np.einsum("cq,cqab,cqb->ca", weights, tensor, gradient)
    key = np.round((corners - low.min(axis=0)) / size.min(axis=0)).astype(np.int64).reshape(-1, 3)
    _, node = np.unique(key, axis=0, return_inverse=True)
    total = np.zeros((node.max() + 1, 3))
    np.add.at(total, node.reshape(-1), force.reshape(-1, 3))
    y = np.zeros(len(total))
    y[node.reshape(-1)] = corners.reshape(-1, 3)[:, 1]
    inside = (y > y.min() + 1e-9 * np.ptp(y)) & (y < y.max() - 1e-9 * np.ptp(y))
    scale = np.abs(force).max()
    return float(np.abs(total[inside]).max(initial=0.0) / scale) if scale > 0.0 else 0.0
