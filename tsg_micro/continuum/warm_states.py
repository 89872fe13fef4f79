"""States of one RVE from which it goes on: each keeps its unknowns and how they follow the strain."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tsg_micro.continuum.rve import RVE, RVEState
from tsg_micro.data.mandel import to_mandel

__all__ = ["Effort", "WarmStates"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass
class Effort:
    """What an RVE has done so far."""

    calls: int = 0
    points: int = 0
    """States that were asked for."""
    solves: int = 0
    """RVEs that were solved; the others followed a tangent."""
    iterations: int = 0
    """Newton iterations of the RVEs."""
    factorisations: int = 0
    seconds: float = 0.0

    def add(self, solves: int, iterations: int, factorisations: int) -> None:
        """More that was done."""
        self.solves += solves
        self.iterations += iterations
        self.factorisations += factorisations

    def numbers(self) -> Array:
        """All of it as an array, which can be summed over ranks."""
        return np.array([getattr(self, field.name) for field in fields(self)], dtype=float)

    @contextmanager
    def of(self, points: int) -> Iterator[None]:
        """A call for so many points; BLAS has one thread, since the blocks are small."""
        begin = time.perf_counter()
        try:
            with threadpool_limits(1):
                yield
        finally:
            self.calls += 1
            self.points += points
            self.seconds += time.perf_counter() - begin


@dataclass(frozen=True)
class WarmStates:
    """States of n points, about 11 kB each for one block; every array has a leading axis n."""

    strain: Array
    """Small strain, Mandel (n, 6)."""
    stress: Array
    """Symmetric first Piola stress, Mandel (n, 6), Pa."""
    tangent: Array
    F: Array
    first_piola: Array
    energy: Array
    unknowns: Array
    rate: NDArray[np.float32]
    """d y / d strain; single precision: it only makes a first guess."""
    negative_pivots: Index
    support: Array
    """What clamps carry beside the stress, Mandel (n, 6), Pa; zero where no axis is held."""
    support_tangent: Array

    @classmethod
    def of(cls, state: RVEState, rve: RVE) -> WarmStates:
        """The state in which ``rve`` is now, of one point."""
        assert state.tangent is not None
        assert state.rate is not None
        return cls(
            strain=state.strain[None],
            stress=to_mandel(state.first_piola)[None],
            tangent=state.tangent[None],
            F=state.F[None],
            first_piola=state.first_piola[None],
            energy=np.array([state.energy]),
            unknowns=rve.solver.y[None].copy(),
            rate=state.rate[None].astype(np.float32),
            negative_pivots=np.array([state.equilibrium.negative_pivots or 0]),
            support=np.zeros((1, 6)) if state.support_stress is None else to_mandel(state.support_stress)[None],
            support_tangent=np.zeros((1, 6, 6)) if state.support_tangent is None else state.support_tangent[None],
        )

    def __len__(self) -> int:
        return len(self.strain)

    def take(self, index: Index | list[int]) -> WarmStates:
        """The states of these numbers."""
        return WarmStates(*(getattr(self, field.name)[index] for field in fields(self)))

    def put(self, index: Index, other: WarmStates) -> None:
        """The states ``other`` in these places."""
        for field in fields(self):
            getattr(self, field.name)[index] = getattr(other, field.name)

    @classmethod
    def join(cls, parts: list[WarmStates]) -> WarmStates:
        """All states of ``parts``, of which there is one at least."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))
