"""A pin-jointed structure as plain arrays, and the equilibrium matrix that its geometry defines."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from tsg_micro.cells.laws.linear import LINEAR
from tsg_micro.cells.member_law import MemberLaw, Members
from tsg_micro.cells.unit_cell import BAR, UnitCell
from tsg_micro.data.errors import InputError

__all__ = ["Structure", "equilibrium_matrix", "from_arrays", "member_vectors", "unit_of"]


@dataclass(frozen=True)
class Structure:
    """Nodes, members and their stiffness; for lattices also which cell and block each member belongs to.

    In a periodic structure a member may end at an image of its second node, ``shift`` periods away.
    """

    nodes: NDArray[np.float64]
    """Reference coordinates (n, 3), m."""
    members: NDArray[np.int64]
    """Node pairs (m, 2)."""
    kind: NDArray[np.uint8]
    """Square tendon 0, edge tendon 1, bar 2 (m,)."""
    EA: NDArray[np.float64]
    """Axial stiffness at rest (m,), N."""
    rest_length: NDArray[np.float64]
    """Length without force (m,), m."""
    shift: NDArray[np.int64]
    """Periods between the second node and the image a member ends at (m, 3)."""
    size: NDArray[np.float64]
    """Edge lengths of the bounding box, m (3,); where periodic, the period."""
    periodic: tuple[bool, bool, bool] = (False, False, False)
    """Along which axes the structure repeats."""
    member_cells: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    """The one or two cells a member belongs to (m, 2), -1 for none."""
    member_places: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    """Which member of the unit cell it is in each of them (m, 2), -1 for none."""
    cells: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    """Lattice indices of the cells (c, 3)."""
    cell_block: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Which block each cell belongs to (c,)."""
    blocks: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    """Lattice indices of the 2x2x2 blocks (b, 3)."""
    node_keys: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    """Exact integer position of each node (n, 3), ``unit.per_cell`` to a cell; see tsg_micro.cells.lattice."""
    cell_nodes: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.zeros((0, 0), dtype=np.int64))
    """Nodes of every cell (c, k), in the order of the unit cell."""
    unit: UnitCell | None = None
    """What a lattice is tiled from."""
    law: MemberLaw = LINEAR
    """What the members answer to their lengths."""

    @property
    def bars(self) -> NDArray[np.bool_]:
        """Mask of the bars (m,)."""
        return self.kind == BAR

    @property
    def material(self) -> Members:
        """What the members are made of, as their law asks for it."""
        return Members(self.EA, self.bars)

    @property
    def height(self) -> float:
        """Edge of a cell of a lattice, m."""
        return float(self.size[0] / (np.ptp(self.cells[:, 0]) + 1))

    @property
    def volume(self) -> float:
        """Reference volume of the bounding box, m^3."""
        return float(np.prod(self.size))


def member_vectors(structure: Structure) -> NDArray[np.float64]:
    """Reference vectors of the members (m, 3), second end minus first, m.

    Example:
        >>> cell = tsg.Tissue().box((1, 1, 1))
        >>> length = np.linalg.norm(tsg.member_vectors(cell), axis=1)
        >>> np.unique((1e6 * length).round(3)).tolist()
        [3.536, 3.88, 9.334]
    """
    i, j = structure.members.T
    return structure.nodes[j] - structure.nodes[i] + structure.shift * structure.size


def unit_of(structure: Structure) -> UnitCell:
    """The unit cell that a lattice is tiled from.

    Raises:
        InputError: the structure is no lattice.
    """
    if structure.unit is None:
        raise InputError("structure: expected a lattice of cells")
    return structure.unit


def equilibrium_matrix(structure: Structure) -> sp.csc_array:
    """A_eq (3n, m): A_eq q are the nodal forces that hold force densities q, paper Section 2.1.

    Example:
        >>> cell = tsg.Tissue().box((1, 1, 1))
        >>> A = tsg.equilibrium_matrix(cell)
        >>> A.shape, int(np.linalg.matrix_rank(A.toarray()))
        ((72, 48), 47)
    """
    d = member_vectors(structure)
    m = len(d)
    i, j = (structure.members[:, end, None] * 3 + np.arange(3) for end in (0, 1))
    column = np.broadcast_to(np.arange(m)[:, None], (m, 3))
    rows = np.concatenate([i.ravel(), j.ravel()])
    columns = np.concatenate([column.ravel(), column.ravel()])
    values = np.concatenate([-d.ravel(), d.ravel()])
    return sp.csc_array((values, (rows, columns)), shape=(structure.nodes.size, m))


def from_arrays(
    nodes: NDArray[np.float64],
    members: NDArray[np.int64],
    *,
    kind: NDArray[np.uint8],
    EA: NDArray[np.float64],
    rest_length: NDArray[np.float64],
) -> Structure:
    """A structure that is no lattice, from its arrays (shapes as in :class:`Structure`); whole doubles are integers.

    Raises:
        InputError: shapes do not fit, a value is no number or not positive, a kind is none of 0, 1, 2, a member has no
            length, names no node or comes twice, or a node has no member.

    Example:
        >>> two = tsg.from_arrays(
        ...     np.array([[0.0, 0, 0], [1e-5, 0, 0], [2e-5, 0, 0]]),
        ...     np.array([[0, 1], [1, 2]]),
        ...     kind=np.array([0, 0]),
        ...     EA=np.full(2, 1e-6),
        ...     rest_length=np.full(2, 1e-5),
        ... )
        >>> len(two.members)
        2
    """
    nodes = _numbers("nodes", nodes, "finite coordinates")
    EA, rest_length = _numbers("EA", EA, "positive numbers"), _numbers("rest_length", rest_length, "positive numbers")
    members, kinds = _whole("members", members), _whole("kind", kind)
    m = len(members) if members.ndim else 0
    if nodes.ndim != 2 or nodes.shape[1] != 3:
        raise InputError(f"nodes: expected finite coordinates of shape (n, 3), got shape {nodes.shape}")
    if members.shape != (m, 2) or m == 0 or members.min() < 0 or members.max() >= len(nodes):
        found = f"{members.min()} to {members.max()}" if members.size else "none"
        raise InputError(
            f"members: expected pairs of node numbers below {len(nodes)}, from 0 on, shape (m, 2), got {found} in "
            f"shape {members.shape}"
        )
    for name, array in (("kind", kinds), ("EA", EA), ("rest_length", rest_length)):
        if array.shape != (m,):
            raise InputError(f"{name}: expected shape ({m},), got {array.shape}")
    for name, array in (("EA", EA), ("rest_length", rest_length)):
        if not (array > 0.0).all():
            raise InputError(f"{name}: expected positive numbers, got a minimum of {array.min()}")
    unknown = kinds[~np.isin(kinds, (0, 1, BAR))]
    if unknown.size:
        raise InputError(f"kind: expected 0 or 1 (tendons) or {BAR} (bar), got {unknown[0]}")
    flat = np.flatnonzero(np.linalg.norm(nodes[members[:, 1]] - nodes[members[:, 0]], axis=1) == 0.0)
    if flat.size:
        raise InputError(f"members: expected two distinct ends, got a member of length 0 (member {flat[0]})")
    pairs, first, count = np.unique(np.sort(members, axis=1), axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        i, j = pairs[count > 1][0]
        raise InputError(f"members: expected each once, got {i}-{j} {count.max()} times (member {first[count > 1][0]})")
    alone = np.setdiff1d(np.arange(len(nodes)), members)
    if alone.size:
        raise InputError(f"nodes: expected a member at every node, got none at {', '.join(map(str, alone[:5]))}")
    return Structure(
        nodes=nodes,
        members=members,
        kind=kinds.astype(np.uint8),
        EA=EA,
        rest_length=rest_length,
        shift=np.zeros((m, 3), dtype=np.int64),
        size=np.ptp(nodes, axis=0),
    )


def _numbers(name: str, values: object, expected: str) -> NDArray[np.float64]:
    """``values`` as finite doubles; InputError names what else they are."""
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        raise InputError(f"{name}: expected {expected}, got rows of different lengths") from None
    if array.dtype.kind not in "iufb":
        raise InputError(f"{name}: expected {expected}, got {array.ravel()[:1].tolist()}")
    if not np.isfinite(array).all():
        raise InputError(f"{name}: expected {expected}, got NaN or infinity")
    return array.astype(float)


def _whole(name: str, values: object) -> NDArray[np.int64]:
    """``values`` as integers, which other programs have as doubles; InputError names one that is not whole."""
    array = _numbers(name, values, "whole numbers")
    bad = array[(array != np.floor(array)) | (np.abs(array) > 2**53)]
    if bad.size:
        raise InputError(f"{name}: expected whole numbers, got {bad[0]}")
    return array.astype(np.int64)
