"""RVEs of a tissue whose bar force varies: states at the strains and bar forces that one asks for.

With W(H, f_b) the energy of the RVE in equilibrium, P = dW/dH and dW/df_b is that of the members at fixed y, so that
    dP_k/df_b = d2W / (dH_k df_b) = (dy/dH_k) . (dg/df_b) / V0,      g = D^T (t n) the gradient of the energy by y:
the rates that the tangent has already are all it takes. The bar force acts by the rest lengths alone: dt/df_b at fixed
length is taken from the member law at two of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tsg_micro.continuum.rve import RVE
from tsg_micro.continuum.rve_source import Ranks, RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import state_dataset
from tsg_micro.continuum.warm_rve import WarmRVE
from tsg_micro.continuum.warm_states import WarmStates
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import ConvergenceError, InputError

__all__ = ["GradedSource", "bar_force_rate"]

Array = NDArray[np.float64]
_STEP = 1e-4
_SHORTER = 3


def bar_force_rate(spec: RVESpec, rve: RVE, states: WarmStates) -> Array:
    """d stress / d f_b (n, 6) in Pa/N of the symmetric first Piola stress of ``states``, at fixed strain.

    ``rve`` is built of ``spec``; both are of the bar force of the states.
    """
    system, force = rve.solver.system, spec.tissue.bar_force
    ends = [spec.with_bar_force(force * (1 + sign * _STEP)).build().structure.rest_length for sign in (1, -1)]
    found = np.empty((len(states), 6))
    for k, y in enumerate(states.unknowns):
        members = system.state(y)
        more, less = (system.law.force(members.length, rest, system.material) for rest in ends)
        change = (more - less) / (2 * _STEP * force) / members.length
        gradient = system.DT @ (change[:, None] * members.vector).ravel()
        found[k] = states.rate[k].astype(float).T @ gradient / rve.structure.volume
    return found


class GradedSource:
    """Data of a tissue at any of its bar forces; see RVESource for the arguments.

    Each state is followed from rest, in an RVE of its own bar force.
    """

    def __init__(
        self,
        spec: RVESpec,
        *,
        comm: Ranks | None = None,
        parameters: Mapping[str, Any] | None = None,
        versions: Mapping[str, str] | None = None,
    ) -> None:
        one = RVESource(spec, comm=comm, parameters=parameters, versions=versions)
        self.spec, self.comm, self.versions = one.spec, one.comm, one.versions
        self.parameters = one.parameters | {"graded": True, "bar_force": None}
        self.calls = 0

    def states(self, strains: Array, origins: Array, bar_forces: Array | None = None) -> Dataset | None:
        """Data at ``strains`` (k, 6) and ``bar_forces`` (k,) in N; see dd_macro.Source.

        Raises:
            InputError: no bar forces, or some that are not valid.
            ConvergenceError: an RVE has no equilibrium in its reference state.
        """
        if bar_forces is None:
            raise InputError("bar_forces: expected one for every strain, got none")
        strains, origins = np.reshape(strains, (-1, 6)), np.reshape(origins, (-1, 6))
        mine = {}
        with threadpool_limits(1):
            for k in range(self.comm.rank, len(strains), self.comm.size):
                mine[k] = self._reach(strains[k], origins[k], float(bar_forces[k]))
        found = {k: state for part in self.comm.allgather(mine) for k, state in part.items()}
        reached = [k for k in range(len(strains)) if found[k] is not None]
        if not reached:
            return None
        states = WarmStates.join([found[k][0] for k in reached])
        self.calls += 1
        return state_dataset(
            F=states.F,
            first_piola=states.first_piola,
            tangent=states.tangent,
            energy=states.energy,
            path=np.full(len(states), self.calls - 1),
            step=np.arange(len(states)),
            parameters=self.parameters,
            versions=self.versions,
            bar_force=np.asarray(bar_forces, dtype=float)[reached],
            bar_force_rate=np.concatenate([found[k][1] for k in reached]),
        )

    def _reach(self, strain: Array, origin: Array, bar_force: float) -> tuple[WarmStates, Array] | None:
        """The state at a strain, or at one on the way there from ``origin``, and its rate by the bar force."""
        spec = self.spec.with_bar_force(bar_force)
        rve = spec.build()
        warm = WarmRVE(rve)
        for part in 0.5 ** np.arange(_SHORTER):
            wanted = origin + part * (strain - origin)
            try:
                state = warm.solve(wanted, warm.reference, 0) if wanted.any() else warm.reference
            except (ConvergenceError, InputError):  # the latter: inside out
                continue
            return state, bar_force_rate(spec, rve, state)
        return None
