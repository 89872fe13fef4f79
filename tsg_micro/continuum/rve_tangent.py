"""What an RVE in equilibrium answers: tangent, rate of all unknowns, and what its clamps carry, of b states at once.

Arrays of the members have a last axis of b, results a first one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.mandel import BASIS, to_mandel
from tsg_micro.equilibrium.members import MemberState, MemberSystem
from tsg_micro.equilibrium.newton import NewtonSolver

__all__ = ["condensed", "strain_columns", "support_stress", "support_tangent"]

Array = NDArray[np.float64]


def strain_columns(newton: NewtonSolver, members: MemberState) -> Array:
    """Loads (b, nx, 6 + c) on the free unknowns: what the six Mandel strains put on them, then the constraints."""
    constraint = newton.border.constraint[:, newton.free]
    product = newton.system.macro_product(members, _macro(newton))
    columns = np.zeros((members.length.shape[1], len(newton.free), 6 + len(constraint)))
    columns[:, :, :6] = -np.moveaxis(product[newton.free], -1, 0)
    columns[:, :, 6:] = constraint.T
    return columns


def condensed(newton: NewtonSolver, members: MemberState, solved: Array) -> tuple[Array, Array]:
    """Second derivative (b, 6, 6) of the energy by symmetric H, J, the nodes following, and how all unknowns do.

    The latter, the rate, is d y / d strain (b, 3n + 9, 6), Mandel. ``solved`` is K^-1 times the strain columns.
    """
    a, m = newton.border.constraint, newton.system.nodal_size
    ax, am = a[:, newton.free], a[:, m:] @ _macro(newton)[m:, :, 0]
    dx, lever = solved[:, :, :6], solved[:, :, 6:]
    multipliers = np.linalg.solve(ax @ lever, ax @ dx + am) if len(a) else np.zeros((len(solved), 0, 6))
    rate = np.repeat(_macro(newton), len(solved), axis=2)
    rate[newton.free] = np.moveaxis(dx - lever @ multipliers, 0, -1)
    moment = np.moveaxis(newton.system.macro_part(members, rate), -1, 0).copy() + a[:, m:].T @ multipliers
    tangent = BASIS.reshape(6, 9) @ moment
    return 0.5 * (tangent + np.swapaxes(tangent, 1, 2)), np.moveaxis(rate, -1, 0).copy()


def _macro(newton: NewtonSolver) -> Array:
    """The six Mandel strains as directions (3n + 9, 6, 1)."""
    macro = np.zeros((newton.system.size, 6, 1))
    macro[newton.system.nodal_size :, :, 0] = BASIS.reshape(6, 9).T
    return macro


def support_stress(system: MemberSystem, members: MemberState, first_piola: Array) -> Array:
    """What clamps carry (b, 3, 3), Pa: the members' mean stress less P."""
    force = members.force_density[:, None] * members.vector
    carried = (force[:, :, None] * system.reference[:, None, :, None]).sum(axis=0)
    return np.moveaxis(carried, -1, 0) / system.structure.volume - first_piola


def support_tangent(system: MemberSystem, members: MemberState, tangent: Array, rate: Array) -> Array:
    """Derivative (b, 6, 6) of the symmetric part of the support stress by the strain, Pa, Mandel."""
    change = system.member_forces(members, np.moveaxis(rate, 0, -1))  # (m, 3, 6, b)
    mean = (change[:, :, None] * system.reference[:, None, :, None, None]).sum(axis=0)  # (3, 3, 6, b)
    return np.swapaxes(to_mandel(mean.transpose(3, 2, 0, 1)), 1, 2) / system.structure.volume - tangent
