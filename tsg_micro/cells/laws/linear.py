"""Members whose force is proportional to their strain, and the same with tendons that carry no compression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.member_law import Members, member_law
from tsg_micro.data.errors import InputError

__all__ = ["LINEAR", "Linear", "NoCompression"]

Array = NDArray[np.float64]


@member_law("linear")
@dataclass(frozen=True)
class Linear:
    """t = EA (l - l0) / l0 (paper, Section 2.1)."""

    def energy(self, length: Array, rest_length: Array, members: Members) -> float:
        """Stored energy of all members, J."""
        return float(0.5 * np.dot(self.force(length, rest_length, members), length - rest_length))

    def force(self, length: Array, rest_length: Array, members: Members) -> Array:
        """t (m,), N."""
        return self.stiffness(length, rest_length, members) * (length - rest_length)

    def stiffness(self, length: Array, rest_length: Array, members: Members) -> Array:
        """dt/dl (m,), N/m."""
        return members.EA / rest_length

    def rest_length(self, length: Array, force: Array, members: Members) -> Array:
        """l0 = EA l / (EA + t) (m,), m."""
        stretched = members.EA + force
        if (stretched <= 0.0).any():
            raise InputError("force_density: expected forces above -EA in every member")
        return members.EA * length / stretched


LINEAR = Linear()


@member_law("no-compression")
@dataclass(frozen=True)
class NoCompression(Linear):
    """The linear law, but a tendon shorter than its rest length is slack."""

    def stiffness(self, length: Array, rest_length: Array, members: Members) -> Array:
        """dt/dl (m,), N/m; 0 in a slack tendon."""
        slack = ~members.bar & (length < rest_length)
        return np.where(slack, 0.0, super().stiffness(length, rest_length, members))

    def rest_length(self, length: Array, force: Array, members: Members) -> Array:
        """As the linear law's; there is none for a tendon under compression."""
        if (force[~members.bar] < 0.0).any():
            raise InputError("force_density: expected no compression in the tendons, which carry none")
        return super().rest_length(length, force, members)
