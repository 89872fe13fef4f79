"""What answers a strain that one asks for: RVEs that are computed, an experiment that is made."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.dataset import Dataset

__all__ = ["Source"]

Array = NDArray[np.float64]


class Source(Protocol):
    """More data, at strains of one's choice."""

    def states(self, strains: Array, origins: Array, bar_forces: Array | None = None) -> Dataset | None:
        """Data with tangents at ``strains`` (k, 6), the same on every rank; collective, with equal arguments on all.

        Where a strain cannot be reached, it is one on the way there from that of ``origins`` (k, 6), or left out; None
        where all are. At zero strain it is the reference state. Where the bar force of the tissue varies,
        ``bar_forces`` (k,) in N are asked for, and the data have their ``bar_force`` and ``bar_force_rate``.
        """
