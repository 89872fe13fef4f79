"""A structure under a pressure that follows its surface: the members' energy plus p times the enclosed volume."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.structure import Structure
from tsg_micro.equilibrium.members import MACRO, MemberState, MemberSystem
from tsg_micro.equilibrium.surface import Surface, enclosed_volume, pair_vectors, volume_gradient

__all__ = ["PressurisedState", "PressurisedSystem"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PressurisedState(MemberState):
    """Members at one point y, and where their surface is."""

    position: Array
    """Current coordinates (n, 3) less the reference midpoint, m."""
    pressure: float
    """Pa, positive from outside."""


class PressurisedSystem(MemberSystem):
    """Members and the surface around them; ``pressure`` (Pa) is what acts on it from outside at present."""

    def __init__(self, structure: Structure, surface: Surface, *, slack: bool = False) -> None:
        super().__init__(structure, slack=slack)
        self.surface = surface
        self.pairs = surface.pairs
        self.pressure = 0.0
        self._centred = structure.nodes - structure.nodes.mean(axis=0)

    def state(self, y: Array) -> PressurisedState:
        """Members and surface at y, under the present pressure."""
        members = super().state(y)
        values = {field.name: getattr(members, field.name) for field in fields(members)}
        return PressurisedState(
            **values, position=self._centred + y[: self.nodal_size].reshape(-1, 3), pressure=self.pressure
        )

    def volume(self, state: MemberState) -> float:
        """Enclosed volume, m^3."""
        return enclosed_volume(self.surface, _loaded(state).position)

    def volume_gradient(self, state: MemberState) -> Array:
        """Derivative of the enclosed volume by y (3n + 9,), m^2."""
        return np.append(volume_gradient(self.surface, _loaded(state).position), np.zeros(MACRO))

    def energy(self, state: MemberState) -> float:
        """Stored energy of the members and p V, J."""
        return super().energy(state) + _loaded(state).pressure * self.volume(state)

    def gradient(self, state: MemberState) -> Array:
        """Derivative of the energy by y (3n + 9,)."""
        gradient, pressure = super().gradient(state), _loaded(state).pressure
        return gradient + pressure * self.volume_gradient(state) if pressure else gradient

    def tangent_product(self, state: MemberState, directions: Array) -> Array:
        """Second derivative of the energy times ``directions`` (3n + 9, k)."""
        product = super().tangent_product(state, directions)
        if _loaded(state).pressure:
            w = self._pair_vectors(state)[:, None]
            i, j = self.pairs.T
            nodal = directions[: self.nodal_size].reshape(-1, 3, directions.shape[1]).swapaxes(1, 2)
            added = np.zeros_like(nodal)
            np.add.at(added, i, np.cross(w, nodal[j]))
            np.add.at(added, j, -np.cross(w, nodal[i]))
            product[: self.nodal_size] += added.swapaxes(1, 2).reshape(self.nodal_size, -1)
        return product

    def pair_blocks(self, state: MemberState) -> Array:
        """Second derivatives of p V by both nodes of each pair (p, 9), N/m: matrices of a cross product."""
        x, y, z = self._pair_vectors(state).T
        zero = np.zeros_like(x)
        return np.column_stack([zero, -z, y, z, zero, -x, -y, x, zero])

    def _pair_vectors(self, state: MemberState) -> Array:
        """p times the vectors (p, 3) of the second derivative of V, N/m."""
        loaded = _loaded(state)
        return loaded.pressure * pair_vectors(self.surface, loaded.position)


def _loaded(state: MemberState) -> PressurisedState:
    """``state``, known to be one of a structure under pressure."""
    if not isinstance(state, PressurisedState):
        raise TypeError("state: expected one that PressurisedSystem.state made")
    return state
