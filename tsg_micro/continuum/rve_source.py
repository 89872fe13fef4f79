"""An RVE as a source of data: states at the strains that one asks for, each from the nearest state that is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import state_dataset
from tsg_micro.continuum.warm_rve import WarmRVE
from tsg_micro.continuum.warm_states import WarmStates
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["RVESource", "Ranks"]

Array = NDArray[np.float64]
_SHORTER = 3


class Ranks(Protocol):
    """What the source asks of a communicator, as those of mpi4py are."""

    rank: int
    size: int

    def allgather(self, sendobj: Any) -> list[Any]:
        """The objects of all ranks."""


class _Alone:
    rank, size = 0, 1

    def allgather(self, sendobj: Any) -> list[Any]:
        return [sendobj]


class RVESource:
    """The states of one RVE so far, the same on every rank: at first that of the reference.

    Args:
        spec: the RVE; all six strains are prescribed, whatever it says is free.
        comm: the ranks that share the work; this process alone if None.
        parameters: more of the data set's parameters.
        versions: of the data set.

    Example:
        >>> source = tsg.RVESource(tsg.RVESpec(free=()))
        >>> strain = np.array([[0.0, 0.01, 0.0, 0.0, 0.0, 0.0]])
        >>> data = source.states(strain, strain)
        >>> len(data), data.tangent.shape
        (1, (1, 6, 6))
    """

    def __init__(
        self,
        spec: RVESpec,
        *,
        comm: Ranks | None = None,
        parameters: Mapping[str, Any] | None = None,
        versions: Mapping[str, str] | None = None,
    ) -> None:
        self.spec, self.comm = replace(spec, free=()), comm or _Alone()
        made = {"bar_force": spec.tissue.bar_force, "blocks": list(spec.blocks), "images": spec.images}
        made |= {"cell": asdict(spec.tissue.cell), **self.spec.parameters()}
        self.parameters, self.versions = {**made, **(parameters or {})}, dict(versions or {})
        self.calls = 0

    @cached_property
    def rve(self) -> WarmRVE:
        """The RVE, which is made when the first state is asked for."""
        return WarmRVE(self.spec.build())

    @cached_property
    def known(self) -> WarmStates:
        """All states so far."""
        return self.rve.reference

    def states(self, strains: Array, origins: Array, bar_forces: Array | None = None) -> Dataset | None:
        """Data at ``strains`` (k, 6), the states of one call as a path; see dd_macro.Source.

        Raises:
            InputError: ``bar_forces`` are asked for; GradedSource has them.
            ConvergenceError: the RVE has no equilibrium in its reference state.
        """
        if bar_forces is not None:
            raise InputError("bar_forces: expected none of a tissue with one bar force, got some")
        reached = [state for state in self.reach(strains, origins) if state is not None]
        if not reached:
            return None
        found = WarmStates.join(reached)
        self.calls += 1
        clamps = {"support": found.support, "support_tangent": found.support_tangent} if any(self.spec.held) else {}
        return state_dataset(
            F=found.F,
            first_piola=found.first_piola,
            tangent=found.tangent,
            energy=found.energy,
            path=np.full(len(found), self.calls - 1),
            step=np.arange(len(found)),
            parameters=self.parameters,
            versions=self.versions,
            **clamps,
        )

    def reach(self, strains: Array, origins: Array) -> list[WarmStates | None]:
        """States at ``strains`` (k, 6), shared among the ranks; each starts from the nearest one of earlier calls.

        Where the equilibrium is lost on the way, the reference state is tried, and then the strain halved towards that
        of ``origins`` (k, 6), a few times; None where that does not help. So the ranks do not decide what is found.
        """
        strains, origins = np.reshape(strains, (-1, 6)), np.reshape(origins, (-1, 6))
        mine = np.arange(self.comm.rank, len(strains), self.comm.size)
        with threadpool_limits(1):
            reached = self._reach(strains[mine], origins[mine])
        parts = self.comm.allgather(dict(zip(mine.tolist(), reached, strict=True)))
        found = {k: state for part in parts for k, state in part.items()}
        states = [found[k] for k in range(len(strains))]
        new = [state for state in states if state is not None and state.strain.any()]
        self.known = WarmStates.join([self.known, *new])
        return states

    def _reach(self, strains: Array, origins: Array) -> list[WarmStates | None]:
        """What is reached of ``strains``, here alone."""
        found: list[WarmStates | None] = [None] * len(strains)
        for part in 0.5 ** np.arange(_SHORTER):
            wanted = origins + part * (strains - origins)
            apart = np.linalg.norm(wanted[:, None] - self.known.strain, axis=2)
            nearest = apart.argmin(axis=1)
            for sources in (nearest, np.zeros_like(nearest)):
                left = [k for k, state in enumerate(found) if state is None and (sources is nearest or nearest[k])]
                for k in left:
                    if not wanted[k].any():
                        found[k] = self.rve.reference
                left = [k for k in left if found[k] is None]
                states, reached, _ = self.rve.solve_many(wanted[left], self.known.take(sources[left]))
                for i, k in enumerate(reached):
                    found[left[k]] = states.take([i])
        return found
