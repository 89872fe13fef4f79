"""A body without the rigid motions that its supports leave free: means of its motion are held, no node is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.structure import Structure
from tsg_micro.equilibrium.members import MACRO
from tsg_micro.equilibrium.tangent import Border

__all__ = ["free_motions", "rigid_border", "rigid_motions"]

Array = NDArray[np.float64]
_HELD = 1e-9


def rigid_motions(structure: Structure) -> Array:
    """Displacements (6, n, 3) of the nodes, of one length: along x, y, z, and about x, y, z through the midpoint.

    The midpoint is that of the nodes; a turn is scaled to a mean square of 2/3 of that of the translations.
    """
    X = structure.nodes - structure.nodes.mean(axis=0)
    gyration = np.sqrt((X**2).sum(axis=1).mean())
    moved = np.broadcast_to(np.eye(3)[:, None], (3, *X.shape))
    return np.concatenate([moved, np.cross(np.eye(3)[:, None], X) / gyration])


def free_motions(structure: Structure, fixed: NDArray[np.bool_]) -> Array:
    """Orthonormal combinations (k, 6) of :func:`rigid_motions` that move no displacement in the mask ``fixed`` (n, 3).

    They are the unit vectors where nothing is fixed.
    """
    if not fixed.any():
        return np.eye(6)
    seen = rigid_motions(structure)[:, fixed]
    gram = seen @ seen.T
    values, vectors = np.linalg.eigh(gram / np.trace(gram))
    return np.asarray(vectors[:, values < _HELD].T)


def rigid_border(structure: Structure, fixed: NDArray[np.bool_] | None = None) -> Border:
    """Constraints sum u = 0 and sum X x u = 0 over all nodes, X the reference position from their midpoint.

    Of the six those are left out that the mask ``fixed`` (n, 3) of prescribed displacements decides; what is prescribed
    does not enter the others. All are in m: the mean displacement, and the mean rotation times the radius of gyration.
    Loads without resultant and moment along the free motions need no force to keep them: the multipliers vanish. Weak
    springs at three far nodes make the nodal matrix regular; they are in the tangent alone, and the constraints leave
    them nothing to hold.
    """
    X = structure.nodes - structure.nodes.mean(axis=0)
    n = len(X)
    fixed = np.zeros(X.shape, dtype=bool) if fixed is None else fixed
    motions = np.tensordot(free_motions(structure, fixed), rigid_motions(structure), axes=1)
    motions[:, fixed] = 0.0  # round-off
    rows = np.zeros((len(motions), 3 * n + MACRO))
    rows[:, : 3 * n] = motions.reshape(len(motions), 3 * n) / n
    first = int((X**2).sum(axis=1).argmax())
    second = int(((X - X[first]) ** 2).sum(axis=1).argmax())
    third = int((np.cross(X - X[first], X[second] - X[first]) ** 2).sum(axis=1).argmax())
    held = (3 * np.array([[first], [second], [third]]) + np.arange(3)).ravel()
    return Border(np.zeros((MACRO, 0)), rows, held=held[~fixed.ravel()[held]])
