"""Random micro states of the stability benchmark: tissues and loads far from the paper's, solved and rebalanced."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.bodies.sheet import ClampedSheet, Sheet
from tsg_micro.cells.lattice import side_nodes
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.structure import Structure
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_spec import SHEET, RVESpec
from tsg_micro.data.mandel import COMPONENTS
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver
from workflows.studies.latin import latin_hypercube
from workflows.studies.rebalance import imbalance, rounding

__all__ = ["SCENES", "MicroCase", "draw_micro"]

_LARGEST_LOAD = 0.25
_LOADED = {"in-plane RVE": (0, 1, 5), "six strains": tuple(range(6)), "bulk": tuple(range(6))}
_SHEETS = {"3x2 sheet": (3, 2), "8x4 sheet": (8, 4)}
SCENES = ("cell", *_LOADED, *_SHEETS)
"""One cell between plates; RVEs of a sheet under strains in its plane and under all six, of bulk; clamped sheets."""


@dataclass(frozen=True)
class MicroCase:
    """A tissue, and a load of ``scene`` from rest."""

    number: int
    scene: str
    bar_force: float
    """f_b, N."""
    half_diagonal: float
    E_ratio: float
    """Young's modulus of the bars over that of the tendons."""
    load: float
    """Largest component of the strain."""
    direction: tuple[float, ...]
    """Of the load, six Mandel strains or the motion (3,) of a moved side; its largest entry is 1."""

    @property
    def tissue(self) -> Tissue:
        """Its cells; raises InputError where the bars cannot carry the force."""
        tendon = CellParameters().E_tendon
        return Tissue(CellParameters(half_diagonal=self.half_diagonal, E_bar=self.E_ratio * tendon), self.bar_force)

    def solve(self) -> dict[str, Any]:
        """How it went, as part of a row of the table.

        Raises:
            InputError: there is no such tissue.
            ConvergenceError: the equilibrium was lost.
        """
        kept = _cell(self) if self.scene == "cell" else _sheet(self) if self.scene in _SHEETS else _rve(self)
        structure, state, held, free = kept
        residual = imbalance(structure, state.displacement, state.H, held=held, free=free)
        return {
            "iterations": state.iterations,
            "residual": residual,
            "rounding": rounding(structure, state.displacement),
            "negative_pivots": state.negative_pivots,
            "detail": "",
        }


_Kept = tuple[Structure, Equilibrium, NDArray[np.bool_], tuple[int, ...]]


def _cell(case: MicroCase) -> _Kept:
    """One cell on a base, its top face moved as the direction says along z, free along x and y."""
    structure = case.tissue.box((1, 1, 1))
    top, held = side_nodes(structure, 2, end="high"), np.zeros(structure.nodes.shape, dtype=bool)
    held[side_nodes(structure, 2, end="low")] = True
    held[top, 2] = True
    u = np.zeros(structure.nodes.shape)
    u[top, 2] = case.load * case.direction[2] * structure.size[2]
    return structure, EquilibriumSolver(structure, fixed=held).solve(displacement=u, stable=True), held, ()


def _rve(case: MicroCase) -> _Kept:
    """One periodic block under mean strains; in the plane of a sheet, those out of it are found."""
    free = SHEET if case.scene == "in-plane RVE" else ()
    rve = RVESpec.of_kind("bulk" if case.scene == "bulk" else "sheet", case.tissue, free=free).build()
    state = rve.solve_strain(case.load * np.array(case.direction)).equilibrium
    held = np.zeros(rve.structure.nodes.shape, dtype=bool)  # the node that is kept in place carries nothing
    return rve.structure, state, held, tuple(COMPONENTS.index(name) for name in free)


def _sheet(case: MicroCase) -> _Kept:
    """A sheet of one layer of blocks between two clamps, one of which is moved."""
    x, y, z = case.direction
    sheet = ClampedSheet(Sheet(_SHEETS[case.scene], tissue=case.tissue), (x, y, z))
    state, nodes = sheet.load(case.load).state, sheet.structure.nodes
    held = np.zeros(nodes.shape, dtype=bool)
    for end in ("low", "high"):
        held[side_nodes(sheet.structure, 1, end=end)] = True  # type: ignore[arg-type]
    return sheet.structure, state, held, ()


def draw_micro(scene: str, count: int, seed: int) -> list[MicroCase]:
    """``count`` cases of a scene, a Latin hypercube over all but the direction, which is random.

    f_b is 0.01 to 1000 nN and the ratio of moduli 1e-2 to 1e4, both even in their logarithm; r is 0.2 to 0.8, the load
    up to 25 %.
    """
    random = np.random.default_rng([seed, SCENES.index(scene)])
    unit = latin_hypercube(random, count, 4)
    return [
        MicroCase(
            number,
            scene,
            bar_force=float(10.0 ** (-11.0 + 5.0 * a)),
            half_diagonal=float(0.2 + 0.6 * b),
            E_ratio=float(10.0 ** (-2.0 + 6.0 * c)),
            load=float(_LARGEST_LOAD * d),
            direction=_direction(scene)(random),
        )
        for number, (a, b, c, d) in enumerate(unit)
    ]


def _direction(scene: str) -> Callable[[np.random.Generator], tuple[float, ...]]:
    """What draws a direction of the load."""
    if scene == "cell":
        return lambda random: (0.0, 0.0, float(random.choice([-1.0, 1.0])))
    loaded, size = (_LOADED[scene], 6) if scene in _LOADED else ((0, 1), 3)

    def draw(random: np.random.Generator) -> tuple[float, ...]:
        drawn = np.zeros(size)
        drawn[list(loaded)] = random.standard_normal(len(loaded))
        return tuple((drawn / np.abs(drawn).max()).tolist())

    return draw
