"""The four stress measures of one state, and the maps between them.

With tau the Kirchhoff stress and F the deformation gradient, J = det F:
Cauchy sigma = tau / J, first Piola P = tau F^-T, second Piola S = F^-1 tau F^-T.
P is not symmetric; its Mandel vector is that of sym(P), the part that does work on a symmetric
displacement gradient. For a given F each measure is a linear image of tau, so all maps are invertible.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import BASIS, from_mandel, to_mandel

__all__ = ["MEASURES", "StressMeasure", "check_measure", "convert_stress", "convert_tangent", "measure_words"]

Array = NDArray[np.float64]
StressMeasure = Literal["cauchy", "kirchhoff", "first_piola", "second_piola"]
MEASURES: tuple[str, ...] = get_args(StressMeasure)


def check_measure(name: str) -> str:
    """Return ``name`` if it is one of MEASURES.

    Raises:
        InputError: it is not.
    """
    if name not in MEASURES:
        raise InputError(f"stress measure: expected one of {', '.join(MEASURES)}, got {name!r}")
    return name


def measure_words(name: str) -> str:
    """A measure as people write it: "first Piola"."""
    return " ".join(word if word in ("first", "second") else word.capitalize() for word in name.split("_"))


def _from_kirchhoff(tau: Array, F: Array, measure: str) -> Array:
    """Tensor of ``measure`` (..., 3, 3) from Kirchhoff tau (..., 3, 3)."""
    if measure == "kirchhoff":
        return tau
    if measure == "cauchy":
        return tau / np.linalg.det(F)[..., None, None]
    first_piola = tau @ np.swapaxes(np.linalg.inv(F), -1, -2)
    return first_piola if measure == "first_piola" else np.linalg.solve(F, first_piola)


def _rate_from_kirchhoff(tau: Array, dtau: Array, F: Array, dF: Array, measure: str) -> Array:
    """Derivative of :func:`_from_kirchhoff` along (dtau, dF)."""
    if measure == "kirchhoff":
        return dtau
    L = dF @ np.linalg.inv(F)  # spatial velocity gradient
    if measure == "cauchy":
        trace = np.trace(L, axis1=-2, axis2=-1)[..., None, None]
        return _from_kirchhoff(dtau - trace * tau, F, measure)
    rate = dtau - tau @ np.swapaxes(L, -1, -2)
    if measure == "second_piola":
        rate = rate - L @ tau
    return _from_kirchhoff(rate, F, measure)


def _map_from_kirchhoff(F: Array, measure: str) -> Array:
    """Matrices (..., 6, 6) that take the Mandel vector of tau to that of ``measure``."""
    columns = to_mandel(_from_kirchhoff(np.broadcast_to(BASIS, (*F.shape[:-2], 6, 3, 3)), F[..., None, :, :], measure))
    return np.swapaxes(columns, -1, -2)


def convert_stress(stress: Array, F: Array, source: str, target: str) -> Array:
    """Mandel stresses (N, 6) of measure ``source`` as measure ``target``, Pa; F is (N, 3, 3)."""
    check_measure(source), check_measure(target)
    if source == target:
        return np.array(stress, dtype=float)
    tau = np.linalg.solve(_map_from_kirchhoff(F, source), np.asarray(stress)[..., None])[..., 0]
    return to_mandel(_from_kirchhoff(from_mandel(tau), F, target))


def convert_tangent(tangent: Array, stress: Array, F: Array, source: str, target: str) -> Array:
    """Tangents d stress / d strain (N, 6, 6) of ``source`` as those of ``target``, Pa.

    ``stress`` (N, 6) is of measure ``source``. The strain is that of a symmetric displacement gradient,
    so the derivative along component k has dF = BASIS[k].
    """
    check_measure(source), check_measure(target)
    if source == target:
        return np.array(tangent, dtype=float)
    tau = from_mandel(convert_stress(stress, F, source, "kirchhoff"))[..., None, :, :]
    F1 = F[..., None, :, :]
    zero = np.zeros_like(BASIS)
    given = np.swapaxes(np.asarray(tangent, dtype=float), -1, -2)  # (N, k, 6)
    rest = given - to_mandel(_rate_from_kirchhoff(tau, zero, F1, BASIS, source))
    dtau = np.linalg.solve(_map_from_kirchhoff(F1, source), rest[..., None])[..., 0]
    rate = _rate_from_kirchhoff(tau, from_mandel(dtau), F1, BASIS, target)
    return np.swapaxes(to_mandel(rate), -1, -2)
