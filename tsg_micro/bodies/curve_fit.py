"""Parameters of the cell from a measured curve, and how well each is determined.

Least squares on the differences between measured and computed answer (displacement of the cell, nominal stress of the
monolayer) at the measured loads, all of one weight, in the logarithms of the parameters and within their bounds. The
95 % intervals are those of the linearised problem: with J the derivatives of the residuals by the log parameters at the
best fit and s^2 the residual variance, the covariance is s^2 (J^T J)^-1.
"""

from __future__ import annotations

import itertools
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
    """What can be fitted: its unit, its bounds, and the factors at which a search begins."""

    unit: str
    low: float
    high: float
    tries: tuple[float, ...] = (1.0,)


PARAMETERS = {
    "bar_force": Parameter("N", 1e-11, 5e-7, (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)),
    "E_tendon": Parameter("Pa", 1e5, 1e9, (0.1, 1.0, 10.0)),
    "E_bar": Parameter("Pa", 1e8, 1e11),
    "half_diagonal": Parameter("1", 0.2, 0.8),
}
SCENES = {"cell": "m", "monolayer": "Pa"}
"""What is loaded, to the unit of its answer: the sinking of a cell under a force, the stress of a sheet at a strain."""
_FAILED = 10.0
"""Residual where the equilibrium is lost, in largest measured answers: no step ends there."""


@dataclass(frozen=True)
class Model:
    """A scene and all its parameters; those that are not fitted keep their values."""

    scene: str = "cell"
    tissue: Tissue = field(default_factory=Tissue)
    blocks: tuple[int, int] = (4, 2)
    """Of the monolayer's sheet; 4 x 2 is about 15 % too stiff at 25 % stretch, and quick."""
    top: str = "free"
    """Of the cell, see tsg_micro.bodies.cell."""

    def __post_init__(self) -> None:
        if self.scene not in SCENES:
            raise InputError(f"scene: expected {' or '.join(SCENES)}, got {self.scene!r}")
        check_top(self.top)
        Sheet(self.blocks, 1, self.tissue)

    def value(self, name: str) -> float:
        """One parameter's present value."""
        return self.tissue.bar_force if name == "bar_force" else float(getattr(self.tissue.cell, name))

    def having(self, names: Sequence[str], values: Array) -> Model:
        """The same with other values of some parameters."""
        new = {name: float(value) for name, value in zip(names, values, strict=True)}
        bar_force = new.pop("bar_force", self.tissue.bar_force)
        return replace(self, tissue=replace(self.tissue, bar_force=bar_force, cell=replace(self.tissue.cell, **new)))

    def answer(self, load: Array) -> Array:
        """Displacement (n,) in m at forces, or nominal stress in Pa at strains, in any order.

        Raises:
            ConvergenceError: the equilibrium was lost.
        """
        rising, place = np.unique(load, return_inverse=True)
        if self.scene == "cell":
            return indent_cell(self.tissue, rising, top=self.top).displacement[1:][place]
        return np.array(stretch_sheet(Sheet(self.blocks, 1, self.tissue), rising).column("nominal_stress"))[1:][place]


@dataclass(frozen=True)
class Fit:
    """The best parameters and what is known of their errors."""

    names: tuple[str, ...]
    model: Model
    values: Array
    interval: Array
    """95 % intervals (p, 2), cut at the bounds."""
    correlation: Array
    """Of the log parameters (p, p)."""
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
    scale = float(np.abs(answer).max())
    low, high = (np.log([getattr(PARAMETERS[name], end) for name in names]) for end in ("low", "high"))
    evaluations = 0

    def residuals(x: Array) -> Array:
        nonlocal evaluations
        evaluations += 1
        try:
            return (model.having(names, np.exp(x)).answer(load) - answer) / scale
        except ConvergenceError:
            return np.full(len(answer), _FAILED)

    start = np.log([model.value(name) for name in names])
    grid = [
        np.clip(start + np.log(factors), low + 1e-6, high - 1e-6)
        for factors in itertools.product(*(PARAMETERS[name].tries for name in names))
    ]
    costs = [float(np.sum(residuals(x) ** 2)) for x in grid]
    if min(costs) >= _FAILED**2 * len(answer):
        raise ConvergenceError("calibrate: the equilibrium was lost wherever the search could begin")
    begin = grid[int(np.argmin(costs))]
    best = least_squares(residuals, begin, bounds=(low, high), diff_step=1e-4, max_nfev=40)
    free = len(answer) - len(names)
    covariance = _covariance(best.jac, 2.0 * best.cost / free)
    half = _student(free) * np.sqrt(np.diag(covariance))
    interval = np.exp(np.clip(np.column_stack([best.x - half, best.x + half]), low[:, None], high[:, None]))
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviation, deviation) if (deviation > 0).all() else np.eye(len(names))
    warnings = _warnings(names, np.exp(best.x), interval, correlation)
    if not best.success:
        warnings.append(f"the search stopped early: {best.message}")
    return Fit(
        names=names,
        model=model.having(names, np.exp(best.x)),
        values=np.exp(best.x),
        interval=interval,
        correlation=correlation,
        rms=float(scale * np.sqrt(2.0 * best.cost / len(answer))),
        evaluations=evaluations,
        warnings=tuple(warnings),
    )


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
    found = []
    for name, value, (low, high) in zip(names, values, interval, strict=True):
        bounds = PARAMETERS[name]
        if not bounds.low * 1.001 < value < bounds.high / 1.001:
            found.append(f"{name} ended at its bound, {value:.3g}: the data do not determine it")
        elif high > 10.0 * low:
            found.append(f"{name} is badly determined: its interval spans a factor of {high / low:.3g}")
    for i, j in itertools.combinations(range(len(names)), 2):
        if abs(correlation[i, j]) > 0.95:
            found.append(
                f"{names[i]} and {names[j]} are badly told apart by these data: their correlation is "
                f"{correlation[i, j]:.3f}"
            )
    return found
