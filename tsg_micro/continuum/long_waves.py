"""Buckling of a periodic sheet by waves longer than a block: where an RVE of one block is no longer enough."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.structure import unit_of
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve import RVE, RVEState
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES
from tsg_micro.data.errors import ConvergenceError
from tsg_micro.data.mandel import to_mandel

__all__ = ["COMPRESSED", "buckling", "negative_pivots_repeated", "tensor_strain"]

Array = NDArray[np.float64]
COMPRESSED: dict[str, dict[str, float]] = {
    name: {c: high if c == "xy" else low for c, (low, high) in BOXES[name].ranges.items()}
    for name in ("stretch", "shear")
}
"""The most compressed corner of each of the paper's strain boxes, where a sheet would buckle first."""
_FRACTIONS, _BISECTIONS = 20, 6


def tensor_strain(components: Mapping[str, float], fraction: float = 1.0) -> Array:
    """Mandel vector (6,) of tensor components."""
    tensor = np.zeros((3, 3))
    for name, value in components.items():
        a, b = ("xyz".index(axis) for axis in name)
        tensor[a, b] = tensor[b, a] = fraction * value
    return to_mandel(tensor)


def negative_pivots_repeated(state: RVEState, one: RVE, many: RVE) -> int:
    """Unstable directions of ``many`` where each of its blocks is in the ``state`` of the RVE ``one``.

    Some mean that the periodic state buckles with a wave that ``many`` can hold and ``one`` cannot.
    """
    a, b = one.structure, many.structure
    span = unit_of(a).per_cell * (np.ptp(a.cells, axis=0) + 1)  # of the integer keys
    repeat = np.where(a.periodic, b.node_keys // span, 0)
    number = {tuple(key): i for i, key in enumerate(a.node_keys.tolist())}
    node = [number[tuple(key)] for key in (b.node_keys - repeat * span).tolist()]
    H = state.equilibrium.H
    u = state.equilibrium.displacement[node] + (repeat * a.size) @ H.T
    many.solver.move_to(np.concatenate([(u - u[0]).ravel(), H.ravel()]), np.zeros(u.size))
    return many.solver.tangent().negative_pivots


def buckling(
    name: str, *, sizes: Sequence[int], tissues: Sequence[Tissue], say: Callable[[str], None]
) -> dict[str, Any]:
    """Where on the way to the most compressed corner of the box ``name`` one block stops being enough, by RVE size.

    ``onset`` is the fraction of the strain at which the repeated state of one block becomes unstable, None where it
    never does; ``stress_norm`` is |P| of the stable states at the corner.
    """
    corner = COMPRESSED[name]
    onset: dict[str, list[float | None]] = {}
    stress: dict[str, list[float | None]] = {}
    for tissue in tissues:
        force, one = tissue.bar_force, RVESpec(tissue).build()
        coarse = [one.solve_strain(tensor_strain(corner, s)) for s in np.arange(1, _FRACTIONS + 1) / _FRACTIONS]
        onsets: list[float | None] = []
        norms: list[float | None] = [float(np.linalg.norm(coarse[-1].first_piola))]
        for n in sizes[1:]:
            many = RVESpec(tissue, (n, n, 1)).build()
            onsets.append(_onset(corner, coarse, one, many))
            norms.append(_stress_norm(many, corner) if onsets[-1] is not None else norms[0])
        onset[f"{force:g}"], stress[f"{force:g}"] = onsets, norms
        known = [f"{n}x{n} {t:.0%}" for n, t in zip(sizes[1:], onsets, strict=True) if t is not None]
        where = f"buckles at a fraction of: {', '.join(known)}" if known else "no buckling"
        say(f"compressed corner of the {name} box, bar force {force:g} N: {where}")
    return {"sizes": list(sizes), "onset": onset, "stress_norm": stress}


def _onset(corner: Mapping[str, float], coarse: list[RVEState], one: RVE, many: RVE) -> float | None:
    """The smallest fraction of ``corner`` at which the repeated state is unstable in ``many``; None if none is."""
    unstable = (k for k, state in enumerate(coarse) if negative_pivots_repeated(state, one, many))
    first = next(unstable, None)
    if first is None:
        return None
    low, high = first / _FRACTIONS, (first + 1) / _FRACTIONS
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if negative_pivots_repeated(one.solve_strain(tensor_strain(corner, middle)), one, many):
            high = middle
        else:
            low = middle
    return high


def _stress_norm(rve: RVE, corner: Mapping[str, float]) -> float | None:
    """|P| of a stable state at ``corner``, Pa; None where none was found."""
    rve.reset()
    try:
        return float(np.linalg.norm(rve.solve_strain(tensor_strain(corner)).first_piola))
    except ConvergenceError:
        return None
