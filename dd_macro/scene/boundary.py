"""Boundary conditions by the name of a side: prescribed displacements and tractions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import dolfinx
import dolfinx.fem.petsc
import numpy as np
import ufl
from numpy.typing import NDArray
from petsc4py import PETSc

from dd_macro.compat import compile_form
from dd_macro.parallel import check_everywhere, total
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.errors import InputError

__all__ = ["Displacement", "Traction", "nodal_forces", "prescribed_displacement", "side_dofs", "support_force"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Displacement:
    """Prescribed displacement in m of the nodes of a side, all of them or those ``where`` says so.

    ``value`` has one number per entry of ``components``, or is a function of coordinates (nodes, 3) in m that
    gives (nodes, len(components)); ``where`` is one that gives a mask (nodes,). Where two sides meet, the condition
    given later counts.
    """

    side: str
    value: Sequence[float] | Callable[[Array], Array] = (0.0, 0.0, 0.0)
    components: tuple[int, ...] = (0, 1, 2)
    where: Callable[[Array], NDArray[np.bool_]] | None = None


@dataclass(frozen=True)
class Traction:
    """Dead traction (3,) in Pa on a side."""

    side: str
    value: tuple[float, float, float]


def side_dofs(operator: StrainOperator, side: str) -> NDArray[np.int64]:
    """Owned nodes of the side; dof 3 * node + component is one entry of a nodal array.

    Raises:
        InputError: no such side, or no facet on it.
    """
    domain = operator.domain
    facets = domain.facets(side)
    if domain.comm.allreduce(len(facets)) == 0:
        raise InputError(f"side of the mesh: expected facets on {side!r}, got none")
    domain.mesh.topology.create_connectivity(2, 3)
    nodes = dolfinx.fem.locate_dofs_topological(operator.displacements, 2, facets)
    return nodes[nodes < operator.owned_dofs // 3].astype(np.int64)


def prescribed_displacement(
    operator: StrainOperator, conditions: Sequence[Displacement]
) -> tuple[NDArray[np.bool_], Array]:
    """Mask and values, both (3 * nodes,), of the prescribed displacement components.

    Raises:
        InputError: an unknown side, components other than 0, 1, 2, values of another shape or not finite, or
            conditions that leave a rigid-body motion free.
    """
    fixed = np.zeros((operator.owned_dofs // 3, 3), dtype=bool)
    values = np.zeros_like(fixed, dtype=float)
    x = operator.node_coordinates()
    for condition in conditions:
        nodes, components = side_dofs(operator, condition.side), list(condition.components)
        if condition.where is not None:
            nodes = nodes[condition.where(x[nodes])]
        if not components or not set(components) <= {0, 1, 2}:
            raise InputError(f"components on {condition.side!r}: expected some of 0, 1, 2, got {condition.components}")
        given = condition.value(x[nodes]) if callable(condition.value) else condition.value
        given = np.asarray(given, dtype=float)
        expected = (len(nodes), len(components)) if callable(condition.value) else (len(components),)
        message = None
        if given.shape != expected:
            message = f"displacement on {condition.side!r}: expected shape {expected}, got {given.shape}"
        elif not np.isfinite(given).all():
            message = f"displacement on {condition.side!r}: expected finite numbers in m, got NaN or infinity"
        check_everywhere(operator.comm, message)
        fixed[np.ix_(nodes, components)] = True
        values[np.ix_(nodes, components)] = given
    rank = np.linalg.matrix_rank(_rigid_gram(operator, x, fixed), tol=1e-9)
    if rank < 6:
        raise InputError(
            f"boundary conditions: expected no rigid-body motion left free, got {6 - rank} of 6; fix more components"
        )
    return fixed.reshape(-1), values.reshape(-1)


def nodal_forces(operator: StrainOperator, tractions: Sequence[Traction]) -> Array:
    """Consistent nodal forces (3 * nodes,) in N of the tractions.

    Raises:
        InputError: an unknown side, one without outer facets, or a value that is not three finite numbers.
    """
    forces = np.zeros(operator.owned_dofs)
    mesh = operator.domain.mesh
    for traction in tractions:
        facets = operator.domain.facets(traction.side)
        value = np.asarray(traction.value, dtype=float)
        if value.shape != (3,) or not np.isfinite(value).all():
            raise InputError(
                f"traction on {traction.side!r}: expected three finite numbers in Pa, got {traction.value}"
            )
        mesh.topology.create_connectivity(2, 3)
        outer = np.isin(facets, dolfinx.mesh.exterior_facet_indices(mesh.topology)).sum()
        if operator.comm.allreduce(int(outer)) == 0:
            raise InputError(f"traction on {traction.side!r}: expected outer facets of the mesh, got none")
        # always tag 1, so that one compiled kernel serves every side
        tags = dolfinx.mesh.meshtags(mesh, 2, np.sort(facets), np.ones(len(facets), dtype=np.int32))
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)
        v = ufl.TestFunction(operator.displacements)
        b = dolfinx.fem.petsc.assemble_vector(compile_form(ufl.inner(dolfinx.fem.Constant(mesh, value), v) * ds(1)))
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        forces += b.array
    return forces


def support_force(operator: StrainOperator, side: str, out_of_balance: Array) -> Array:
    """Force (3,) in N that the supports of ``side`` exert: the sum of internal minus external nodal forces there.

    Raises:
        InputError: no such side.
    """
    return total(operator.comm, out_of_balance.reshape(-1, 3)[side_dofs(operator, side)].sum(axis=0))


def rigid_modes(x: Array) -> Array:
    """The six rigid-body motions (6, nodes, 3) of nodes x (nodes, 3)."""
    translations = np.broadcast_to(np.eye(3)[:, None, :], (3, len(x), 3))
    rotations = np.cross(np.eye(3)[:, None, :], x[None])
    return np.concatenate([translations, rotations])


def _rigid_gram(operator: StrainOperator, x: Array, fixed: NDArray[np.bool_]) -> Array:
    """Gram matrix (6, 6) of the rigid-body motions seen by the prescribed components, in coordinates of size 1."""
    comm = operator.comm
    count = max(comm.allreduce(len(x)), 1)
    centre = total(comm, x.sum(axis=0)) / count
    size = np.sqrt(total(comm, ((x - centre) ** 2).sum()) / count)
    modes = rigid_modes((x - centre) / size) * fixed
    gram = total(comm, np.einsum("inc,jnc->ij", modes, modes))
    return gram / max(np.trace(gram), 1.0)
