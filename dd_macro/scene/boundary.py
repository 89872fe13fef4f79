"""Supports by the name of a side: prescribed displacements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce

import dolfinx
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro.parallel import check_everywhere, total
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.errors import InputError

__all__ = ["Displacement", "free_motions", "prescribed_displacement", "side_dofs"]

Array = NDArray[np.float64]
_FREE = 1e-9
"""Of the trace: an eigenvalue of the rigid motions' Gram matrix that is none."""


@dataclass(frozen=True)
class Displacement:
    """Prescribed displacement in m of the nodes of a side, all of them or those ``where`` says so.

    Several sides are the nodes that are on all of them: an edge, a point. ``value`` has one number per entry of
    ``components``, or is a function of coordinates (nodes, 3) in m that gives (nodes, len(components)); ``where`` is
    one that gives a mask (nodes,). Where two sides meet, the condition given later counts.

    Example:
        >>> all_of_it = dd.Displacement("bottom")
        >>> pulled = dd.Displacement("top", (1e-6,), (1,))  # its y alone
        >>> pulled.side, pulled.components
        ('top', (1,))
    """

    side: str | tuple[str, ...]
    value: Sequence[float] | Callable[[Array], Array] = (0.0, 0.0, 0.0)
    components: tuple[int, ...] = (0, 1, 2)
    where: Callable[[Array], NDArray[np.bool_]] | None = None

    @property
    def name(self) -> str:
        """The side, or all of them."""
        return self.side if isinstance(self.side, str) else " and ".join(self.side)


def side_dofs(operator: StrainOperator, side: str | tuple[str, ...]) -> NDArray[np.int64]:
    """Owned nodes of the side, or of all these sides; dof 3 * node + component is one entry of a nodal array.

    Raises:
        InputError: no such side, no facet on it, or no node on all of them.
    """
    if not isinstance(side, str):
        shared = reduce(np.intersect1d, [side_dofs(operator, one) for one in side])
        if operator.comm.allreduce(len(shared)) == 0:
            raise InputError(f"sides of the mesh: expected nodes on all of {', '.join(side)}, got none")
        return np.asarray(shared, dtype=np.int64)
    domain = operator.domain
    facets = domain.facets(side)
    if domain.comm.allreduce(len(facets)) == 0:
        raise InputError(f"side of the mesh: expected facets on {side!r}, got none")
    domain.mesh.topology.create_connectivity(2, 3)
    nodes = dolfinx.fem.locate_dofs_topological(operator.displacements, 2, facets)
    return nodes[nodes < operator.owned_nodes].astype(np.int64)


def prescribed_displacement(
    operator: StrainOperator, conditions: Sequence[Displacement]
) -> tuple[NDArray[np.bool_], Array]:
    """Mask and values of the unknowns that are prescribed, displacement components of nodes all.

    Raises:
        InputError: an unknown side, components other than 0, 1, 2, values of another shape or not finite, or no node
            where one is said to be.
    """
    fixed = np.zeros((operator.owned_dofs // 3, 3), dtype=bool)
    values = np.zeros_like(fixed, dtype=float)
    x = operator.node_coordinates()
    for condition in conditions:
        nodes, components = side_dofs(operator, condition.side), list(condition.components)
        if condition.where is not None:
            nodes = nodes[condition.where(x[nodes])]
            if operator.comm.allreduce(len(nodes)) == 0:
                raise InputError(f"displacement on {condition.side!r}: expected nodes in the part of it, got none")
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
    return fixed.reshape(-1), values.reshape(-1)


def rigid_modes(x: Array) -> Array:
    """The six rigid-body motions (6, nodes, 3) of nodes x (nodes, 3)."""
    translations = np.broadcast_to(np.eye(3)[:, None, :], (3, len(x), 3))
    rotations = np.cross(np.eye(3)[:, None, :], x[None])
    return np.concatenate([translations, rotations])


def free_motions(operator: StrainOperator, fixed: NDArray[np.bool_], *, allowed: bool) -> Array:
    """Rigid motions (k, 3 * nodes) that the mask ``fixed`` of unknowns leaves to connected parts; orthonormal.

    Raises:
        InputError: there are some and they are not ``allowed``, or a part is not held at all beside others that are.
    """
    x = operator.node_coordinates()
    part, cells = _parts(operator)
    away, size = _from_middle(operator, x, part, len(cells))
    modes = rigid_modes(away / size[part, None])
    seen = modes * fixed[: x.size].reshape(-1, 3)
    gram = _by_part(operator, np.einsum("inc,jnc->nij", seen, seen), part, len(cells))
    gram /= np.maximum(np.trace(gram, axis1=1, axis2=2), 1.0)[:, None, None]
    values, vectors = np.linalg.eigh(gram)
    free = (values <= _FREE).sum(axis=1)
    if len(cells) > 1 and (free == 6).any():
        loose = np.sort(cells[free == 6])
        parts = ", ".join(f"a part of {n} cell{'s' * int(n > 1)}" for n in loose[:5])
        raise InputError(
            f"mesh: expected every connected part to be held, {parts} is not ({len(loose)} of {len(cells)})"
        )
    if free.any() and not allowed:
        raise InputError(
            f"boundary conditions: expected no rigid-body motion left free, got {free.max()} of 6; fix more "
            "components, or hold the mean of a body that is free in space"
        )
    found = [np.zeros((0, x.size))]
    for k in range(len(cells)):
        mode = np.einsum("ij,inc->jnc", vectors[k][:, : free[k]], modes) * (part == k)[:, None]
        found.append(mode.reshape(free[k], x.size))
    motions = np.concatenate(found)
    if len(motions):
        lower = np.linalg.cholesky(total(operator.comm, motions @ motions.T))
        motions = np.linalg.solve(lower, motions)
    return motions


def _parts(operator: StrainOperator) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Connected part of each owned node, and how many cells each part has on all ranks."""
    domain, owned = operator.domain, operator.owned_nodes
    part = np.zeros(owned, dtype=np.int64)
    if domain.parts is None:
        return part, np.array([domain.global_cells])
    count = domain.comm.allreduce(int(domain.parts.max(initial=0)), op=MPI.MAX) + 1
    nodes = operator.displacements.dofmap.list
    inside = nodes < owned
    part[nodes[inside]] = np.broadcast_to(domain.parts[: len(nodes), None], nodes.shape)[inside]
    cells = np.bincount(domain.parts[: domain.owned_cells], minlength=count)
    return part, total(domain.comm, cells).astype(np.int64)


def _by_part(operator: StrainOperator, values: Array, part: NDArray[np.int64], parts: int) -> Array:
    """Sums (parts, ...) over all ranks of values (nodes, ...) of owned nodes."""
    summed = np.zeros((parts, *values.shape[1:]))
    np.add.at(summed, part, values)
    return total(operator.comm, summed)


def _from_middle(operator: StrainOperator, x: Array, part: NDArray[np.int64], parts: int) -> tuple[Array, Array]:
    """Nodes x (nodes, 3) seen from the middle of their part, and the radius of gyration (parts,) of each."""
    count = np.maximum(_by_part(operator, np.ones(len(x)), part, parts), 1.0)
    away = x - (_by_part(operator, x, part, parts) / count[:, None])[part]
    return away, np.sqrt(_by_part(operator, (away**2).sum(axis=1), part, parts) / count)
