"""The supports and loads of a scene file, as dd_macro has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

import dd_macro as dd
from dd_macro.parallel import total
from tsg_micro.data.errors import InputError
from workflows.scenes.bodies import extent
from workflows.scenes.model import Along, Axis, Load, SceneModel, Support

__all__ = ["held_and_free", "loads_of", "supports_of"]

Array = NDArray[np.float64]
Side = str | tuple[str, ...]
Where = Callable[[Array], NDArray[np.bool_]]
_FLAT = 1e-6


def supports_of(domain: dd.TaggedMesh, scene: SceneModel) -> list[dd.Displacement]:
    """What is held and what is moved, in the order of the file, supports first; collective.

    Raises:
        InputError: a side is not in the mesh, or a plane of symmetry is not flat.
    """
    found = []
    for number, support in enumerate(scene.support):
        if support.side is None:
            continue
        _check_side(domain, support.side, f"support.{number}")
        axes = _axes(domain, support, f"support.{number}")
        where = _within(domain, support.within)
        found.append(dd.Displacement(support.side, (0.0,) * len(axes), axes, where))
    for number, load in enumerate(scene.load):
        if load.displacement is None or load.side is None:
            continue
        _check_side(domain, load.side, f"load.{number}")
        given = load.displacement
        moved = dict(given) if isinstance(given, dict) else dict(zip("xyz", given, strict=True))
        axes = tuple("xyz".index(axis) for axis in moved)
        found.append(dd.Displacement(load.side, tuple(moved.values()), axes, _within(domain, load.within)))
    return found


def loads_of(domain: dd.TaggedMesh, scene: SceneModel) -> list[dd.Load]:
    """What pulls; collective.

    Raises:
        InputError: a side or region is not in the mesh.
    """
    found: list[dd.Load] = []
    for number, load in enumerate(scene.load):
        if load.body_force is not None:
            if load.region is not None:
                _named(f"load.{number}.region", partial(domain.cells_of, load.region))
            found.append(dd.BodyForce(load.body_force, load.region))
        elif load.displacement is None:
            assert isinstance(load.side, str)
            _check_side(domain, load.side, f"load.{number}")
            found.append(_on_side(load, load.side))
    return found


def held_and_free(domain: dd.TaggedMesh, scene: SceneModel) -> tuple[set[str], set[str]]:
    """Sides that are held or moved as a whole in all components, and those without support or load; collective.

    A side that is loaded is not free: no stress passes through the outer blocks of a free one.
    """
    held = scene.held
    touched = scene.supported | {load.side for load in scene.load if isinstance(load.side, str)}
    facets = [domain.facets(side) for side in sorted(touched)]
    taken = np.unique(np.concatenate(facets)) if facets else np.zeros(0, dtype=np.int32)
    names = sorted(domain.names)
    shared = total(domain.comm, [np.isin(domain.facets(name), taken).sum() for name in names])
    return held, {name for name, count in zip(names, shared, strict=True) if count == 0}


def _names(side: Side | None) -> set[str]:
    return set() if side is None else {side} if isinstance(side, str) else set(side)


def _on_side(load: Load, side: str) -> dd.Load:
    if load.pressure is not None:
        return dd.Pressure(side, load.pressure)
    assert load.traction is not None
    return dd.Traction(side, _along(load.traction) if isinstance(load.traction, Along) else load.traction)


def _along(value: Along) -> Callable[[Array], Array]:
    axis, at, values = "xyz".index(value.along), np.array(value.at), np.array(value.value)

    def traction(x: Array) -> Array:
        return np.column_stack([np.interp(x[:, axis], at, column) for column in values.T])

    return traction


def _named(key: str, action: Callable[[], object]) -> None:
    try:
        action()
    except InputError as error:
        raise InputError(f"{key}: {error}") from None


def _check_side(domain: dd.TaggedMesh, side: Side, key: str) -> None:
    for name in _names(side):
        _named(f"{key}.side", partial(domain.facets, name))


def _within(domain: dd.TaggedMesh, ranges: Mapping[Axis, tuple[float, float]]) -> Where | None:
    """The mask of a part of a side; its ends belong to it. Collective."""
    if not ranges:
        return None
    low, high = extent(domain)
    near = _FLAT * float((high - low).max())

    def inside(x: Array) -> NDArray[np.bool_]:
        found = np.ones(len(x), dtype=bool)
        for axis, (least, most) in ranges.items():
            column = x[:, "xyz".index(axis)]
            found &= (column >= least - near) & (column <= most + near)
        return found

    return inside


def _axes(domain: dd.TaggedMesh, support: Support, key: str) -> tuple[int, ...]:
    """The components that are fixed."""
    if support.fix != "normal":
        return tuple(sorted({"xyz".index(axis) for axis in support.fix}))
    if not isinstance(support.side, str):
        raise InputError(f"{key}.fix: expected one side where it is normal, got {support.side}")
    low, high, _ = domain.extent(support.side)
    least, most = extent(domain)
    flat = np.flatnonzero(high - low <= _FLAT * (most - least).max())
    if len(flat) != 1:
        raise InputError(
            f"{key}.fix: expected a flat side normal to x, y or z where it is normal, got {support.side!r} of "
            f"{' x '.join(f'{d:.3g}' for d in high - low)} m"
        )
    return (int(flat[0]),)
