"""The data of an adaptive run: RVEs at the strains that the scene wants, each from the nearest state that is known."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tsg_micro.cells.parameters import CellParameters
from tsg_micro.continuum.rve import RVE
from tsg_micro.continuum.sampling import state_dataset
from tsg_micro.data.dataset import Dataset, convert_dataset, join_datasets
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import to_mandel
from workflows.store.record import versions

__all__ = ["AdaptedData", "KnownState", "KnownStates"]

Array = NDArray[np.float64]
_SHORTER = 3


@dataclass(frozen=True)
class KnownState:
    """An RVE state, stress first Piola; ``unknowns`` (m,) and their ``rate`` (m, 6) lead to the next ones."""

    F: Array
    first_piola: Array
    energy: float
    tangent: Array
    unknowns: Array
    rate: NDArray[np.float32]
    """Single precision: it only makes a first guess."""

    @property
    def strain(self) -> Array:
        """Small strain, Mandel (6,)."""
        return to_mandel(self.F - np.eye(3))


class KnownStates:
    """The states of one RVE so far, the same on every rank: at first that of the reference."""

    def __init__(self, rve: RVE) -> None:
        """``rve`` has no free components; it is moved about.

        Raises:
            ConvergenceError: it has no equilibrium in its reference state.
        """
        self.rve = rve
        rve.reset()
        self.states = [self._solve(np.zeros(6), None)]
        self._strains = np.zeros((1, 6))

    def solve(self, comm: MPI.Comm, strains: Array, origins: Array) -> list[KnownState | None]:
        """States at ``strains`` (k, 6), shared among the ranks; each starts from the nearest one of earlier calls.

        Where the equilibrium is lost on the way, the reference state is tried, and then the strain halved towards that
        of ``origins`` (k, 6), a few times; None where that does not help. So the ranks do not decide what is found.
        """
        strains, origins = np.reshape(strains, (-1, 6)), np.reshape(origins, (-1, 6))
        mine = {}
        with threadpool_limits(1):
            for k in range(comm.rank, len(strains), comm.size):
                parts = (origins[k] + part * (strains[k] - origins[k]) for part in 0.5 ** np.arange(_SHORTER))
                mine[k] = next((state for strain in parts if (state := self._reach(strain))), None)
        found = {k: state for part in comm.allgather(mine) for k, state in part.items()}
        states = [found[k] for k in range(len(strains))]
        self.states += [state for state in states if state is not None]
        self._strains = np.array([state.strain for state in self.states])
        return states

    def _reach(self, strain: Array) -> KnownState | None:
        nearest = int(np.linalg.norm(strain - self._strains, axis=1).argmin())
        for source in dict.fromkeys((nearest, 0)):
            try:
                return self._solve(strain, self.states[source])
            except (ConvergenceError, InputError):  # the latter: inside out
                continue
        return None

    def _solve(self, strain: Array, source: KnownState | None) -> KnownState:
        solver = self.rve.solver
        if source is not None:
            solver.move_to(source.unknowns, np.zeros(solver.system.nodal_size))
        state = self.rve.solve_strain(strain, rate=None if source is None else source.rate.astype(float))
        assert state.tangent is not None
        assert state.rate is not None
        rate = state.rate.astype(np.float32)
        return KnownState(state.F, state.first_piola, state.energy, state.tangent, solver.y.copy(), rate)


class AdaptedData:
    """The data so far, ``all`` of them, the RVE that makes more, and what it did.

    Args:
        comm: the ranks that share the RVEs.
        base: data to start from, the reference state alone if None.
        rve: without free components, its bar force ``bar_force`` in N.
        measure: the stress of the data.
        adapted: for the parameters of the data set, what it is made for.

    Raises:
        InputError: the measure does not fit the data.
        ConvergenceError: the RVE has no equilibrium in its reference state.
    """

    def __init__(
        self, comm: MPI.Comm, base: Dataset | None, rve: RVE, *, bar_force: float, measure: str, adapted: dict[str, Any]
    ) -> None:
        self.comm, self.measure = comm, measure
        made = {"bar_force": bar_force, "blocks": [1, 1, 1], "images": "merged", "cell": asdict(CellParameters())}
        self.parameters, self.versions = {**made, "adapted": adapted}, versions()
        self.base = None if base is None else convert_dataset(base, measure)
        self._new: Dataset | None = None
        self.rves = self.failed = self.calls = 0
        clock = time.perf_counter()
        self.known = KnownStates(rve)
        self.seconds = time.perf_counter() - clock
        if self.base is None:
            self.rves = 1
            self._append([self.known.states[0]])

    @property
    def all(self) -> Dataset:
        """The base and what was added, as one."""
        if self.base is None or self._new is None:
            one = self.base or self._new
            assert one is not None
            return one
        return join_datasets(self.base, self._new)

    def add(self, strains: Array, origins: Array) -> Dataset | None:
        """Add the RVEs at ``strains`` and return them; see :meth:`KnownStates.solve`. None if all failed."""
        clock = time.perf_counter()
        states = self.known.solve(self.comm, strains, origins)
        self.seconds += time.perf_counter() - clock
        reached = [state for state in states if state is not None]
        self.rves += len(strains)
        self.failed += len(strains) - len(reached)
        return self._append(reached) if reached else None

    def _append(self, states: list[KnownState]) -> Dataset:
        """The states as data, the call as their path; of one run: unlike join_datasets it has one source."""
        found = convert_dataset(
            state_dataset(
                F=np.array([state.F for state in states]),
                first_piola=np.array([state.first_piola for state in states]),
                tangent=np.array([state.tangent for state in states]),
                energy=np.array([state.energy for state in states]),
                path=np.full(len(states), self.calls),
                step=np.arange(len(states)),
                parameters=self.parameters,
                versions=self.versions,
            ),
            self.measure,
        )
        self.calls += 1
        if self._new is None:
            self._new = found
        else:
            more = found.arrays()
            arrays: dict[str, Any] = {name: np.concatenate([a, more[name]]) for name, a in self._new.arrays().items()}
            self._new = replace(self._new, **arrays)
        return found
