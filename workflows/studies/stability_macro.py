"""Random macroscopic solves of the stability benchmark: metrics, data and elements far from good ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES, join_paths, sample_paths
from tsg_micro.data.dataset import Dataset, take
from workflows.studies.latin import latin_hypercube
from workflows.studies.rebalance import brick_imbalance

__all__ = ["METHODS", "MacroCase", "draw_macro", "sampled"]

METHODS = {"points": "classical", "tangents": "second order"}
"""What a datum is, and the method in dd_macro.METHODS."""
_PATHS, _STEPS = 200, 10
_MOST_DATA, _MOST_NOISE, _LARGEST_STRAIN = _PATHS * _STEPS, 0.3, 0.05
_ELEMENTS = 4


@dataclass(frozen=True)
class MacroCase:
    """A body of 4 x 4 x 1 bricks between two clamps, and what is known of its material."""

    number: int
    scene: str
    """Of METHODS."""
    metric: float
    """The default metric is multiplied by it."""
    data: int
    noise: float
    """In every component of strain and stress, over the largest root mean square of one."""
    collinear: bool
    """All data are on one line in strain and stress."""
    aspect: float
    """Longest over shortest edge of an element."""
    thin: int
    """The axis along which it is shortest."""
    strain: float
    shear: bool

    def dataset(self) -> Dataset:
        """What the solve is given: some of 2000 data of the default sheet, with noise."""
        random = np.random.default_rng([self.number, self.data])
        everything = sampled()
        dataset = take(everything, random.permutation(len(everything))[: self.data])
        if self.collinear:
            part = random.uniform(-1.0, 1.0, self.data)[:, None]
            dataset = replace(dataset, strain=part * dataset.strain[0], stress=part * dataset.stress[0])
        noisy = {}
        for name in ("strain", "stress"):
            values = getattr(dataset, name)
            size = self.noise * np.sqrt((values**2).mean(axis=0).max())
            noisy[name] = values + size * random.standard_normal(values.shape)
        return replace(dataset, **noisy, deformation_gradient=None, energy=None)

    def solve(self) -> dict[str, Any]:
        """How it went, as part of a row of the table.

        Raises:
            InputError: the data give no metric.
            ConvergenceError: the solve did not converge.
        """
        edge = np.full(3, self.aspect)
        edge[self.thin] = 1.0
        counts = (_ELEMENTS, _ELEMENTS, 1)
        lengths = 20e-6 / np.sqrt(self.aspect) * edge * counts
        domain = dd.box(MPI.COMM_SELF, elements=counts, size=tuple(lengths))
        operator = dd.THEORIES["small"].operator(domain, enhanced=True)
        move = np.zeros(3)
        move[0 if self.shear else 1] = self.strain * lengths[1]
        problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", tuple(move))])
        method, dataset = dd.METHODS[METHODS[self.scene]], self.dataset()
        order = 2 if self.scene == "tangents" else 1
        metric = dd.choose_metric("auto", problem, dataset, order=order)
        metric = dd.Metric(self.metric * metric.C, metric.reason)
        solution = method.prepare(problem, dd.Material(dataset, metric)).solve()
        shape = (len(operator.cell_corners), operator.points_per_cell)
        residual = brick_imbalance(
            operator.cell_corners,
            operator.points.reshape(*shape, 3),
            operator.weights.reshape(shape),
            solution.mechanical.stress.reshape(*shape, 6),
        )
        rounding = 1e-9 * self.aspect
        return {
            "iterations": solution.iterations,
            "residual": residual,
            "rounding": rounding,
            "negative_pivots": None,
            "detail": solution.reason,
        }


@lru_cache(1)
def sampled() -> Dataset:
    """All six strains of the default sheet, with tangents."""
    box = BOXES["full"]
    paths = sample_paths(RVESpec(free=box.free).build(), box, paths=range(_PATHS), steps=_STEPS, seed=0)
    return join_paths(paths, seed=0)


def draw_macro(scene: str, count: int, seed: int) -> list[MacroCase]:
    """``count`` cases with this kind of data, a Latin hypercube.

    The metric is 0.01 to 100 times the default, data are 1 to 2000, elements 1:1 to 1:1000, even in their logarithm;
    noise is none in a quarter and up to 30 %, data are collinear in a quarter, strain is up to 5 %, half of it shear.
    """
    random = np.random.default_rng([seed, 100 + list(METHODS).index(scene)])
    unit = latin_hypercube(random, count, 8)
    return [
        MacroCase(
            number,
            scene,
            metric=float(10.0 ** (-2.0 + 4.0 * a)),
            data=max(1, round(_MOST_DATA**b)),
            noise=float(_MOST_NOISE * max(0.0, (c - 0.25) / 0.75)),
            collinear=bool(d < 0.25),
            aspect=float(10.0 ** (3.0 * e)),
            thin=int(3 * f),
            strain=float(_LARGEST_STRAIN * g),
            shear=bool(h < 0.5),
        )
        for number, (a, b, c, d, e, f, g, h) in enumerate(unit)
    ]
