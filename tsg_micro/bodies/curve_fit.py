"""Parameters of the cell from a measured curve, and how well each is determined.

Least squares on the differences between measured and computed answer (displacement of the cell, nominal stress of the
monolayer) at the measured loads, all of one weight, in the logarithms of the parameters (in the contact point itself)
and within their bounds. The 95 % intervals are those of the linearised problem: with J the derivatives of the residuals
at the best fit and s^2 the residual variance, the covariance is s^2 (J^T J)^-1. That holds for residuals that are
noise: where the model does not describe the curve there is no interval, and systematic residuals are a warning.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tsg_micro.bodies.cell import check_top, indent_cell
from tsg_micro.bodies.sheet import Sheet, stretch_sheet
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.errors import ConvergenceError, InputError

__all__ = ["PARAMETERS", "SCENES", "Fit", "Model", "fit_curve"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """What can be fitted: unit, bounds, and the factors at which a search begins; positive, if it is not ``signed``."""

    unit: str
    low: float
    high: float
    tries: tuple[float, ...] = (1.0,)
    signed: bool = False

    def inner(self, value: float) -> float:
        """What the search varies: the logarithm, or a signed value over its bound."""
        return value / self.high if self.signed else math.log(value)

    def outer(self, x: float) -> float:
        """The value of what the search varies."""
        return x * self.high if self.signed else math.exp(x)


PARAMETERS = {
    "bar_force": Parameter("N", 1e-11, 5e-7, (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)),
    "E_tendon": Parameter("Pa", 1e5, 1e9, (0.1, 1.0, 10.0)),
    "E_bar": Parameter("Pa", 1e8, 1e11),
    "half_diagonal": Parameter("1", 0.2, 0.8),
    "contact_point": Parameter("m", -5e-6, 5e-6, signed=True),
}
SCENES = {"cell": "m", "monolayer": "Pa"}
"""What is loaded, to the unit of its answer: the sinking of a cell under a force, the stress of a sheet at a strain."""
_FAILED = 10.0
"""Residual where the equilibrium is lost, in largest measured answers or largest residuals: no step ends there."""
_MISFIT, _NOISE = 0.05, 0.3
"""Of the largest measured answer: more than this is no description, if the residuals are systematic or if not."""
_FEW, _EXACT = 8, 1e-4
"""Points from which on residuals can be told to be systematic, and misfit below which that does not matter."""


@dataclass(frozen=True)
class Model:
    """A scene and all its parameters; those that are not fitted keep their values."""

    scene: str = "cell"
    tissue: Tissue = field(default_factory=Tissue)
    blocks: tuple[int, int] = (4, 2)
    """Of the monolayer's sheet; 4 x 2 is about 15 % too stiff at 25 % stretch, and quick."""
    top: str = "free"
    """Of the cell, see tsg_micro.bodies.cell."""
    contact_point: float = 0.0
    """Displacement at which the cell is touched first, m; a measured curve counts from elsewhere."""

    def __post_init__(self) -> None:
        if self.scene not in SCENES:
            raise InputError(f"scene: expected {' or '.join(SCENES)}, got {self.scene!r}")
        check_top(self.top)
        Sheet(self.blocks, 1, self.tissue)

    def value(self, name: str) -> float:
        """One parameter's present value."""
        if name == "contact_point":
            return self.contact_point
        return self.tissue.bar_force if name == "bar_force" else float(getattr(self.tissue.cell, name))

    def having(self, names: Sequence[str], values: Array) -> Model:
        """The same with other values of some parameters."""
        new = {name: float(value) for name, value in zip(names, values, strict=True)}
        bar_force = new.pop("bar_force", self.tissue.bar_force)
        contact = new.pop("contact_point", self.contact_point)
        tissue = replace(self.tissue, bar_force=bar_force, cell=replace(self.tissue.cell, **new))
        return replace(self, tissue=tissue, contact_point=contact)

    def answer(self, load: Array) -> Array:
        """Displacement (n,) in m at forces, or nominal stress in Pa at strains, in any order.

        Raises:
            ConvergenceError: the equilibrium was lost.
        """
        rising, place = np.unique(load, return_inverse=True)
        if self.scene == "cell":
            return self.contact_point + indent_cell(self.tissue, rising, top=self.top).displacement[1:][place]
        return np.array(stretch_sheet(Sheet(self.blocks, 1, self.tissue), rising).column("nominal_stress"))[1:][place]


@dataclass(frozen=True)
class Fit:
    """The best parameters and what is known of their errors."""

    names: tuple[str, ...]
    model: Model
    values: Array
    interval: Array | None
    """95 % intervals (p, 2), cut at the bounds; None where the model does not describe the curve."""
    correlation: Array
    """Of what the search varies (p, p)."""
    rms: float
    """Root mean square of the differences, in the unit of the answer."""
    evaluations: int
    warnings: tuple[str, ...]


def fit_curve(model: Model, names: tuple[str, ...], load: Array, answer: Array) -> Fit:
    """Least squares for the parameters ``names`` of ``model`` on measured ``answer`` (n,) at ``load`` (n,).

    The search begins at the best of a coarse grid around the model's values, since the curve of a cell is nearly the
    same for all small bar forces.

    Raises:
        InputError: not more distinct loads than parameters.
        ConvergenceError: no equilibrium at any point of the grid.
    """
    from scipy.optimize import least_squares

    distinct = len(np.unique(load[load > 0.0]))
    if distinct <= len(names):
        raise InputError(
            f"data: expected more than {len(names)} distinct loads for {len(names)} parameters, got {distinct}"
        )
    if "contact_point" in names and model.scene != "cell":
        raise InputError(f"fit: expected no contact point in the scene {model.scene}, got one")
    search = _Search(model, names, load, answer)
    grid = search.grid()
    residuals = [search.differences(x) for x in grid]
    found = [(float(np.sum(r**2)), i, r) for i, r in enumerate(residuals) if r is not None]
    if not found:
        raise ConvergenceError("calibrate: the equilibrium was lost wherever the search could begin")
    _, first, near = min(found, key=lambda one: one[:2])
    search.lost = max(search.lost, _FAILED * float(np.abs(near).max()))
    best = least_squares(search, grid[first], bounds=search.bounds, diff_step=1e-4, max_nfev=40)
    free = len(answer) - len(names)
    covariance = _covariance(best.jac, 2.0 * best.cost / free)
    half = _student(free) * np.sqrt(np.diag(covariance))
    low, high = search.bounds
    ends = np.clip(np.column_stack([best.x - half, best.x + half]), low[:, None], high[:, None])
    interval = np.column_stack([search.values(end) for end in ends.T])
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviation, deviation) if (deviation > 0).all() else np.eye(len(names))
    values, misfit = search.values(best.x), float(np.sqrt(2.0 * best.cost / len(answer)))
    systematic = _systematic(load, best.fun)
    described = misfit < (_MISFIT if systematic is not None else _NOISE)
    warnings = _warnings(names, values, interval, correlation) if described else _at_bounds(names, values, misfit)
    warnings += _of_residuals(names, model.scene, misfit, systematic, described)
    if not best.success:
        warnings.append(f"the search stopped early: {best.message}")
    return Fit(
        names=names,
        model=model.having(names, values),
        values=values,
        interval=interval if described else None,
        correlation=correlation,
        rms=search.scale * misfit,
        evaluations=search.evaluations,
        warnings=tuple(warnings),
    )


class _Search:
    """Differences to the data, over the largest measured answer, as functions of what is varied."""

    def __init__(self, model: Model, names: tuple[str, ...], load: Array, answer: Array) -> None:
        self.model, self.names, self.load, self.answer = model, names, load, answer
        self.scale = float(np.abs(answer).max())
        self.lost, self.evaluations = _FAILED, 0
        parameters = [PARAMETERS[name] for name in names]
        ends = ([one.inner(one.low) for one in parameters], [one.inner(one.high) for one in parameters])
        self.bounds = (np.array(ends[0]), np.array(ends[1]))

    def grid(self) -> list[Array]:
        """Where the search may begin, inside the bounds."""
        low, high = self.bounds
        start = np.array([PARAMETERS[name].inner(self.model.value(name)) for name in self.names])
        steps = [[0.0] if PARAMETERS[name].signed else np.log(PARAMETERS[name].tries) for name in self.names]
        return [np.clip(start + np.array(step), low + 1e-6, high - 1e-6) for step in itertools.product(*steps)]

    def values(self, x: Array) -> Array:
        """Parameters at x."""
        return np.array([PARAMETERS[name].outer(float(one)) for name, one in zip(self.names, x, strict=True)])

    def differences(self, x: Array) -> Array | None:
        """Differences (n,) at x; None where the equilibrium is lost."""
        self.evaluations += 1
        try:
            return (self.model.having(self.names, self.values(x)).answer(self.load) - self.answer) / self.scale
        except ConvergenceError:
            return None

    def __call__(self, x: Array) -> Array:
        found = self.differences(x)
        return np.full(len(self.answer), self.lost) if found is None else found


def _systematic(load: Array, residual: Array) -> float | None:
    """Correlation of neighbouring residuals in the order of the loads, where it is beyond chance; else None."""
    ordered = residual[np.argsort(load, kind="stable")]
    n, size = len(ordered), float(np.sum(residual**2))
    if n < _FEW or size < n * _EXACT**2:
        return None
    correlation = float(np.sum(ordered[1:] * ordered[:-1]) / size)
    return correlation if correlation > 3.0 / np.sqrt(n) else None


def _of_residuals(
    names: tuple[str, ...], scene: str, misfit: float, systematic: float | None, described: bool
) -> list[str]:
    """Warnings of residuals that are no noise."""
    hint = (
        "; is the contact point off? (--fit contact-point)" if scene == "cell" and "contact_point" not in names else ""
    )
    if not described:
        return [
            f"the model does not describe the curve: misfit {misfit:.0%} of the largest answer, so no interval{hint}"
        ]
    if systematic is None:
        return []
    return [
        f"the residuals are systematic (neighbours correlate by {systematic:.2f}, misfit {misfit:.1%} of the largest "
        f"answer): the intervals are too small{hint}"
    ]


def _covariance(jacobian: Array, variance: float) -> Array:
    """s^2 (J^T J)^-1; directions that J does not see at all get a variance that no bound lets through."""
    _, s, vt = np.linalg.svd(jacobian, full_matrices=False)
    inverse = 1.0 / np.maximum(s, 1e-8 * max(s.max(), 1e-30)) ** 2
    return np.asarray((vt.T * inverse) @ vt * variance)


def _student(free: int) -> float:
    """97.5 % point of Student's t; scipy.special is there already, scipy.stats would be slow to import."""
    from scipy.special import stdtrit

    return float(stdtrit(free, 0.975))


def _warnings(names: tuple[str, ...], values: Array, interval: Array, correlation: Array) -> list[str]:
    """What a reader must know before using the values."""
    found = _at_bounds(names, values)
    for name, (low, high) in zip(names, interval, strict=True):
        if not PARAMETERS[name].signed and not any(text.startswith(f"{name} ") for text in found) and high > 10.0 * low:
            found.append(f"{name} is badly determined: its interval spans a factor of {high / low:.3g}")
    for i, j in itertools.combinations(range(len(names)), 2):
        if abs(correlation[i, j]) > 0.95:
            found.append(
                f"{names[i]} and {names[j]} are badly told apart by these data: their correlation is "
                f"{correlation[i, j]:.3f}"
            )
    return found


def _at_bounds(names: tuple[str, ...], values: Array, misfit: float | None = None) -> list[str]:
    """Parameters that the bounds have stopped; with the ``misfit`` that this leaves, where it is large."""
    found = []
    for name, value in zip(names, values, strict=True):
        one = PARAMETERS[name]
        if not one.inner(one.low) + 1e-3 < one.inner(float(value)) < one.inner(one.high) - 1e-3:
            left = "the data do not determine it" if misfit is None else f"a misfit of {misfit:.0%} is left"
            found.append(f"{name} ended at its bound, {value:.3g}: {left}")
    return found
