"""Representative volume element: a periodic lattice under a macroscopic displacement gradient H.

Along periodic axes opposite faces are images of each other and H prescribes the jump between them. Across an axis
that is not periodic the faces are free, but H still means something there: the difference of their mean
displacements is H e_a times the thickness, kept by three constraints. A strain component that is free is found by
the condition that its stress vanishes, so a sheet in plane stress has the components zz, yz, xz free.
The derivative of the stored energy by H is V0 P, with P the first Piola stress; its second derivative, condensed
on the nodes, is the consistent tangent.

An axis can also be held: its two outer faces are clamped, moved apart as H says and otherwise rigid. So a row of
blocks at a clamp is half of an RVE that is held across it, as the outer column of a sheet is half of one that is free
across it. Strain along a clamp is zero at its face and grows away from it: along periodic axes it rises from none at
the faces to twice H in the middle, so that H is its mean. What a clamp keeps from moving along itself, as the
thickness of a sheet, does no work on H; it is the support stress, what the members' mean stress holds beside P.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsg_micro.cells.lattice import Images, side_nodes
from tsg_micro.cells.parameters import TABLE_1, CellParameters
from tsg_micro.cells.structure import Structure, member_vectors
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_tangent import condensed, strain_columns, support_stress, support_tangent
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import BASIS, COMPONENTS, from_mandel, to_mandel
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver
from tsg_micro.equilibrium.newton import NewtonOptions
from tsg_micro.equilibrium.tangent import Border

__all__ = ["RVE", "RVEState", "build_rve"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RVEState:
    """Homogenised state of an RVE; tensors (3, 3)."""

    F: Array
    """Deformation gradient, volume average."""
    first_piola: Array
    """P, Pa: derivative of the energy per reference volume by H."""
    energy: float
    """Stored energy per reference volume, J/m^3."""
    tangent: Array | None
    """d sym(P) / d strain (6, 6), Pa, Mandel, all six strains prescribed; symmetric."""
    equilibrium: Equilibrium
    rate: Array | None = None
    """d y / d strain (3n + 9, 6): how all unknowns follow the Mandel strain; there with the tangent."""
    support_stress: Array | None = None
    """Mean of the members' t (x) L less P (3, 3), Pa: what clamps carry beside P; None where no axis is held."""
    support_tangent: Array | None = None
    """Derivative of its symmetric part by the strain (6, 6), Pa, Mandel; there with the tangent."""

    @property
    def strain(self) -> Array:
        """Small strain, the symmetric part of H, Mandel (6,)."""
        return to_mandel(self.F - np.eye(3))

    @property
    def kirchhoff(self) -> Array:
        """tau = P F^T, Pa."""
        return self.first_piola @ self.F.T

    @property
    def cauchy(self) -> Array:
        """sigma = tau / det F, Pa."""
        return self.kirchhoff / np.linalg.det(self.F)

    @property
    def second_piola(self) -> Array:
        """S = F^-1 P, Pa."""
        return np.linalg.solve(self.F, self.first_piola)


class RVE:
    """A periodic structure that follows its equilibrium from one macroscopic state to the next."""

    def __init__(
        self,
        structure: Structure,
        *,
        free: tuple[str, ...] = (),
        held: tuple[bool, bool, bool] = (False, False, False),
        slack: bool = False,
        options: NewtonOptions | None = None,
    ) -> None:
        """``free`` names the strain components without stress, among xx, yy, zz, yz, xz, xy; ``held`` are axes.

        Raises InputError: no axis is periodic or held, one is both, or a name is unknown or comes twice.
        """
        if not (any(structure.periodic) or any(held)):
            raise InputError("structure: expected at least one periodic axis, or one that is held")
        if any(a and b for a, b in zip(structure.periodic, held, strict=True)):
            raise InputError(f"held: expected axes that are not periodic, got {held} and {structure.periodic}")
        if len(set(free)) != len(free):
            raise InputError(f"free: expected every strain component once, got {', '.join(free)}")
        unknown = [name for name in free if name not in COMPONENTS]
        if unknown:
            raise InputError(f"free: expected strain components among {', '.join(COMPONENTS)}, got {unknown[0]!r}")
        self.structure, self.held = structure, held
        self.free = tuple(COMPONENTS.index(name) for name in free)
        fixed, levers = np.zeros(structure.nodes.shape, dtype=bool), None
        if any(held):
            fixed, levers = _clamps(structure, held)
        else:
            fixed[0] = True  # a rigid translation of a periodic body changes nothing
        border = Border(
            BASIS[list(self.free)].reshape(-1, 9).T,
            _mean_constraints(structure, held),
            held=None if any(held) else _free_rotation(structure),
        )
        kept: dict[str, Any] = {"fixed": fixed, "levers": levers, "border": border}
        self.solver = EquilibriumSolver(structure, **kept, slack=slack, options=options)

    def reset(self) -> None:
        """Go back to the reference state."""
        self.solver.move_to(np.zeros(self.solver.system.size), np.zeros(self.solver.system.nodal_size))

    def solve_strain(
        self, strain: ArrayLike, *, tangent: bool = True, steps: int = 1, rate: Array | None = None
    ) -> RVEState:
        """Follow the equilibrium to the Mandel strain (6,) along a straight line, H symmetric.

        Entries of free components are not used. With ``tangent`` the result is a stable state and carries its tangent.
        ``rate`` (3n + 9, 6) is that of the present state, if it is known: it saves a factorisation, and is the true
        first guess where no component is free.

        Raises:
            InputError: ``strain`` is not six finite numbers.
            ConvergenceError: the equilibrium was lost on the way; the RVE stays where it was reached last.

        Example:
            >>> rve = tsg.build_rve(bar_force=1e-8, free=("xx", "zz", "yz", "xz", "xy"))
            >>> stress = [rve.solve_strain([0, e, 0, 0, 0, 0]).first_piola[1, 1] for e in (0.01, 0.02)]
            >>> np.round(stress, 2)
            array([ 8.93, 19.15])
        """
        strain = np.array(strain, dtype=float)
        if strain.shape != (6,) or not np.isfinite(strain).all():
            raise InputError(f"strain: expected six finite Mandel components, got shape {strain.shape}")
        present = to_mandel(self.solver.y[-9:].reshape(3, 3))
        strain[list(self.free)] = present[list(self.free)]
        change = None if rate is None else rate @ (strain - present)
        return self.solve_gradient(from_mandel(strain), tangent=tangent, steps=steps, change=change)

    def solve_gradient(
        self, H: ArrayLike, *, tangent: bool = True, steps: int = 1, change: Array | None = None
    ) -> RVEState:
        """Follow the equilibrium to the displacement gradient H (3, 3), whose free components start the search.

        ``change`` (3n + 9,) is that of all unknowns along the tangent, if it is known.

        Raises:
            InputError: H is not finite or turns the body inside out.
            ConvergenceError: as :meth:`solve_strain`.
        """
        if change is not None:
            self.solver.expect(change)
        result = self.solver.solve(H=np.asarray(H, dtype=float), stable=tangent, steps=steps)
        volume, system = self.structure.volume, self.solver.system
        members = result.members.map(lambda part: part[..., None])
        first_piola = result.macro_force / volume
        state = RVEState(np.eye(3) + result.H, first_piola, result.energy / volume, None, result)
        if any(self.held):
            state = replace(state, support_stress=support_stress(system, members, first_piola[None])[0])
        if not tangent:
            return state
        newton, factor = self.solver.newton, self.solver.tangent().factor
        moduli, rate = condensed(newton, members, factor.solve(strain_columns(newton, members)[0])[None])
        state = replace(state, tangent=moduli[0] / volume, rate=rate[0])
        if any(self.held):
            (its_tangent,) = support_tangent(system, members, moduli / volume, rate)
            state = replace(state, support_tangent=its_tangent)
        return state


def _clamps(structure: Structure, held: tuple[bool, bool, bool]) -> tuple[NDArray[np.bool_], Array]:
    """Mask (n, 3) of the nodes on the faces that are held, and how H moves the members (m, 3, 3), m.

    A face across axis n is displaced by H e_n X_n, and turned with the body by e_n H_nt X_t; along itself it is rigid.
    Along periodic axes beside the clamp members follow H as it is at their depth, so that it does not matter where the
    period begins; displacements are those beside it.
    """
    nodes, (first, second) = structure.nodes, structure.members.T
    fixed = np.zeros(nodes.shape, dtype=bool)
    carried = np.zeros((len(nodes), 3, 3))
    jump, followed = structure.shift * structure.size, np.where(structure.periodic, member_vectors(structure), 0.0)
    beside, depth = np.zeros((3, 3), dtype=bool), np.ones((len(jump), 3, 3))
    for axis in np.flatnonzero(held):
        face = np.concatenate([side_nodes(structure, int(axis), end=end) for end in ("low", "high")])  # type: ignore[arg-type]
        fixed[face] = True
        carried[face, :, axis] = nodes[face, None, axis]
        carried[face, axis, :] = nodes[face]
        along = np.arange(3) != axis
        y = (nodes[:, axis] - nodes[:, axis].min()) / structure.size[axis]
        rise = 2.0 - np.abs(4.0 * y - 2.0)  # 0 at the faces, 2 in the middle
        depth[:, np.outer(along, along)] *= 0.5 * (rise[first] + rise[second])[:, None]
        beside |= np.outer(along, along)
    levers = np.where(beside, depth * followed[:, None, :], jump[:, None, :])
    return fixed, levers + carried[second] - carried[first]


def _mean_constraints(structure: Structure, held: tuple[bool, bool, bool]) -> Array:
    """Rows (c, 3n + 9): mean displacement of the high face less that of the low one, less H e_a times the thickness."""
    n = structure.nodes.size
    rows = []
    for axis in range(3):
        if structure.periodic[axis] or held[axis]:
            continue
        high, low = side_nodes(structure, axis, end="high"), side_nodes(structure, axis, end="low")
        for alpha in range(3):
            row = np.zeros(n + 9)
            row[3 * high + alpha] = 1.0 / len(high)
            row[3 * low + alpha] = -1.0 / len(low)
            row[n + 3 * alpha + axis] = -structure.size[axis]
            rows.append(row)
    return np.array(rows).reshape(-1, n + 9)


def _free_rotation(structure: Structure) -> int | None:
    """A displacement in the rotation that periodicity along one axis alone leaves to the constraints; else None."""
    if sum(structure.periodic) != 1:
        return None
    axis = structure.periodic.index(True)
    second, third = (axis + 1) % 3, (axis + 2) % 3
    farthest = int(np.abs(structure.nodes[:, third] - structure.nodes[0, third]).argmax())
    return 3 * farthest + second


def build_rve(
    parameters: CellParameters | None = None,
    *,
    bar_force: float,
    blocks: tuple[int, int, int] = (1, 1, 1),
    periodic: tuple[bool, bool, bool] = (True, True, False),
    images: Images = "merged",
    free: tuple[str, ...] = ("zz", "yz", "xz"),
    options: NewtonOptions | None = None,
) -> RVE:
    """An RVE of 2x2x2-cell blocks with bar force f_b (N); by default one block of a sheet with free faces.

    Raises:
        InputError: an argument is not valid; the text names it.

    Example:
        >>> rve = tsg.build_rve(bar_force=1e-8)  # a block of a sheet: zz, yz and xz are free of stress
        >>> state = rve.solve_strain([0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
        >>> state.first_piola.diagonal().round(1), (100 * state.strain[:3]).round(2)
        (array([10.5, 24.5,  0. ]), array([ 0.  ,  2.  , -1.11]))
    """
    nx, ny, nz = (2 * n for n in blocks)
    structure = Tissue(parameters or TABLE_1, bar_force).box((nx, ny, nz), periodic=periodic, images=images)
    return RVE(structure, free=free, options=options)
