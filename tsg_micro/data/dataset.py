"""The material data set: pairs of strain and stress with all that is needed to trust and reuse them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.display import Displayed, ranges
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import COMPONENTS
from tsg_micro.data.silent import check_silent
from tsg_micro.data.stress import check_measure, convert_stress, convert_tangent, measure_words

__all__ = ["REQUIRED", "UNITS", "Dataset", "convert_dataset", "join_datasets", "take"]

Array = NDArray[np.float64]
UNITS = {
    "strain": "1",
    "stress": "Pa",
    "path": "1",
    "step": "1",
    "tangent": "Pa",
    "deformation_gradient": "1",
    "energy": "J/m^3",
    "midpoint": "m",
    "support": "Pa",
    "support_tangent": "Pa",
    "bar_force": "N",
    "bar_force_rate": "Pa/N",
    "source": "1",
}
_SHAPES: dict[str, tuple[int, ...]] = {
    "strain": (6,),
    "stress": (6,),
    "path": (),
    "step": (),
    "tangent": (6, 6),
    "deformation_gradient": (3, 3),
    "energy": (),
    "midpoint": (3,),
    "support": (6,),
    "support_tangent": (6, 6),
    "bar_force": (),
    "bar_force_rate": (6,),
    "source": (),
}
REQUIRED = ("strain", "stress", "path", "step")
_LARGEST = 1e60  # products of a few of them are still numbers


@dataclass(frozen=True, repr=False)
class Dataset(Displayed):
    """Material data: Mandel strain (N,6) and stress (N,6) in Pa, and where they come from.

    The strain is the symmetric displacement gradient (small strain); ``stress_measure`` names the stress. N points::

        strain (N,6) 1, stress (N,6) Pa              Mandel order xx, yy, zz, yz, xz, xy (tsg_micro.data.mandel)
        path (N) 1, step (N) 1                       which loading path, and which step along it
        tangent (N,6,6) Pa                 optional  d stress / d strain, all six strains prescribed
        deformation_gradient (N,3,3) 1     optional  F, needed to change the stress measure
        energy (N) J/m^3                   optional  stored energy per reference volume
        midpoint (N,3) m                   optional  where each point was read off, for block means of a structure
        support (N,6) Pa                   optional  what clamps carry beside the stress (tsg_micro.continuum.rve)
        support_tangent (N,6,6) Pa         optional  d support / d strain
        bar_force (N) N                    optional  f_b of each point, in a tissue whose bar force varies
        bar_force_rate (N,6) Pa/N          optional  d stress / d f_b at fixed strain
        source (N) 1                       optional  which of the joined runs a point is from

    A component in ``silent``, among xx, yy, zz, yz, xz, xy, has zero strain and zero stress at all points because
    nothing drove it, as the out-of-plane shear of a free sheet. The points say nothing of what it would do to the
    stress, so it does not count in a metric (dd_macro.Metric); tangents may say it. Round-off in it is set to zero. The
    zz of a free sheet is not silent: its strain tells how the sheet thins.

    Raises:
        InputError: on construction, where a shape, a value (NaN, infinity) or the measure is not valid, or a component
            declared silent is unknown or not zero.

    Example:
        >>> strain = np.array([[0.0, 0.01, 0, 0, 0, 0], [0.0, 0.02, 0, 0, 0, 0]])
        >>> number = np.arange(2)
        >>> data = tsg.Dataset(strain, 1e3 * strain, "first_piola", path=0 * number, step=number)
        >>> len(data), data.stress[:, 1]
        (2, array([10., 20.]))
    """

    strain: Array
    stress: Array
    stress_measure: str
    path: NDArray[np.int64]
    step: NDArray[np.int64]
    tangent: Array | None = None
    deformation_gradient: Array | None = None
    energy: Array | None = None
    midpoint: Array | None = None
    support: Array | None = None
    support_tangent: Array | None = None
    bar_force: Array | None = None
    bar_force_rate: Array | None = None
    source: NDArray[np.int64] | None = None
    silent: tuple[str, ...] = ()
    parameters: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    seed: int | None = None

    def __post_init__(self) -> None:
        check_measure(self.stress_measure)
        n = len(self.strain)
        if n == 0:
            raise InputError("data set: expected at least one point, got none")
        for name, array in self.arrays().items():
            expected = (n, *_SHAPES[name])
            if array.shape != expected:
                raise InputError(f"data set, {name}: expected shape {expected}, got {array.shape}")
            if np.iscomplexobj(array):
                raise InputError(f"data set, {name}: expected real numbers, got complex ones")
            bad = np.flatnonzero(~np.isfinite(array).reshape(n, -1).all(axis=1))
            if bad.size:
                raise InputError(
                    f"data set, {name}: expected finite numbers, got NaN or infinity at {bad.size} points "
                    f"(first at index {bad[0]})"
                )
            if np.abs(array).max() > _LARGEST:
                largest = np.abs(array).reshape(n, -1).max(axis=1)
                raise InputError(
                    f"data set, {name}: expected numbers below {_LARGEST:.0e}, got {largest.max():.3g} at index "
                    f"{largest.argmax()}"
                )
        if self.deformation_gradient is not None and not (np.linalg.det(self.deformation_gradient) > 0.0).all():
            raise InputError("data set, deformation_gradient: expected det F > 0 at every point")
        for name in ("parameters", "versions"):
            if not isinstance(getattr(self, name), dict):
                raise InputError(f"data set, {name}: expected names and values, got {getattr(self, name)!r}")
        self._check_silent()

    def _check_silent(self) -> None:
        """Raise InputError where what is declared silent is not, and set round-off to zero."""
        check_silent(self.strain, self.stress, self.silent)
        if self.silent:
            for name in ("strain", "stress"):
                array = np.array(getattr(self, name))
                array[:, ~self.counted] = 0.0
                object.__setattr__(self, name, array)
            object.__setattr__(self, "silent", tuple(name for name in COMPONENTS if name in self.silent))

    def __len__(self) -> int:
        return len(self.strain)

    def _display(self) -> tuple[str, dict[str, object]]:
        measure, paths = measure_words(self.stress_measure), len(np.unique(self.path))
        more = [name for name in self.arrays() if name not in (*REQUIRED, "source")]
        made = [f"{name} {value}" for name, value in self.sources[0].items() if isinstance(value, str | int | float)]
        return f"Dataset: {len(self)} points on {paths} paths, {measure} stress", {
            "strain / %": ranges(100.0 * self.strain),
            "stress / Pa": ranges(self.stress),
            "also": ", ".join(more),
            "silent": " ".join(self.silent),
            "from": ", ".join(made) + (f", and {len(self.sources) - 1} more runs" if len(self.sources) > 1 else ""),
        }

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Mask (6,) of the components that are not silent."""
        return np.array([name not in self.silent for name in COMPONENTS])

    @property
    def sources(self) -> list[dict[str, Any]]:
        """The parameters of the runs that the data are from."""
        return list(self.parameters.get("joined", [self.parameters]))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays that are there, by name."""
        return {name: getattr(self, name) for name in UNITS if getattr(self, name) is not None}


def take(dataset: Dataset, index: NDArray[Any]) -> Dataset:
    """The points ``index``, integers (k,) or a mask (N,), of ``dataset``, in that order.

    Raises:
        InputError: there are none.
    """
    return dataclasses.replace(dataset, **{name: array[index] for name, array in dataset.arrays().items()})


def join_datasets(first: Dataset, second: Dataset) -> Dataset:
    """Both sets as one; arrays that only one of them has are dropped, paths of the second are renumbered.

    What is silent in both stays silent. Where no clamp was, none carried anything. ``source`` tells the runs apart.

    Raises:
        InputError: they hold different stress measures.
    """
    if first.stress_measure != second.stress_measure:
        raise InputError(
            f"data sets to join: expected one stress measure, got {first.stress_measure} and {second.stress_measure}"
        )
    a, b = _with_source(first), _with_source(second)
    if "source" in b:
        b["source"] = b["source"] + len(first.sources)
    for name in ("support", "support_tangent"):
        if (name in a) != (name in b):
            there, other, n = (a, b, len(second)) if name in a else (b, a, len(first))
            other[name] = np.zeros((n, *there[name].shape[1:]))
    b["path"] = b["path"] + (a["path"].max() + 1)
    joined: dict[str, Any] = {
        name: np.concatenate([a[name], b[name]]) if name in a and name in b else None for name in UNITS
    }
    seed = first.seed if first.seed == second.seed else None
    silent = tuple(name for name in first.silent if name in second.silent)
    sources = {"joined": [*first.sources, *second.sources]}
    return dataclasses.replace(first, **joined, silent=silent, parameters=sources, seed=seed)


def _with_source(dataset: Dataset) -> dict[str, NDArray[Any]]:
    """The arrays, with the number of each point's run where it is known."""
    arrays = dataset.arrays()
    if "source" not in arrays and len(dataset.sources) == 1:
        arrays["source"] = np.zeros(len(dataset), dtype=np.int64)
    return arrays


def convert_dataset(dataset: Dataset, measure: str) -> Dataset:
    """The same data with the stress (and tangent) as ``measure``, from the F of every point.

    Raises:
        InputError: the measure is unknown, or the data hold another one and no deformation gradient.
    """
    check_measure(measure)
    if measure == dataset.stress_measure:
        return dataset
    F = dataset.deformation_gradient
    if F is None:
        raise InputError(
            f"stress measure: the data hold {dataset.stress_measure} and no deformation gradient, "
            f"so {measure} cannot be computed"
        )
    source = dataset.stress_measure
    tangent = dataset.tangent
    if tangent is not None:
        tangent = convert_tangent(tangent, dataset.stress, F, source, measure)
    found: dict[str, Any] = {"stress": convert_stress(dataset.stress, F, source, measure), "tangent": tangent}
    found["support_tangent"] = None
    for name in ("support", "bar_force_rate"):
        if getattr(dataset, name) is not None:
            found[name] = convert_stress(getattr(dataset, name), F, source, measure)
    return dataclasses.replace(dataset, **found, stress_measure=measure)
