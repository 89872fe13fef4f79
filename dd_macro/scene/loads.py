"""What pulls at a body. A load is a small class that answers for its nodal forces; a new one is a file of its own."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import dolfinx
import dolfinx.fem.petsc
import numpy as np
import ufl
from numpy.typing import NDArray
from petsc4py import PETSc

from dd_macro.compat import compile_form
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.errors import InputError

__all__ = ["Load", "Traction", "nodal_forces"]

Array = NDArray[np.float64]


class Load(Protocol):
    """A load that does not follow the body; a load step applies a part of it."""

    def nodal_forces(self, operator: StrainOperator) -> Array:
        """Consistent nodal forces (3 * nodes,) in N of this rank's nodes; collective.

        Raises:
            InputError: on all ranks, where the load does not fit the mesh or is not valid.
        """


@dataclass(frozen=True)
class Traction:
    """Dead traction (3,) in Pa on a side."""

    side: str
    value: tuple[float, float, float]

    def nodal_forces(self, operator: StrainOperator) -> Array:
        """Consistent nodal forces (3 * nodes,) in N.

        Raises:
            InputError: an unknown side, one without outer facets, or a value that is not three finite numbers.
        """
        mesh, facets = operator.domain.mesh, operator.domain.facets(self.side)
        value = np.asarray(self.value, dtype=float)
        if value.shape != (3,) or not np.isfinite(value).all():
            raise InputError(f"traction on {self.side!r}: expected three finite numbers in Pa, got {self.value}")
        mesh.topology.create_connectivity(2, 3)
        outer = np.isin(facets, dolfinx.mesh.exterior_facet_indices(mesh.topology)).sum()
        if operator.comm.allreduce(int(outer)) == 0:
            raise InputError(f"traction on {self.side!r}: expected outer facets of the mesh, got none")
        # always tag 1, so that one compiled kernel serves every side
        tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(facets), np.ones(len(facets), dtype=np.int32))
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)
        v = ufl.TestFunction(operator.displacements)
        b = dolfinx.fem.petsc.assemble_vector(compile_form(ufl.inner(dolfinx.fem.Constant(mesh, value), v) * ds(1)))
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(b.array, dtype=float)


def nodal_forces(operator: StrainOperator, loads: Iterable[Load]) -> Array:
    """Consistent forces in N of all the loads on the unknowns: those of nodes, (3 * nodes,), and zeros for others.

    Raises:
        InputError: as a load's.
    """
    forces = np.zeros(operator.owned_dofs)
    for load in loads:
        forces[: 3 * operator.owned_nodes] += load.nodal_forces(operator)
    return forces
