"""The full tensegrity as the reference of data-driven solutions: its block means, and errors against them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import dd_macro as dd
from tsg_micro.data.dataset import Dataset, convert_dataset
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.errors import InputError
from workflows.store.record import read_summary

__all__ = ["SCENE", "Errors", "check_same_scene", "describe", "read_blocks", "solution_errors"]

SCENE = ("load", "strain", "bar_force")
"""Parameters that a data-driven run and its reference have in common."""
_CELLS = ("cell", "unit", "law")
"""The same, where both say what it is."""


@dataclass(frozen=True)
class Errors:
    """Errors of one data-driven solution, and its normalised distance |y - z| / |z|, of all blocks and inner ones."""

    comparison: dd.Comparison
    distance: float
    distance_inner: float

    def row(self, symbol: str) -> dict[str, float]:
        """Plain numbers: errors (l2) of ``symbol``, p or q, and distances."""
        mech = getattr(self.comparison, f"error_{symbol}_mech")
        mat = getattr(self.comparison, f"error_{symbol}_mat")
        return {
            "error_mech": mech.l2,
            "error_mat": mat.l2,
            "error_mech_all": mech.l2_all,
            "error_mat_all": mat.l2_all,
            "distance": self.distance_inner,
            "distance_all": self.distance,
        }


def check_same_scene(parameters: dict[str, Any], dns: Path, whose: str) -> None:
    """Raise InputError where ``parameters`` are not of the load, strain and tissue of the run in folder ``dns``.

    What one of the two does not say of its tissue, as older runs, is not compared.
    """
    reference = read_summary(dns, "dns")["parameters"]
    if ("scene" in parameters) != ("scene" in reference):
        raise InputError(f"scene: expected two runs of one scene file, got one of none, {whose} or {dns}")
    if "scene" in parameters:
        _check_same_file(parameters["scene"], reference["scene"], whose, dns)
        return
    for name in SCENE:
        a, b = parameters.get(name), reference.get(name)
        if a != b and not (name == "bar_force" and a is None):  # None: of joined or measured data
            raise InputError(f"{name}: expected the same in both runs, got {a} in {whose} and {b} in {dns}")
    for name in _CELLS:
        a, b = parameters.get(name), reference.get(name)
        if a is not None and b is not None and a != b:
            raise InputError(f"tissue, {name}: expected the same in both runs, got {a} in {whose} and {b} in {dns}")


def _first_difference(name: str, a: Any, b: Any) -> tuple[str, Any, Any]:
    """Where two values of a summary, which are not equal, first differ: name of the part, and what either says."""
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        a, b = (dict(enumerate(values, 1)) for values in (a, b))
    if not isinstance(a, dict) or not isinstance(b, dict):
        return name, a, b
    if a.keys() != b.keys():
        return name, ", ".join(map(str, a)), ", ".join(map(str, b))
    key = next(key for key in a if a[key] != b[key])
    return _first_difference(f"{name}.{key}", a[key], b[key])


def _check_same_file(ours: Any, theirs: Any, whose: str, dns: Path) -> None:
    """Raise InputError where two scenes from files differ in more than how they are solved."""
    if not isinstance(ours, dict) or not isinstance(theirs, dict):
        raise InputError(f"scene: expected a table in the summaries of {whose} and {dns}, got something else")
    for name in ("tissue", "support", "load"):
        a, b = (_without(scene.get(name), "data", "kind") for scene in (ours, theirs))
        if a != b:
            where, a, b = _first_difference(f"scene, {name}", a, b)
            raise InputError(f"{where}: expected the same in both runs, got {a} in {whose} and {b} in {dns}")
    ends = [scene.get("solve", {}).get("steps") for scene in (ours, theirs)]
    last = [steps[-1] if isinstance(steps, list) else 1.0 for steps in ends]
    if last[0] != last[1]:
        raise InputError(f"scene, load: expected the same part of it, got {last[0]} in {whose} and {last[1]} in {dns}")


def _without(value: Any, *names: str) -> Any:
    """The value without these keys, at any depth."""
    if isinstance(value, dict):
        return {key: _without(one, *names) for key, one in value.items() if key not in names}
    return value


def describe(dns: dict[str, Any]) -> str:
    """The reference in words, from the summary of its run: a sheet held flat need not be a stable one."""
    return "full tensegrity" + (", held flat" if dns["parameters"].get("flat") else "")


def read_blocks(dns: Path, measure: str) -> Dataset:
    """Block means of the run in folder ``dns`` in this stress measure, with midpoints.

    The first Piola and the Kirchhoff stress of a block are means over its members; Cauchy and second Piola stress are
    made from them with the block's mean F.

    Raises:
        InputError: the folder does not hold them.
    """
    means = dns / ("blocks_kirchhoff.h5" if measure in ("kirchhoff", "cauchy") else "blocks.h5")
    blocks = convert_dataset(read_dataset(means), measure)
    if blocks.midpoint is None:
        raise InputError(f"{means}: expected block midpoints, got none")
    return blocks


def solution_errors(result: dd.Solution, blocks: Dataset) -> Errors:
    """Errors of ``result`` against the tensegrity's ``blocks``, one element a block; on one rank.

    Raises:
        InputError: elements and blocks are on different grids.
    """
    assert blocks.midpoint is not None
    assert result.metric is not None
    measure, operator = blocks.stress_measure, result.problem.operator
    midpoint = operator.cell_corners.mean(axis=1)
    comparison = dd.compare_blocks(
        dd.BlockStress(midpoint, operator.cell_mean(result.mechanical.stress), measure),
        dd.BlockStress(midpoint, operator.cell_mean(result.material_stress), measure),
        dd.BlockStress(blocks.midpoint, blocks.stress, measure),
    )
    w, z = operator.weights, result.mechanical
    gap, size = w * result.local_distance**2, w * (result.metric.whiten(z.strain, z.stress) ** 2).sum(axis=1)
    inner = np.repeat(dd.interior_blocks(midpoint), operator.points_per_cell)
    return Errors(
        comparison,
        distance=float(np.sqrt(gap.sum() / size.sum())),
        distance_inner=float(np.sqrt(gap[inner].sum() / size[inner].sum())),
    )
