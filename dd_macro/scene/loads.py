"""What pulls at a body. A load is a small class that answers for its nodal forces; a new one is a file of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dd_macro.parallel import check_everywhere
from dd_macro.scene.facets import SideFacets, add_at_nodes
from dd_macro.scene.spaces import StrainOperator

__all__ = ["BodyForce", "Load", "Traction", "nodal_forces", "three_at"]

Array = NDArray[np.float64]
Value = tuple[float, float, float] | Callable[[Array], Array]
"""Three numbers, or a function of coordinates (k, 3) in m that gives (k, 3)."""


class Load(Protocol):
    """A load that does not follow the body; a load step applies a part of it."""

    def nodal_forces(self, operator: StrainOperator) -> Array:
        """Consistent nodal forces (3 * nodes,) in N of this rank's nodes; collective.

        Raises:
            InputError: on all ranks, where the load does not fit the mesh or is not valid.
        """


@dataclass(frozen=True)
class Traction:
    """Dead traction in Pa on a side, per area at rest.

    ``value`` is three numbers, or a function of coordinates (k, 3) in m that gives (k, 3).

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> loaded = dd.Problem(operator, [dd.Displacement("left")], [dd.Traction("right", (15.0, 0.0, 0.0))])
        >>> law = dd.LinearLaw(1e3 * np.eye(6))
        >>> solution = dd.LawMethod().prepare(loaded, dd.Material(law=law)).solve()
        >>> f"{solution.reaction('left')[0]:.1e}"
        '-1.2e-08'
    """

    side: str
    value: Value

    def nodal_forces(self, operator: StrainOperator) -> Array:
        """Consistent nodal forces (3 * nodes,) in N.

        Raises:
            InputError: an unknown side, one without outer facets, or a value that is not three finite numbers.
        """
        facets = SideFacets(operator, self.side)
        value = three_at(operator, facets.points, self.value, f"traction on {self.side!r}", "Pa")
        return facets.nodal(value * np.linalg.norm(facets.areas, axis=-1, keepdims=True))


@dataclass(frozen=True)
class BodyForce:
    """Dead force in N/m^3 at rest in a region of the mesh, or in all of it.

    ``value`` is three numbers, or a function of coordinates (k, 3) in m that gives (k, 3).

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> weight = dd.BodyForce((0.0, 0.0, -1e4))
        >>> f"{weight.nodal_forces(operator).reshape(-1, 3).sum(axis=0)[2]:.3g}"
        '-3.2e-10'
    """

    value: Value
    region: str | None = None

    def nodal_forces(self, operator: StrainOperator) -> Array:
        """Consistent nodal forces (3 * nodes,) in N.

        Raises:
            InputError: an unknown region, or a value that is not three finite numbers.
        """
        domain, nq = operator.domain, operator.points_per_cell
        cells = np.arange(domain.owned_cells) if self.region is None else domain.cells_of(self.region)
        points = operator.points.reshape(-1, nq, 3)[cells]
        value = three_at(operator, points, self.value, "body force", "N/m^3")
        force = value * operator.weights.reshape(-1, nq)[cells][..., None]
        shape = operator.displacements.element.basix_element.tabulate(0, operator.reference_points)[0, :, :, 0]
        dofs = operator.displacements.dofmap.list[cells].astype(np.int64)
        return add_at_nodes(operator, dofs, np.einsum("qk,cqi->cki", shape, force))


def three_at(operator: StrainOperator, x: Array, value: Value, what: str, unit: str) -> Array:
    """The value, three numbers at all points x (..., 3); collective.

    Raises:
        InputError: on all ranks, where it is not three finite numbers at each.
    """
    found, message = np.zeros_like(x), None
    given = value(x.reshape(-1, 3)) if callable(value) and x.size else np.zeros((0, 3)) if callable(value) else value
    try:
        array = np.asarray(given, dtype=float)
        expected = (x.size // 3, 3) if callable(value) else (3,)
        if array.shape != expected or not np.isfinite(array).all():
            message = f"{what}: expected three finite numbers in {unit}, got {_short(given)}"
        else:
            found = np.broadcast_to(array.reshape(x.shape) if callable(value) else array, x.shape)
    except (TypeError, ValueError):
        message = f"{what}: expected three finite numbers in {unit}, got {_short(given)}"
    check_everywhere(operator.comm, message)
    return found


def _short(given: object) -> str:
    array = np.asarray(given, dtype=object)
    return f"{given}" if array.size <= 4 else f"an array of shape {array.shape}, or NaN or infinity in it"


def nodal_forces(operator: StrainOperator, loads: Iterable[Load]) -> Array:
    """Consistent forces in N of all the loads on the unknowns: those of nodes, (3 * nodes,), and zeros for others.

    Raises:
        InputError: as a load's.
    """
    forces = np.zeros(operator.owned_dofs)
    for load in loads:
        forces[: 3 * operator.owned_nodes] += load.nodal_forces(operator)
    return forces
