"""What a loaded lattice answers: stiffness at its present equilibrium, twist of a face, displacement of cells.

Both stiffnesses come from the factorised tangent, so each costs one back-substitution.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import side_nodes
from tsg_micro.cells.structure import Structure
from tsg_micro.equilibrium.load_path import EquilibriumSolver
from tsg_micro.equilibrium.members import MemberState

__all__ = ["cell_displacement", "compressed_tendons", "face_rotation", "stiffness_under_load", "stiffness_under_motion"]

Array = NDArray[np.float64]


def stiffness_under_motion(solver: EquilibriumSolver, motion: Array) -> float:
    """Second derivative of the energy along a prescribed ``motion`` (n, 3), the free nodes following, N/m.

    With v the motion and w what the nodes do then, K w = 0 at the free ones: the result is v K w. For a unit
    displacement of a side it is the derivative of the side's reaction. The solver's structure is not periodic.
    """
    newton, system = solver.newton, solver.system
    state = system.state(solver.y)
    v = np.zeros((system.size, 1))
    v[: system.nodal_size, 0] = np.asarray(motion, dtype=float).ravel()
    product = system.tangent_product(state, v)
    dx, _ = solver.tangent().solve(-product[newton.free, 0], np.zeros(newton.border.size))
    follow = np.zeros_like(v)
    follow[newton.free, 0] = dx
    return float(np.vdot(v, product) + np.vdot(product, follow))


def stiffness_under_load(solver: EquilibriumSolver, load: Array) -> float:
    """Stiffness against nodal forces that grow in proportion to ``load`` (n, 3), N/m.

    With p the load over the sum of its norms and K^-1 p what the free nodes do, it is 1 / (p K^-1 p): force over the
    displacement of its points, for forces of one size and direction.
    """
    newton = solver.newton
    p = np.asarray(load, dtype=float)
    p = (p / np.linalg.norm(p, axis=1).sum()).ravel()[newton.free]
    dx, _ = solver.tangent().solve(p, np.zeros(newton.border.size))
    return float(1.0 / (p @ dx))


def face_rotation(structure: Structure, displacement: Array, *, axis: int, end: Literal["low", "high"]) -> float:
    """Rotation in rad of the outer face across ``axis``, anticlockwise as seen from outside.

    It is the rotation that fits the face's nodes best once they are projected onto the plane across ``axis`` in its
    reference position: tan(phi) = n . sum(X x x) / sum(X . x), about the centroids.
    """
    nodes = side_nodes(structure, axis, end=end)
    before = structure.nodes[nodes]
    after = before + displacement[nodes]
    X, x = (np.delete(points - points.mean(axis=0), axis, axis=1) for points in (before, after))
    # dropping y leaves (x, z), whose cross product is along -y
    outward = (1.0 if end == "high" else -1.0) * (-1.0 if axis == 1 else 1.0)
    return float(np.arctan2(outward * (X[:, 0] * x[:, 1] - X[:, 1] * x[:, 0]).sum(), (X * x).sum()))


def compressed_tendons(structure: Structure, members: MemberState) -> int:
    """Tendons with a negative force, which would be slack in a model without compression in tendons."""
    return int((members.force[~structure.bars] < 0.0).sum())


def cell_displacement(structure: Structure, displacement: Array) -> Array:
    """Mean displacement (c, 3) of the ends of every cell's bars, m: all nodes of a truncated octahedron."""
    bars = structure.bars
    cell = structure.member_cells[bars, 0]
    mean = displacement[structure.members[bars]].mean(axis=1)
    total = np.zeros((len(structure.cells), 3))
    np.add.at(total, cell, mean)
    return total / np.bincount(cell)[:, None]
