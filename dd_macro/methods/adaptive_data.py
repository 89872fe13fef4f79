"""The data of an adaptive run, part by part, and what was done for them."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.regional import join_parts
from dd_macro.methods.method import Material
from tsg_micro.data.dataset import Dataset, convert_dataset, join_datasets

__all__ = ["AllData", "PartData"]

Array = NDArray[np.float64]


class AllData:
    """The data of all parts, and what was done for them."""

    def __init__(self, parts: list[PartData]) -> None:
        self.parts = parts

    @property
    def all(self) -> Dataset:
        """Those of all parts, in their order."""
        return join_parts([part.all for part in self.parts])

    @property
    def rves(self) -> int:
        """Data asked for."""
        return sum(part.rves for part in self.parts)

    @property
    def failed(self) -> int:
        """Those that were not reached."""
        return sum(part.failed for part in self.parts)

    @property
    def seconds(self) -> float:
        """What the sources took, s."""
        return sum(part.seconds for part in self.parts)


class PartData:
    """The data so far, ``all`` of them, and what the source did: how many were asked for, failed, and took seconds.

    Raises:
        InputError: the measure does not fit the data.
    """

    def __init__(self, material: Material, bar_forces: Array | None = None) -> None:
        """``bar_forces`` (k,) in N are those to begin with where they vary."""
        assert material.source is not None
        base = material.dataset
        self.measure = material.measure or ("first_piola" if base is None else base.stress_measure)
        self.source, self.base = material.source, None if base is None else convert_dataset(base, self.measure)
        self._new: Dataset | None = None
        self.rves = self.failed = 0
        self.seconds = 0.0
        if base is None:
            rest = np.zeros((1 if bar_forces is None else len(bar_forces), 6))
            self.add(rest, rest, bar_forces)

    @property
    def all(self) -> Dataset:
        """The base and what was added, as one."""
        if self.base is None or self._new is None:
            one = self.base or self._new
            assert one is not None
            return one
        return join_datasets(self.base, self._new)

    def add(self, strains: Array, origins: Array, bar_forces: Array | None = None) -> Dataset | None:
        """Add data at ``strains`` and return them, see dd_macro.Source; None if none was reached."""
        clock = time.perf_counter()
        more = () if bar_forces is None else (bar_forces,)
        found = self.source.states(strains, origins, *more)
        self.seconds += time.perf_counter() - clock
        self.rves += len(strains)
        self.failed += len(strains) - (0 if found is None else len(found))
        if found is None:
            return None
        found = convert_dataset(found, self.measure)
        if self._new is None:
            self._new = found
        else:  # of one run: unlike join_datasets it has one source
            new = found.arrays()
            arrays: dict[str, Any] = {name: np.concatenate([a, new[name]]) for name, a in self._new.arrays().items()}
            self._new = replace(self._new, **arrays)
        return found
