"""A body that is held and loaded, on a mesh; there is no material in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dd_macro.parallel import total
from dd_macro.scene.boundary import Displacement, prescribed_displacement, side_dofs
from dd_macro.scene.loads import Load, nodal_forces
from dd_macro.scene.regions import Regions
from dd_macro.scene.spaces import StrainOperator

__all__ = ["Problem"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Problem:
    """Mesh and spaces, what is held, and what pulls; checked when made, which is collective.

    ``fixed`` is the mask of the prescribed displacement components, ``prescribed`` their values in m, and ``forces`` in
    N the f of the equations, all of the unknowns that this rank owns: (3 * nodes,), or more (EnhancedStrainOperator).

    Raises:
        InputError: on construction, where supports or loads are not valid, or leave a rigid-body motion free.
    """

    operator: StrainOperator
    supports: Sequence[Displacement]
    loads: Sequence[Load] = ()
    regions: Regions | None = None
    """Of cells whose material differs; None where it is one."""
    fixed: NDArray[np.bool_] = field(init=False, repr=False)
    prescribed: Array = field(init=False, repr=False)
    forces: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        fixed, prescribed = prescribed_displacement(self.operator, self.supports)
        found = {"fixed": fixed, "prescribed": prescribed, "forces": nodal_forces(self.operator, self.loads)}
        for name, array in found.items():
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def region_of_points(self) -> NDArray[np.int64]:
        """The region of every quadrature point (n,), 0 where there are no regions."""
        if self.regions is None:
            return np.zeros(len(self.operator.weights), dtype=np.int64)
        return self.regions.points(self.operator.points_per_cell)

    def out_of_balance(self, stress: Array) -> Array:
        """Internal minus external forces in N on the unknowns, of the stress of the equations, (n, 6) or (n, 9)."""
        return self.operator.force(stress) - self.forces

    def residual(self, stress: Array) -> float:
        """Norm of the out-of-balance force on the free components, relative to that of all nodal forces."""
        force = self.operator.force(stress)
        out = np.where(self.fixed, 0.0, force - self.forces)
        squares = total(self.operator.comm, [out @ out, force @ force + self.forces @ self.forces])
        return float(np.sqrt(squares[0] / squares[1])) if squares[1] != 0 else 0.0

    def support_force(self, side: str, out_of_balance: Array) -> Array:
        """Force (3,) in N that the supports of ``side`` exert on the body.

        Raises:
            InputError: no such side.
        """
        return total(self.operator.comm, out_of_balance.reshape(-1, 3)[side_dofs(self.operator, side)].sum(axis=0))
