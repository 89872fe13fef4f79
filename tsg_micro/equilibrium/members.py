"""Exact energy, force and tangent of a structure's members.

Each member has the vector d = D y + d_ref, linear in the unknowns y = (nodal displacements, macroscopic displacement
gradient H); H moves members that end at a periodic image or at a side that it takes along. With length l = |d| the
member law gives energy, force t and stiffness dt/dl, by default EA (l - l0)^2 / (2 l0), EA (l - l0) / l0 and EA / l0;
the force density is q = t / l, and the tangent of t d / l is q 1 + (dt/dl - q) n (x) n: K_G + K_E of the paper's
Section 2.1, exact and symmetric.

All of it takes many states at once: y (3n + 9, b) gives arrays with a last axis of b more.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from tsg_micro.cells.laws.linear import NoCompression
from tsg_micro.cells.member_law import Members
from tsg_micro.cells.structure import Structure, member_vectors

__all__ = ["MACRO", "MemberState", "MemberSystem", "NodalPattern"]

Array = NDArray[np.float64]
MACRO = 9
"""Number of macroscopic unknowns: H row by row."""


@dataclass(frozen=True)
class MemberState:
    """Members at one point y."""

    vector: Array
    """Member vectors d (m, 3), m."""
    length: Array
    """Lengths (m,), m."""
    force: Array
    """Forces t (m,), tension positive, N."""
    stiffness: Array
    """dt/dl (m,), N/m; 0 in a slack tendon."""

    @property
    def force_density(self) -> Array:
        """q = t / l (m,), N/m."""
        return self.force / self.length

    def map(self, change: Callable[[Array], Array]) -> MemberState:
        """Every array changed alike, as to some members or states."""
        return MemberState(*map(change, (self.vector, self.length, self.force, self.stiffness)))


class MemberSystem:
    """The members of a structure as functions of y: (3n,) displacements in m, then the 9 entries of H.

    They answer by the law of the structure; with ``slack`` by the linear law, and tendons carry no compression.
    ``levers`` (m, 3, 3), m, say how H moves them, d_a += sum_b H_ab lever_ab; if None, as the periods between ends.
    """

    def __init__(self, structure: Structure, *, slack: bool = False, levers: Array | None = None) -> None:
        n, m = len(structure.nodes), len(structure.members)
        self.structure = structure
        self.reference = member_vectors(structure)
        self.rest_length = structure.rest_length
        self.law = NoCompression() if slack else structure.law
        self.material = structure.material
        self.nodal_size = 3 * n
        self.size = self.nodal_size + MACRO
        self.pairs = np.zeros((0, 2), dtype=np.int64)
        """Nodes (p, 2) that something else than a member couples, the lower number first."""
        self.pressure = 0.0
        """On the surface, Pa; a system without one has none."""

        axes = np.arange(3)
        row = (3 * np.arange(m)[:, None] + axes).ravel()
        i, j = ((3 * structure.members[:, end, None] + axes).ravel() for end in (0, 1))
        if levers is None:  # the reference vector to the image
            levers = np.broadcast_to((structure.shift * structure.size)[:, None, :], (m, 3, 3))
        at = np.flatnonzero(levers.any(axis=(1, 2)))
        macro_row = np.repeat((3 * at[:, None] + axes).ravel(), 3)
        macro_column = np.tile(self.nodal_size + np.arange(MACRO), len(at))
        macro_value = levers[at].ravel()
        ones = np.ones(3 * m)
        self.D = sp.csr_array(
            (
                np.concatenate([-ones, ones, macro_value]),
                (np.concatenate([row, row, macro_row]), np.concatenate([i, j, macro_column])),
            ),
            shape=(3 * m, self.size),
        )
        self.DT = self.D.T.tocsr()
        self.moved = at
        """Members that H moves (k,)."""
        rows = (3 * at[:, None] + axes).ravel()
        self._moved, self._moved_T = self.D[rows], self.DT[:, rows]

    def state(self, y: Array) -> MemberState:
        """Vectors, lengths, forces and stiffness of the members at y."""
        many = y.shape[1:]
        d = self.reference[(..., *(None for _ in many))] + (self.D @ y).reshape(-1, 3, *many)
        length = np.sqrt((d * d).sum(axis=1))
        count = math.prod(many)  # laws take the members one by one
        rest = np.repeat(self.rest_length, count)
        material = Members(np.repeat(self.material.EA, count), np.repeat(self.material.bar, count))
        given = (length.ravel(), rest, material)
        force, stiffness = (answer(*given).reshape(length.shape) for answer in (self.law.force, self.law.stiffness))
        return MemberState(d, length, force, stiffness)

    def energy(self, state: MemberState) -> float:
        """Stored energy, J."""
        return self.law.energy(state.length, self.rest_length, self.material)

    def gradient(self, state: MemberState) -> Array:
        """Derivative of the energy by y (3n + 9,): nodal forces in N, then V0 P in J."""
        force = state.force_density[:, None] * state.vector
        return np.asarray(self.DT @ force.reshape(-1, *force.shape[2:]))

    def tangent_product(self, state: MemberState, directions: Array) -> Array:
        """Second derivative of the energy times ``directions`` (3n + 9, k), of many states (3n + 9, k, b)."""
        change = self.member_forces(state, directions)
        return np.asarray(self.DT @ change.reshape(3 * len(change), -1)).reshape(-1, *change.shape[2:])

    def member_forces(self, state: MemberState, directions: Array) -> Array:
        """Change (m, 3, k) of the force vectors t n along ``directions`` (3n + 9, k), of many states (3n + 9, k, b)."""
        return _force_change(state, self.D, directions)

    def macro_product(self, state: MemberState, directions: Array) -> Array:
        """As :meth:`tangent_product`, of ``directions`` in which H moves alone."""
        change = _force_change(self._of_moved(state), self._moved, directions)
        return np.asarray(self._moved_T @ change.reshape(3 * len(change), -1)).reshape(-1, *change.shape[2:])

    def macro_part(self, state: MemberState, directions: Array) -> Array:
        """The last nine rows, those of H, of :meth:`tangent_product`."""
        change = _force_change(self._of_moved(state), self._moved, directions)
        rows = self._moved_T[self.nodal_size :]
        return np.asarray(rows @ change.reshape(3 * len(change), -1)).reshape(-1, *change.shape[2:])

    def _of_moved(self, state: MemberState) -> MemberState:
        return state.map(lambda part: part[self.moved])

    def member_blocks(self, state: MemberState) -> Array:
        """Member tangents q 1 + (dt/dl - q) n (x) n (m, 9), N/m."""
        q, n = state.force_density, state.vector / state.length[:, None]
        blocks = (state.stiffness - q)[:, None, None] * n[:, :, None] * n[:, None, :]
        blocks[:, [0, 1, 2], [0, 1, 2]] += q[:, None]
        return blocks.reshape(-1, 9, *q.shape[1:])

    def pair_blocks(self, state: MemberState) -> Array:
        """What ``pairs`` add to the tangent (p, 9), N/m: second derivatives by the first node and the second."""
        return np.zeros((len(self.pairs), 9))


def _force_change(state: MemberState, D: sp.csr_array, directions: Array) -> Array:
    """Change (m, 3, k) of the force vectors t n of the members whose rows D has."""
    q, n = state.force_density, state.vector / state.length[:, None]
    change = (D @ directions.reshape(len(directions), -1)).reshape(len(q), 3, *directions.shape[1:])
    along = (n[:, :, None] * change).sum(axis=1)
    return np.asarray(q[:, None, None] * change + ((state.stiffness - q)[:, None] * along)[:, None] * n[:, :, None])


class NodalPattern:
    """The free-free part of the nodal tangent as upper-triangular CSR, its pattern worked out once."""

    def __init__(self, structure: Structure, free: NDArray[np.bool_], pairs: NDArray[np.int64] | None = None) -> None:
        """``free`` (3n,) marks the displacements that are unknown, ``pairs`` (p, 2) couples further nodes."""
        pairs = np.zeros((0, 2), dtype=np.int64) if pairs is None else pairs
        n, m, p = len(structure.nodes), len(structure.members), len(pairs)
        i, j = structure.members.min(axis=1), structure.members.max(axis=1)
        off = i != j
        wanted = [np.arange(n) * (n + 1), i[off] * n + j[off], pairs[:, 0] * n + pairs[:, 1]]
        keys, place = np.unique(np.concatenate(wanted), return_inverse=True)
        diagonal, pair, further = place[:n], place[n : len(place) - p], place[len(place) - p :]
        # sum of member blocks into node-pair blocks: + on both diagonals, - on the pair; further blocks as they are
        member = np.arange(m)[off]
        self._sum = sp.csr_array(
            (
                np.concatenate([np.ones(2 * len(member)), -np.ones(len(member)), np.ones(p)]),
                (
                    np.concatenate([diagonal[i[off]], diagonal[j[off]], pair, further]),
                    np.concatenate([np.tile(member, 3), m + np.arange(p)]),
                ),
            ),
            shape=(len(keys), m + p),
        )
        number = np.full(3 * n, -1, dtype=np.int64)
        number[free] = np.arange(free.sum())
        node_i, node_j = keys // n, keys % n
        entry = np.arange(9)
        row = number[3 * node_i[:, None] + entry // 3]
        column = number[3 * node_j[:, None] + entry % 3]
        keep = (row >= 0) & (column >= 0) & ((node_i != node_j)[:, None] | (column >= row))
        source = np.flatnonzero(keep.ravel())
        row, column = row.ravel()[source], column.ravel()[source]
        order = np.lexsort((column, row))
        self._source = source[order]
        self.size = int(free.sum())
        self.indices = column[order].astype(np.int32)
        self.indptr = np.searchsorted(row[order], np.arange(self.size + 1)).astype(np.int32)
        self.diagonal = self.indptr[:-1]
        """Where each row's diagonal entry sits (the first of its row)."""

    def assemble(self, member_blocks: Array, pair_blocks: Array | None = None) -> Array:
        """Values (nnz,) of the upper triangle from member tangents (m, 9) and blocks of the pairs (p, 9), N/m."""
        if pair_blocks is not None:
            member_blocks = np.concatenate([member_blocks, pair_blocks])
        summed = self._sum @ member_blocks.reshape(len(member_blocks), -1)
        return np.asarray(summed.reshape(-1, *member_blocks.shape[2:])[self._source])
