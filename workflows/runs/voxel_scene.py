"""The supports and loads of a scene on the lattice of a body of voxels.

Nodes of the lattice lie on the faces of voxels, not at their corners: what a support or a load says of coordinates is
asked at the nodes' own places, or at the Gauss points of the faces of cells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import dd_macro as dd
from tsg_micro.bodies.voxel_body import (
    BlockBody,
    Faces,
    body_forces,
    build_block_body,
    cell_faces,
    outer_faces,
    traction_forces,
)
from tsg_micro.bodies.voxel_path import VoxelLoads
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.errors import InputError

__all__ = ["VoxelScene", "scene_loads", "voxel_scene"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class VoxelScene:
    """A body of voxels, and where its mesh's sides and cells are on the lattice."""

    grid: dd.VoxelGrid
    body: BlockBody
    row: Ints
    """Row in ``body.structure.blocks`` of every cell of the mesh (cells,)."""
    sides: dict[str, Faces]
    """Faces of the lattice's cells on every side of the mesh that has facets."""

    def faces(self, side: str) -> Faces:
        """Those of a side.

        Raises:
            InputError: there is no such side, or no facet on it.
        """
        if side not in self.sides:
            self.grid.faces(side)  # says what is wrong with it
        return self.sides[side]

    def nodes(self, side: str | tuple[str, ...]) -> Ints:
        """Numbers of the nodes on a side (k,).

        No node is on several outer sides. Of the edge or point where sides meet these are the nodes next to it: one of
        every face there that is on a side.

        Raises:
            InputError: there is no such side, no facet on it, or no cell on all of them.
        """
        if isinstance(side, str):
            return np.unique(self.faces(side).nodes)
        sides = [self.faces(one) for one in side]
        corners = [_corners(faces, self.body.structure.height) for faces in sides]
        keys, of = np.unique(np.concatenate([c.reshape(-1, 3) for c in corners]), axis=0, return_inverse=True)
        each = np.split(of.reshape(-1, 4), np.cumsum([len(faces) for faces in sides])[:-1])
        shared: Ints = each[0]
        for one in each[1:]:
            shared = np.asarray(np.intersect1d(shared, one))
        if len(shared) == 0:
            raise InputError(f"sides of the mesh: expected nodes on all of {', '.join(side)}, got none")
        found = []
        for faces, own in zip(sides, each, strict=True):
            meets = np.isin(own, shared)
            for face in np.flatnonzero(meets.any(axis=1)):
                nodes = faces.nodes[face]
                place = 0.5 * self.body.structure.height * keys[own[face, meets[face]]].mean(axis=0)
                away = np.linalg.norm(self.body.structure.nodes[nodes] - place, axis=1)
                found.append(nodes if meets[face].all() else nodes[[away.argmin()]])
        return np.unique(np.concatenate(found))


def _corners(faces: Faces, height: float) -> Ints:
    """Corners of square faces (k, 4, 3), in halves of a cell's ``height``."""
    middle = np.rint(2.0 * faces.midpoint / height).astype(np.int64)
    unit = np.eye(3, dtype=np.int64)
    u, v = unit[(faces.axis + 1) % 3], unit[(faces.axis + 2) % 3]
    return np.stack([middle + a * u + b * v for a in (-1, 1) for b in (-1, 1)], axis=1)


def voxel_scene(domain: dd.TaggedMesh, tissue: Tissue, bar_force: ArrayLike) -> VoxelScene:
    """The lattice that fills a mesh of voxels, one block of the ``tissue`` each, with a ``bar_force`` (cells,) in N.

    Raises:
        InputError: the mesh is no such mesh, or on several ranks, or the bar forces are not valid.
    """
    grid = dd.voxel_grid(domain, tissue.block)
    force = np.asarray(bar_force, dtype=float)
    if force.shape != (len(grid.index),):
        raise InputError(f"bar_force: expected one number a cell ({len(grid.index)}), got shape {force.shape}")
    body = build_block_body(tissue, grid.index, force, origin=grid.origin)
    row = np.empty(len(grid.index), dtype=np.int64)
    row[np.lexsort(grid.index.T[::-1])] = np.arange(len(row))
    structure, sides = body.structure, {}
    assert np.array_equal(structure.blocks[row], grid.index)
    for name in domain.names:
        if len(domain.facets(name)):
            faces = grid.faces(name)
            faces[:, 0] = row[faces[:, 0]]
            sides[name] = cell_faces(structure, faces)
    return VoxelScene(grid, body, row, sides)


def scene_loads(scene: VoxelScene, supports: Sequence[dd.Displacement], loads: Sequence[dd.Load]) -> VoxelLoads:
    """What supports and loads are on the lattice.

    A pressure that acts on the whole outer surface with one value follows it; on parts of it, or with several values,
    pressures are dead normal tractions.

    Raises:
        InputError: an unknown side or region, a value of another shape or not finite, a support that meets no node, a
            load of another kind.
    """
    body = scene.body
    fixed, displacement = _prescribed(scene, supports)
    every = cell_faces(body.structure, outer_faces(body.structure))
    normal = np.zeros(len(every))
    force = np.zeros_like(displacement)
    for load in loads:
        if isinstance(load, dd.BodyForce):
            force += body_forces(body, _density(scene, load))
        elif isinstance(load, dd.Pressure):
            normal[_on_side(scene, every, load.side)] += float(load.value)
        elif isinstance(load, dd.Traction):
            traction = _at(load.value, f"traction on {load.side!r}", "Pa")
            force += traction_forces(body, every.take(_on_side(scene, every, load.side)), traction)
        else:
            raise InputError(f"load: expected a traction, a pressure or a body force, got a {type(load).__name__}")
    if np.ptp(normal) == 0.0:
        return VoxelLoads(fixed, displacement, force, float(normal[0]))
    for value in np.unique(normal[normal != 0.0]):
        for axis in range(3):
            for end in (0, 1):
                faces = every.take((normal == value) & (every.axis == axis) & (every.end == end))
                push = (1.0 - 2.0 * end) * value * np.eye(3)[axis]
                force += traction_forces(body, faces, _at(push, "pressure", "Pa"))
    return VoxelLoads(fixed, displacement, force)


def _prescribed(scene: VoxelScene, supports: Sequence[dd.Displacement]) -> tuple[NDArray[np.bool_], Array]:
    """Mask and values (n, 3) of what is prescribed; where two conditions meet, the later one counts."""
    x = scene.body.position
    fixed, values = np.zeros(x.shape, dtype=bool), np.zeros(x.shape)
    for support in supports:
        nodes, components = scene.nodes(support.side), list(support.components)
        if not components or not set(components) <= {0, 1, 2}:
            raise InputError(f"components on {support.name!r}: expected some of 0, 1, 2, got {support.components}")
        if support.where is not None:
            nodes = nodes[np.asarray(support.where(x[nodes]), dtype=bool)]
        if len(nodes) == 0:
            raise InputError(
                f"displacement on {support.name!r}: expected nodes of the lattice where it says, got none "
                "(they lie on the faces of voxels, not on their edges and corners)"
            )
        given = np.asarray(support.value(x[nodes]) if callable(support.value) else support.value, dtype=float)
        expected = (len(nodes), len(components)) if callable(support.value) else (len(components),)
        if given.shape != expected or not np.isfinite(given).all():
            raise InputError(
                f"displacement on {support.name!r}: expected finite numbers in m of shape {expected}, got {given.shape}"
            )
        fixed[np.ix_(nodes, components)] = True
        values[np.ix_(nodes, components)] = given
    return fixed, values


def _on_side(scene: VoxelScene, outer: Faces, side: str) -> NDArray[np.bool_]:
    """Which of the ``outer`` faces (k,) are on a side.

    Raises:
        InputError: there is no such side, or none are.
    """
    own = scene.faces(side)
    number, wanted = (6 * faces.block + 2 * faces.axis + faces.end for faces in (outer, own))
    chosen = np.isin(number, wanted)
    if not chosen.any():
        raise InputError(f"load on {side!r}: expected outer facets of the mesh, got none")
    return chosen


def _at(value: Any, what: str, unit: str) -> Callable[[Array], Array]:
    """Three numbers, or a function of coordinates, as a function of coordinates (k, 3) that checks what it gives."""

    def at(x: Array) -> Array:
        given = np.asarray(value(x) if callable(value) else value, dtype=float)
        expected = x.shape if callable(value) else (3,)
        if given.shape != expected or not np.isfinite(given).all():
            raise InputError(f"{what}: expected finite numbers in {unit} of shape {expected}, got shape {given.shape}")
        return np.broadcast_to(given, x.shape)

    return at


def _density(scene: VoxelScene, load: dd.BodyForce) -> Array:
    """Force per volume (c, 3) in the cells of the lattice."""
    structure, domain = scene.body.structure, scene.grid.domain
    inside = np.zeros(len(structure.blocks), dtype=bool)
    inside[scene.row if load.region is None else scene.row[domain.cells_of(load.region)]] = True
    density = _at(load.value, "body force", "N/m^3")(scene.body.cell_midpoint)
    return np.where(inside[structure.cell_block, None], density, 0.0)
