"""A free body without its six rigid motions: mean displacement and mean rotation are held, no node is."""

from __future__ import annotations

import numpy as np

from tsg_micro.cells.structure import Structure
from tsg_micro.equilibrium.members import MACRO
from tsg_micro.equilibrium.tangent import Border

__all__ = ["rigid_border"]


def rigid_border(structure: Structure) -> Border:
    """Constraints sum u = 0 and sum X x u = 0 over all nodes, X the reference position from their midpoint.

    All six are in m: the mean displacement, and the mean rotation times the radius of gyration. Loads without resultant
    and moment need no force to keep them: the multipliers vanish. Weak springs at three far nodes make the nodal matrix
    regular; they are in the tangent alone, and the constraints leave them nothing to hold.
    """
    X = structure.nodes - structure.nodes.mean(axis=0)
    n = len(X)
    gyration = np.sqrt((X**2).sum(axis=1).mean())
    rows = np.zeros((6, 3 * n + MACRO))
    for axis in range(3):
        rows[axis, axis : 3 * n : 3] = 1.0 / n
        rows[3 + axis, : 3 * n] = np.cross(np.eye(3)[axis], X).ravel() / (n * gyration)
    first = int((X**2).sum(axis=1).argmax())
    second = int(((X - X[first]) ** 2).sum(axis=1).argmax())
    third = int((np.cross(X - X[first], X[second] - X[first]) ** 2).sum(axis=1).argmax())
    held = (3 * np.array([[first], [second], [third]]) + np.arange(3)).ravel()
    return Border(np.zeros((MACRO, 0)), rows, held=held)
