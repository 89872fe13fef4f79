"""Components that data say nothing about, as the out-of-plane shear of a free sheet: zero, as nothing drove them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import COMPONENTS

__all__ = ["check_silent", "zero_components"]

Array = NDArray[np.float64]
_ROUND_OFF = 1e-9  # of the largest strain or stress


def zero_components(strain: Array, stress: Array) -> tuple[str, ...]:
    """Components in which strain (N, 6) and stress (N, 6) are zero at all points, but for round-off."""
    small = (np.abs(strain).max(axis=0) <= max(_ROUND_OFF * np.abs(strain).max(), 1e-12)) & (
        np.abs(stress).max(axis=0) <= _ROUND_OFF * np.abs(stress).max()
    )
    return tuple(name for name, zero in zip(COMPONENTS, small, strict=True) if zero)


def check_silent(strain: Array, stress: Array, silent: Sequence[str]) -> None:
    """Raise InputError where a component declared ``silent`` is unknown, comes twice, or is not zero in the data."""
    unknown = [name for name in silent if name not in COMPONENTS]
    if unknown or len(set(silent)) != len(silent) or len(silent) == len(COMPONENTS):
        raise InputError(
            f"data set, silent: expected components among {', '.join(COMPONENTS)}, each once and not all of them, "
            f"got {', '.join(map(str, silent))}"
        )
    zero = zero_components(strain, stress) if silent else ()
    for name in (name for name in silent if name not in zero):
        i = COMPONENTS.index(name)
        raise InputError(
            f"data set, silent: expected zero strain and stress in {name} at every point, got up to "
            f"{np.abs(strain[:, i]).max():.3g} and {np.abs(stress[:, i]).max():.3g} Pa"
        )
