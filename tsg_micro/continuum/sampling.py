"""Random strain-controlled loading paths through an RVE: the material data.

A path is a straight line from the unstrained state to a random point on the boundary of a strain box. Its points
lie at the fractions s_k = ((k - u_k) / n)^(1/d), u_k uniform in [0, 1), d the number of sampled components, which
makes the data uniformly dense in the box instead of crowding around zero strain. Path p draws from its own random
stream, seeded by (seed, p): the data do not depend on how many processes share the work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.continuum.rve import RVE
from tsg_micro.continuum.warm_rve import WarmRVE
from tsg_micro.continuum.warm_states import WarmStates
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import COMPONENTS, to_mandel
from tsg_micro.data.silent import zero_components

__all__ = [
    "BOXES",
    "PathData",
    "StrainBox",
    "join_paths",
    "sample_paths",
    "state_dataset",
    "strain_path",
]

Array = NDArray[np.float64]
SHEET = ("zz", "yz", "xz")


@dataclass(frozen=True)
class StrainBox:
    """Ranges of tensor strain components; what is neither sampled nor free is held at zero.

    Example:
        >>> box = tsg.StrainBox("narrow", {"xx": (-0.01, 0.0), "yy": (0.0, 0.02)})
        >>> tsg.strain_path(box, steps=5, seed=0, path=0).shape
        (5, 6)
    """

    name: str
    ranges: dict[str, tuple[float, float]]
    """Component to (low, high), zero inside or on the boundary; shears are tensor components, half of gamma."""
    free: tuple[str, ...] = SHEET
    """Components without stress."""

    def __post_init__(self) -> None:
        for component, (low, high) in self.ranges.items():
            if component not in COMPONENTS or component in self.free:
                raise InputError(f"box {self.name}: expected a component that is not free, got {component!r}")
            if not (low <= 0.0 <= high and low < high and np.isfinite([low, high]).all()):
                raise InputError(f"box {self.name}, {component}: expected a range around zero, got [{low}, {high}]")


BOXES = {
    box.name: box
    for box in (
        StrainBox("stretch", {"xx": (-0.04, 0.0), "yy": (0.0, 0.08)}),  # paper, Section 4.2
        StrainBox("shear", {"yy": (-0.1, 0.1), "xy": (0.0, 0.04)}),  # paper, Section 4.2: gamma up to 0.08
        StrainBox("inplane", {"xx": (-0.06, 0.06), "yy": (-0.06, 0.08), "xy": (-0.04, 0.04)}),
        StrainBox(
            "full",
            {name: (-0.06, 0.06) if name[0] == name[1] else (-0.03, 0.03) for name in COMPONENTS},
            free=(),
        ),
    )
}
"""The named boxes: the paper's two, all in-plane strains, all six strains."""


def strain_path(box: StrainBox, *, steps: int, seed: int, path: int) -> Array:
    """Mandel strains (steps, 6) along loading path number ``path``; each of seed and path gives its own.

    Example:
        >>> strain = tsg.strain_path(tsg.BOXES["stretch"], steps=10, seed=0, path=3)
        >>> strain.shape, bool((strain[:, 1] >= 0.0).all())
        ((10, 6), True)
    """
    random = np.random.default_rng([seed, path])
    low, high = np.array(list(box.ranges.values())).T
    direction = random.uniform(low, high)
    bound = np.where(direction < 0.0, low, high)
    direction /= (direction / bound).max()
    fractions = ((np.arange(1, steps + 1) - random.uniform(size=steps)) / steps) ** (1.0 / len(low))
    strain = np.zeros((steps, 3, 3))
    for component, value in zip(box.ranges, direction, strict=True):
        a, b = ("xyz".index(axis) for axis in component)
        strain[:, a, b] = strain[:, b, a] = fractions * value
    return to_mandel(strain)


@dataclass(frozen=True)
class PathData:
    """The k states that one path reached, as plain arrays, and why it was cut if it was."""

    path: int
    F: Array
    """Deformation gradients (k, 3, 3)."""
    first_piola: Array
    """P (k, 3, 3), Pa."""
    energy: Array
    """Stored energy per reference volume (k,), J/m^3."""
    tangent: Array
    """d sym(P) / d strain (k, 6, 6), Pa."""
    negative_pivots: int
    """The most unstable directions that a recorded state has."""
    failure: str | None
    free: tuple[str, ...] = ()
    """Strain components without stress."""
    support: Array | None = None
    """What clamps carry beside the stress, Mandel (k, 6), Pa; None where no axis is held."""
    support_tangent: Array | None = None


def sample_paths(
    rve: RVE,
    box: StrainBox,
    *,
    paths: Iterable[int],
    steps: int,
    seed: int,
    progress: Callable[[], None] | None = None,
) -> list[PathData]:
    """Follow the paths of the given numbers, each of ``steps`` states, all at once.

    A path where the equilibrium is lost ends there, and says why (``PathData.failure``). ``progress`` is called for
    each when all are done.

    Example:
        >>> rve = tsg.build_rve(bar_force=1e-8)
        >>> paths = tsg.sample_paths(rve, tsg.BOXES["stretch"], paths=range(2), steps=4, seed=0)
        >>> data = tsg.join_paths(paths, seed=0)
        >>> len(paths), data.strain.shape, data.silent
        (2, (8, 6), ('yz', 'xz'))
    """
    numbers = list(paths)
    try:
        warm = WarmRVE(rve)
    except ConvergenceError as error:
        return [_path_data(path, rve, box, [], str(error)) for path in numbers]
    strain = np.array([strain_path(box, steps=steps, seed=seed, path=path) for path in numbers]).reshape(-1, steps, 6)
    on, states = np.arange(len(numbers)), warm.reference.take([0] * len(numbers))
    found: list[list[WarmStates]] = [[] for _ in numbers]
    failures: dict[int, str] = {}
    for step in range(steps):
        states, reached, lost = warm.solve_many(strain[on, step], states)
        failures |= {int(on[k]): text for k, text in lost.items()}
        on = on[reached]
        said = replace(states, unknowns=states.unknowns[:, :0], rate=states.rate[:, :0])  # most of a state
        for k, place in enumerate(on):
            found[place].append(said.take([k]))
    done = []
    for k, path in enumerate(numbers):
        done.append(_path_data(path, rve, box, found[k], failures.get(k)))
        if progress:
            progress()
    return done


def _path_data(path: int, rve: RVE, box: StrainBox, states: list[WarmStates], failure: str | None) -> PathData:
    """What the ``states`` of one path say; there may be none."""

    def all_of(name: str, *shape: int) -> Array:
        return np.array([getattr(state, name)[0] for state in states]).reshape(-1, *shape)

    clamps = {"support": all_of("support", 6), "support_tangent": all_of("support_tangent", 6, 6)}
    return PathData(
        path=path,
        F=all_of("F", 3, 3),
        first_piola=all_of("first_piola", 3, 3),
        energy=all_of("energy"),
        tangent=all_of("tangent", 6, 6),
        negative_pivots=max((int(state.negative_pivots[0]) for state in states), default=0),
        failure=failure,
        free=box.free,
        **(clamps if any(rve.held) else {}),
    )


def join_paths(
    paths: Iterable[PathData],
    *,
    seed: int,
    parameters: dict[str, Any] | None = None,
    versions: dict[str, str] | None = None,
) -> Dataset:
    """The data set of all states, in the order of the path numbers; its stress is the first Piola stress.

    Components that were free and yet did not move are declared silent: by the symmetry of the RVE nothing drives them.
    One that was held at zero is not, as the in-plane shear of the box "stretch". ``parameters`` and ``versions`` stay.

    Raises:
        InputError: no state was reached at all.
    """
    ordered = sorted(paths, key=lambda data: data.path)
    counts = [len(data.F) for data in ordered]
    if not sum(counts):
        reasons = "; ".join(sorted({data.failure for data in ordered if data.failure}))
        raise InputError(f"paths: expected at least one state in equilibrium, got none ({reasons})")
    clamps = {
        name: np.concatenate([getattr(data, name) for data in ordered])
        for name in ("support", "support_tangent")
        if getattr(ordered[0], name) is not None
    }
    found = state_dataset(
        F=np.concatenate([data.F for data in ordered]),
        first_piola=np.concatenate([data.first_piola for data in ordered]),
        tangent=np.concatenate([data.tangent for data in ordered]),
        energy=np.concatenate([data.energy for data in ordered]),
        path=np.repeat([data.path for data in ordered], counts),
        step=np.concatenate([np.arange(count) for count in counts]),
        parameters=parameters or {},
        versions=versions or {},
        seed=seed,
        **clamps,
    )
    free = set.intersection(*(set(data.free) for data in ordered))
    return replace(found, silent=tuple(name for name in zero_components(found.strain, found.stress) if name in free))


def state_dataset(*, F: Array, first_piola: Array, tangent: Array, energy: Array, **more: Any) -> Dataset:
    """The data set of N RVE states: F (N, 3, 3), first Piola stress (N, 3, 3) in Pa, tangent (N, 6, 6) in Pa.

    ``energy`` (N,) is in J/m^3; ``more`` are path, step and other fields of the data set.
    """
    return Dataset(
        strain=to_mandel(F - np.eye(3)),
        stress=to_mandel(first_piola),
        stress_measure="first_piola",
        tangent=tangent,
        deformation_gradient=F,
        energy=energy,
        **more,
    )
