"""A body of blocks on a lattice, any of them with a bar force of its own: its outer faces, and the forces of loads.

A square face of a cell carries the area h x h, though its nodes span less: they share the traction on it so that
resultant and moment about the midpoint of the face are those of the traction on the whole square, as in a block of
a continuum. A uniform traction is shared equally.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsg_micro.bodies.sheet import FILL
from tsg_micro.cells.lattice import box_cells, face_nodes
from tsg_micro.cells.prestress import force_density_of_owners, prestressed
from tsg_micro.cells.structure import Structure, member_vectors, unit_of
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.errors import InputError
from tsg_micro.equilibrium.linear_solvers import choose_backend

__all__ = [
    "BlockBody",
    "Faces",
    "body_forces",
    "build_block_body",
    "cell_faces",
    "count_nodes",
    "memory_of_body",
    "outer_faces",
    "traction_forces",
]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
_GAUSS = 0.5 / np.sqrt(3.0)


@dataclass(frozen=True)
class BlockBody:
    """The prestressed body; coordinates of its structure are those of the lattice, ``origin`` is where that stands."""

    tissue: Tissue
    structure: Structure
    bar_force: Array
    """Of the blocks (b,) in the order of ``structure.blocks``, N."""
    prestress: Array
    """Force at rest that each of its cells gives a member (m, 2), N."""
    origin: Array = field(default_factory=lambda: np.zeros(3))
    """Coordinates (3,) of the corner of the lattice's block 0, m."""

    @property
    def position(self) -> Array:
        """Coordinates of the nodes (n, 3), m."""
        return self.origin + self.structure.nodes

    @property
    def cell_midpoint(self) -> Array:
        """Of every cell (c, 3), m."""
        return self.origin + self.structure.height * (self.structure.cells + 0.5)


def build_block_body(
    tissue: Tissue, blocks: ArrayLike, bar_force: ArrayLike, *, origin: Array | None = None
) -> BlockBody:
    """The body of 2x2x2-cell blocks at the lattice indices ``blocks`` (b, 3), each with a ``bar_force`` (b,) in N.

    Members that two cells share carry the sum of what both give them, so every cell is in balance at rest. All else is
    that of the ``tissue``.

    Raises:
        InputError: indices of another shape, a block that comes twice, or forces that are not valid.
    """
    blocks, force = np.asarray(blocks), np.asarray(bar_force, dtype=float)
    if blocks.ndim != 2 or blocks.shape[1:] != (3,) or len(blocks) == 0 or blocks.dtype.kind not in "iu":
        raise InputError(f"blocks: expected integers of shape (b, 3), b > 0, got {blocks.dtype} of {blocks.shape}")
    if force.shape != (len(blocks),):
        raise InputError(f"bar_force: expected one number a block ({len(blocks)}), got shape {force.shape}")
    order = np.lexsort(blocks.T[::-1])
    blocks, force = blocks[order].astype(np.int64), force[order]
    twice = np.flatnonzero((np.diff(blocks, axis=0) == 0).all(axis=1))
    if twice.size:
        raise InputError(f"blocks: expected each once, got {blocks[twice[0]].tolist()} twice")
    raw = tissue.lattice((2 * blocks[:, None] + box_cells(2, 2, 2)).reshape(-1, 3))
    of_cells = force[raw.cell_block]
    length = np.linalg.norm(member_vectors(raw), axis=1)
    prestress = force_density_of_owners(raw, tissue.cell, of_cells) * length[:, None]
    place = np.zeros(3) if origin is None else np.asarray(origin, dtype=float)
    return BlockBody(tissue, prestressed(raw, tissue.cell, of_cells), force, prestress, place)


def _neighbours(blocks: Ints) -> NDArray[np.bool_]:
    """Whether there is a block beyond the low and the high face across each axis (b, 3, 2)."""
    low = blocks.min(axis=0) - 1
    present = np.zeros(np.ptp(blocks, axis=0) + 3, dtype=bool)
    present[tuple((blocks - low).T)] = True
    there = np.zeros((len(blocks), 3, 2), dtype=bool)
    for axis in range(3):
        for end, step in enumerate((-1, 1)):
            there[:, axis, end] = present[tuple((blocks - low + step * np.eye(3, dtype=np.int64)[axis]).T)]
    return there


def count_nodes(tissue: Tissue, blocks: Ints) -> int:
    """Number of nodes of the body of ``blocks`` (b, 3), without building it."""
    unit, cells = tissue.unit_cell, 8 * len(blocks)
    outer = 4 * (~_neighbours(blocks)).sum(axis=(0, 2))
    shared = (2 * cells - outer) // 2
    return int(cells * len(unit.nodes) - sum(n * len(unit.faces[axis][0]) for axis, n in enumerate(shared)))


def memory_of_body(tissue: Tissue, blocks: Ints, linear_solver: str) -> tuple[str, int]:
    """Linear solver that a body of ``blocks`` (b, 3) gets, and an estimate of the memory that it takes, bytes.

    With n unknowns, nothing held, 200 MB + n (1000 + fill) B. In nested dissection the fill of a solid body grows as
    140 n^(1/3) (measured: 6.0 and 8.7 kB per unknown in all for 44 and 170 thousand in a ball, with PARDISO), of one
    that is L blocks thick as 200 L log2 n, as in a sheet; it is the smaller one.

    Raises:
        InputError: a linear solver that is not known or not installed.
    """
    n = 3 * count_nodes(tissue, blocks)
    backend = choose_backend(n, linear_solver).backend
    layers = int((np.ptp(blocks, axis=0) + 1).min())
    fill = FILL[backend] * min(140.0 * n ** (1.0 / 3.0), 200.0 * layers * np.log2(n))
    return backend, int(200e6 + n * (1000.0 + fill))


@dataclass(frozen=True)
class Faces:
    """Square faces of cells."""

    nodes: Ints
    """(k, 4)."""
    midpoint: Array
    """Of the lattice (k, 3), m."""
    axis: Ints
    """Which axis each is normal to (k,)."""
    end: Ints
    """1 where its block is below it, 0 where it is above (k,)."""
    block: Ints
    """Row of that block in ``structure.blocks`` (k,)."""

    def __len__(self) -> int:
        return len(self.axis)

    @property
    def outwards(self) -> Array:
        """Unit normals (k, 3) that point out of their blocks."""
        return np.eye(3)[self.axis] * (2.0 * self.end - 1.0)[:, None]

    def take(self, chosen: NDArray[np.bool_] | Ints) -> Faces:
        """Some of them."""
        arrays = (self.nodes, self.midpoint, self.axis, self.end, self.block)
        return Faces(*(array[chosen] for array in arrays))  # type: ignore[arg-type]


def cell_faces(structure: Structure, faces: Ints) -> Faces:
    """The four cell faces of every block face; ``faces`` (k, 3) are rows of block, axis, and end (0 low, 1 high)."""
    height, found = structure.height, []
    cells = np.argsort(structure.cell_block, kind="stable").reshape(-1, 8)  # of each block
    for axis in range(3):
        for end, name in ((0, "low"), (1, "high")):
            block = faces[(faces[:, 1] == axis) & (faces[:, 2] == end), 0]
            own = cells[block]
            own = own[structure.cells[own, axis] % 2 == end]
            middle = structure.cells[own] + 0.5 + (end - 0.5) * np.eye(3)[axis]
            nodes = face_nodes(structure, axis, end=name)[own]  # type: ignore[arg-type]
            ones = np.ones(len(own), dtype=np.int64)
            found.append((nodes, height * middle, axis * ones, end * ones, structure.cell_block[own]))
    return Faces(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))


def outer_faces(structure: Structure) -> Ints:
    """Block faces without a neighbour: rows (k, 3) of block, axis and end."""
    return np.argwhere(~_neighbours(structure.blocks))


def traction_forces(body: BlockBody, faces: Faces, traction: Callable[[Array], Array]) -> Array:
    """Dead nodal forces (n, 3), N, of a ``traction`` in Pa: a function of coordinates (m, 3) in m that gives (m, 3).

    With d_i the nodes of a face from their mean, d_g its Gauss points (2 x 2) and t_g the traction there,
    f_i = h^2/4 sum_g (1/k + d_i . (sum_j d_j (x) d_j)^-1 d_g) t_g, the inverse in the plane of the k nodes:
    sum f_i = int t dA, and sum d_i (x) f_i = int d (x) t dA.

    Raises:
        InputError: a value of another shape or not finite.
    """
    structure, (k, corners) = body.structure, faces.nodes.shape
    forces = np.zeros_like(structure.nodes)
    if k == 0:
        return forces
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    unit = np.eye(3)
    across = np.array([[unit[(axis + 1) % 3], unit[(axis + 2) % 3]] for axis in range(3)])[faces.axis]
    point = faces.midpoint[:, None] + _GAUSS * structure.height * np.einsum("gs,ksa->kga", signs, across)
    value = np.asarray(traction((body.origin + point).reshape(-1, 3)), dtype=float)
    if value.shape != (4 * k, 3) or not np.isfinite(value).all():
        raise InputError(f"traction: expected finite numbers in Pa of shape {(4 * k, 3)}, got shape {value.shape}")
    at = structure.nodes[faces.nodes]
    mean = at.mean(axis=1, keepdims=True)
    inverse = np.linalg.pinv(np.einsum("kia,kib->kab", at - mean, at - mean), rcond=1e-9, hermitian=True)
    share = 1.0 / corners + np.einsum("kia,kab,kgb->kig", at - mean, inverse, point - mean)
    np.add.at(
        forces, faces.nodes, 0.25 * structure.height**2 * np.einsum("kig,kga->kia", share, value.reshape(k, 4, 3))
    )
    return forces


def body_forces(body: BlockBody, density: Array) -> Array:
    """Dead nodal forces (n, 3), N, of a force per volume ``density`` (c, 3), N/m^3, in each of ``structure.cells``.

    The nodes of a cell share that of its volume equally; their midpoint is that of the cell.
    """
    structure = body.structure
    share = density * structure.height**3 / len(unit_of(structure).nodes)
    forces = np.zeros_like(structure.nodes)
    for node in structure.cell_nodes.T:
        np.add.at(forces, node, share)
    return forces
