"""Cells tiled to blocks, sheets and voxel shapes, merged exactly by integer keys.

Cell (i, j, k) is the unit cell mirrored in x if i is odd, in y if j is odd, in z if k is odd, so that neighbours
share a face: its nodes and its tendons are one. Every node has an exact integer position, its key, from its place in
the unit cell. Two nodes are the same if and only if their keys are equal; no distance is compared.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsg_micro.cells.parameters import TABLE_1, CellParameters
from tsg_micro.cells.structure import Structure, member_vectors, unit_of
from tsg_micro.cells.truncated_octahedron import unit_cell
from tsg_micro.cells.unit_cell import BAR, UnitCell
from tsg_micro.data.errors import InputError

__all__ = ["Images", "box_cells", "face_nodes", "lattice", "side_nodes", "spheroid_cells"]

Images = Literal["merged", "duplicated"]


def box_cells(nx: int, ny: int, nz: int) -> NDArray[np.int64]:
    """Lattice indices (nx*ny*nz, 3) of a box of cells.

    Raises:
        InputError: a count is below 1.

    Example:
        >>> tsg.box_cells(2, 1, 1).tolist()
        [[0, 0, 0], [1, 0, 0]]
    """
    if min(nx, ny, nz) < 1:
        raise InputError(f"cells: expected three counts of at least 1, got {nx} {ny} {nz}")
    return np.stack(np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij"), axis=-1).reshape(-1, 3)


def spheroid_cells(radius: float) -> NDArray[np.int64]:
    """Cells (c, 3) of all 2x2x2 blocks whose centre lies within ``radius`` blocks of the centre of the shape.

    A radius of 5 gives the paper's spheroid: 552 blocks, 4416 cells (Table 2).

    Raises:
        InputError: the radius is too small for a single block, or not finite.

    Example:
        >>> len(tsg.spheroid_cells(5))
        4416
    """
    if not (np.isfinite(radius) and radius >= np.sqrt(0.75)):
        raise InputError(f"radius: expected at least {np.sqrt(0.75):.3f} blocks, got {radius}")
    half = int(np.ceil(radius))
    blocks = box_cells(2 * half, 2 * half, 2 * half)
    blocks = blocks[((blocks + 0.5 - half) ** 2).sum(axis=1) <= radius**2]
    return (2 * blocks[:, None] + box_cells(2, 2, 2)).reshape(-1, 3)


def _number(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First occurrence of each distinct row of integers, and the number of every row's distinct one."""
    low = keys.min(axis=0)
    packed = np.ravel_multi_index(tuple((keys - low).T), tuple(np.ptp(keys, axis=0) + 1))
    _, first, inverse = np.unique(packed, return_index=True, return_inverse=True)
    return first, inverse


def _check(cells: NDArray[np.int64], periodic: tuple[bool, bool, bool], images: str) -> None:
    """Raise InputError where :func:`lattice` cannot tile that."""
    if cells.ndim != 2 or cells.shape[1] != 3 or len(cells) == 0:
        raise InputError(f"cells: expected lattice indices of shape (c, 3), got {cells.shape}")
    if images not in ("merged", "duplicated"):
        raise InputError(f"images: expected 'merged' or 'duplicated', got {images!r}")
    if len(_number(cells)[0]) != len(cells):
        raise InputError("cells: expected distinct cells, got one twice")
    count = np.ptp(cells, axis=0) + 1
    for axis, repeats in enumerate(periodic):
        if repeats and (count[axis] % 2 or len(cells) != np.prod(count)):
            raise InputError(
                f"periodic: expected a full box with an even number of cells along {'xyz'[axis]}, got {count[axis]}"
            )


def lattice(
    cells: ArrayLike,
    parameters: CellParameters | None = None,
    *,
    periodic: tuple[bool, bool, bool] = (False, False, False),
    images: Images = "merged",
    unit: UnitCell | None = None,
) -> Structure:
    """The structure of ``cells`` (c, 3), lattice indices, without prestress (rest lengths are the lengths).

    ``unit`` is what is tiled, by default the truncated octahedron of the parameters' half-diagonal.

    With ``periodic`` axes, nodes on opposite faces of the box are one. ``images`` says what becomes of the members
    there: "merged" counts them once, as inside an infinite body; "duplicated" keeps both, as if the faces were
    only tied.

    Raises:
        InputError: ``cells`` is empty or repeats a cell, or a periodic axis does not hold a full box of an even
            number of cells.

    Example:
        >>> block = tsg.lattice(tsg.box_cells(2, 2, 2), tsg.CellParameters())
        >>> len(block.nodes), int(block.bars.sum()), int((~block.bars).sum())
        (144, 96, 240)
    """
    parameters = parameters or TABLE_1
    cells = np.atleast_2d(np.asarray(cells, dtype=np.int64))
    _check(cells, periodic, images)
    count = np.ptp(cells, axis=0) + 1
    unit = unit or unit_cell(parameters.half_diagonal)
    count_nodes, count_members = len(unit.nodes), len(unit.members)
    mirror = (1 - 2 * (cells % 2))[:, None, :]
    local = unit.nodes * mirror  # (c, k, 3), half cell heights
    keys = (unit.per_cell * cells[:, None] + unit.per_cell // 2 + unit.places * mirror).reshape(-1, 3)
    position = (0.5 * parameters.height * (2 * cells[:, None] + 1 + local)).reshape(-1, 3)

    origin, span = unit.per_cell * cells.min(axis=0), unit.per_cell * count
    wraps = np.asarray(periodic)
    image = np.where(wraps, (keys - origin) // span, 0)
    wrapped = keys - image * span
    first, node = _number(wrapped)
    size = count * parameters.height

    pairs = (count_nodes * np.arange(len(cells))[:, None, None] + unit.members).reshape(-1, 2)
    ends = node[pairs]
    shift = image[pairs[:, 1]] - image[pairs[:, 0]]
    flip = ends[:, 0] > ends[:, 1]
    ends[flip] = ends[flip, ::-1]
    shift[flip] *= -1
    identity = [ends, shift]
    if images == "duplicated":
        identity += [image[pairs].min(axis=1)]
    member_first, member = _number(np.concatenate(identity, axis=1))

    owner, place = np.divmod(np.arange(len(member)), count_members)
    again = np.setdiff1d(np.arange(len(member)), member_first, assume_unique=True)
    member_cells, member_places = np.full((2, len(member_first), 2), -1, dtype=np.int64)
    for side, number, at in ((0, slice(None), member_first), (1, member[again], again)):
        member_cells[number, side], member_places[number, side] = owner[at], place[at]

    kind = unit.kind[place[member_first]]
    block_first, cell_block = _number(cells // 2)
    structure = Structure(
        nodes=position[first] - image[first] * size,
        members=ends[member_first],
        kind=kind,
        EA=np.where(kind == BAR, parameters.EA_bar, parameters.EA_tendon),
        rest_length=np.ones(len(kind)),
        shift=shift[member_first],
        size=size.astype(float),
        periodic=periodic,
        member_cells=member_cells,
        member_places=member_places,
        cells=cells,
        cell_block=cell_block,
        blocks=(cells // 2)[block_first],
        node_keys=wrapped[first],
        cell_nodes=node.reshape(-1, count_nodes),
        unit=unit,
    )
    return dataclasses.replace(structure, rest_length=np.linalg.norm(member_vectors(structure), axis=1))


def side_nodes(structure: Structure, axis: int, *, end: Literal["low", "high"]) -> NDArray[np.int64]:
    """Numbers (k,) of the nodes on the flat outer face of a lattice across ``axis`` (0, 1, 2).

    Raises:
        InputError: the structure is no lattice.

    Example:
        >>> block = tsg.Tissue().box((2, 2, 2))
        >>> top = tsg.side_nodes(block, 1, end="high")
        >>> len(top), float(np.ptp(block.nodes[top, 1]))
        (16, 0.0)
    """
    limit = structure.cells[:, axis].min() if end == "low" else structure.cells[:, axis].max() + 1
    return np.flatnonzero(structure.node_keys[:, axis] == unit_of(structure).per_cell * limit)


def face_nodes(structure: Structure, axis: int, *, end: Literal["low", "high"]) -> NDArray[np.int64]:
    """Numbers of the nodes on that face of every cell (c, k) of a lattice; odd cells are mirrored."""
    faces = np.array(unit_of(structure).faces[axis])
    side = (structure.cells[:, axis] % 2) ^ (end == "high")
    return np.take_along_axis(structure.cell_nodes, faces[side], axis=1)
