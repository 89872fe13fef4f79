"""The bar force of every cell of a body, where it varies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import dd_macro as dd
from dd_macro.compat import geometry_nodes
from dd_macro.parallel import together
from tsg_micro.cells.parameters import check_bar_force
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.radial_profiles import bar_force_profile
from tsg_micro.data.errors import InputError
from tsg_micro.data.table import Column, read_numbers
from workflows.scenes.bodies import block_counts, extent
from workflows.scenes.model import Profile, SceneModel

__all__ = ["bar_forces"]

Array = NDArray[np.float64]


def bar_forces(
    domain: dd.TaggedMesh, scene: SceneModel, tissues: tuple[Tissue, ...], cell_tissue: NDArray[np.int64]
) -> Array:
    """f_b (cells,) in N of every owned cell, or of the block that it is a part of; collective.

    Raises:
        InputError: a profile is not valid, or gives a force that the bars cannot carry; on all ranks.
    """
    middle = domain.mesh.geometry.x[geometry_nodes(domain.mesh)].mean(axis=1)
    ends, body, block = extent(domain), scene.body, tissues[0].block
    if body.mesh is None:  # elements of one block are of one tissue
        edge = block if body.spheroid is not None else (ends[1] - ends[0]) / block_counts(body, block)
        middle = (np.floor(middle / edge) + 0.5) * edge
    found = np.empty(len(middle))
    for number, ((name, model), tissue) in enumerate(zip(scene.tissue.items(), tissues, strict=True)):
        own = cell_tissue == number
        found[own] = tissue.bar_force
        profile = model.bar_force
        if not isinstance(profile, Profile):
            continue
        try:
            found[own] = together(domain.comm, lambda: _checked(profile, middle[own], ends, scene, tissue))  # noqa: B023
        except InputError as error:
            raise InputError(f"tissue.{name}.bar_force: {error}") from None
    return found


def _checked(profile: Profile, x: Array, ends: tuple[Array, Array], scene: SceneModel, tissue: Tissue) -> Array:
    force = _of_profile(profile, x, ends, scene, tissue) if profile.file is None else _nearest(profile.file, x)
    if len(force):
        check_bar_force(force, cells=len(force), EA_bar=tissue.cell.EA_bar)
    return force


def _of_profile(profile: Profile, x: Array, ends: tuple[Array, Array], scene: SceneModel, tissue: Tissue) -> Array:
    low, high = ends
    centre = 0.5 * (low + high) if profile.centre is None else np.array(profile.centre)
    radius = 0.5 * float((high - low).max()) if profile.radius is None else profile.radius
    if profile.radius is None and scene.body.spheroid is not None:
        radius = scene.body.spheroid * tissue.block
    r = np.linalg.norm(x - centre, axis=1) / radius
    assert profile.profile is not None
    assert profile.f_max is not None
    return bar_force_profile(r, profile=profile.profile, f_max=profile.f_max, decay=profile.decay)


def _nearest(path: Path, x: Array) -> Array:
    """The force of the nearest row of the file."""
    units = {"x": "m", "y": "m", "z": "m", "bar_force": "N"}
    columns = read_numbers(path, {name: Column(name, unit) for name, unit in units.items()})
    places = np.column_stack([columns[axis] for axis in "xyz"])
    return np.asarray(columns["bar_force"][cKDTree(places).query(x)[1]]) if len(x) else np.zeros(0)
