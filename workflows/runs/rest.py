"""The unstrained state, which is always among the data of RVEs: zero strain, zero stress, and the tangent at rest.

Random data of six strains hold no small ones, and a body under a small load would take one far datum for all of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.continuum.graded_source import GradedSource
from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset import Dataset, convert_dataset, join_datasets

__all__ = ["with_rest"]

_AT_REST = 1e-12


def with_rest(dataset: Dataset) -> Dataset:
    """The data with the unstrained state of every RVE that they are from and do not hold it of.

    Measured data stay as they are: where their stress vanishes is theirs to say. So do those of a tissue whose bar
    force varies, which begin with it.

    Raises:
        InputError: what the data say of their RVE is not valid.
        ConvergenceError: an RVE has no equilibrium in its reference state.
    """
    if dataset.bar_force is not None:
        return dataset
    runs: dict[tuple[Any, ...], list[int]] = {}
    specs = [RVESpec.from_parameters(source) for source in dataset.sources]
    for run, spec in enumerate(specs):
        if spec is not None:
            runs.setdefault((spec.tissue, spec.images, spec.faces), []).append(run)
    run_of = np.zeros(len(dataset), dtype=np.int64) if dataset.source is None else dataset.source
    still = np.abs(dataset.strain).max(axis=1) <= _AT_REST
    found = dataset
    for same in runs.values():
        rows = np.isin(run_of, same)
        if rows.any() and not (still & rows).any():
            spec = specs[same[0]]
            assert spec is not None
            found = join_datasets(found, _rest(spec, dataset, dataset.sources[same[0]]))
    return found


def _rest(spec: RVESpec, dataset: Dataset, run: dict[str, Any]) -> Dataset:
    """The state at rest of this RVE, as one of this run of ``dataset``; where the bar force varies, some of them."""
    forces = None
    if dataset.bar_force is not None:
        low, high = dataset.bar_force.min(), dataset.bar_force.max()
        forces = np.unique([low, np.sqrt(low * high), high])
    zero: NDArray[np.float64] = np.zeros((1 if forces is None else len(forces), 6))
    state = RVESource(spec).states(zero, zero) if forces is None else GradedSource(spec).states(zero, zero, forces)
    assert state is not None  # the reference state is one
    state = replace(state, strain=zero, stress=zero, support=None if state.support is None else zero)
    state = convert_dataset(state, dataset.stress_measure)
    return replace(state, silent=dataset.silent, parameters=run, versions=dataset.versions, seed=dataset.seed)
