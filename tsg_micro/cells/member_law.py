"""What a member answers to its length: the protocol of member laws, and the one registry that knows them by name.

A law is a frozen dataclass, its fields its parameters, in a file of tsg_micro/cells/laws with ``@member_law(name)``
above it. One that is written elsewhere is passed as an instance, and can be named where its file was imported.
"""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.plain_values import check_names, numbers
from tsg_micro.data.errors import InputError

__all__ = ["MemberLaw", "Members", "law_as_dict", "law_from_dict", "member_law"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Members:
    """What m members are made of."""

    EA: Array
    """Axial stiffness at rest (m,), N."""
    bar: NDArray[np.bool_]
    """Which are bars (m,); the others are tendons."""


class MemberLaw(Protocol):
    """Energy, force t and stiffness dt/dl, each the derivative of the one before by the length l (m,), m.

    ``rest_length`` is the length l0 (m,), m, without force; a stiffness of exactly 0 says that a tendon is slack.
    """

    def energy(self, length: Array, rest_length: Array, members: Members) -> float:
        """Stored energy of all members, J."""

    def force(self, length: Array, rest_length: Array, members: Members) -> Array:
        """Forces t (m,), tension positive, N."""

    def stiffness(self, length: Array, rest_length: Array, members: Members) -> Array:
        """dt/dl (m,), N/m."""

    def rest_length(self, length: Array, force: Array, members: Members) -> Array:
        """Rest lengths (m,), m, at which members of this length carry this force (m,), N.

        Raises:
            InputError: there are none.
        """


_LAWS: dict[str, type[MemberLaw]] = {}


def member_law[Law: MemberLaw](name: str) -> Callable[[type[Law]], type[Law]]:
    """Make a law known by ``name`` in data sets and tissue files."""

    def register(law: type[Law]) -> type[Law]:
        _LAWS[name] = law
        return law

    return register


@functools.cache
def _find_laws() -> None:
    """Import all files of tsg_micro/cells/laws, so that their laws are registered."""
    folder = importlib.import_module("tsg_micro.cells.laws")
    for file in pkgutil.iter_modules(folder.__path__):
        importlib.import_module(f"{folder.__name__}.{file.name}")


def law_as_dict(law: MemberLaw) -> dict[str, Any]:
    """Name and parameters of a law, plain values.

    Raises:
        InputError: it is not registered.
    """
    _find_laws()
    for name, known in _LAWS.items():
        if type(law) is known:
            return {"name": name, **asdict(law)}  # type: ignore[call-overload]
    raise InputError(f"law: expected one that @member_law gave a name, got {type(law).__name__}")


def law_from_dict(values: Mapping[str, Any]) -> MemberLaw:
    """The law that :func:`law_as_dict` wrote; parameters that are not given are at their defaults.

    Raises:
        InputError: an unknown name or parameter, or a value that is no number.
    """
    _find_laws()
    wanted = values.get("name") if isinstance(values, Mapping) else values
    if not isinstance(values, Mapping) or not isinstance(wanted, str) or wanted not in _LAWS:
        raise InputError(f"tissue, law, name: expected one of {', '.join(sorted(_LAWS))}, got {wanted!r}")
    law = _LAWS[wanted]
    given = {name: value for name, value in values.items() if name != "name"}
    check_names("tissue, law", values, ["name", *(one.name for one in fields(law))])  # type: ignore[arg-type]
    return law(**numbers("tissue, law", given))
