"""Regions: which cells of a mesh have a material of their own; and the places at the sides of a body that have one.

In a lattice an edge is exactly one block thick: the outer blocks at a free side or at a clamp answer otherwise than
those inside, all others as if there were no edge. So the cells within one block of a side are a region of their own,
one for each way in which sides meet: by what every axis meets there, "free" or "held", in one direction or "twice".
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dd_macro.compat import geometry_nodes
from dd_macro.parallel import total
from dd_macro.scene.mesh import TaggedMesh

__all__ = ["INSIDE", "Place", "Regions", "edge_regions"]

Array = NDArray[np.float64]
Place = tuple[str, str, str]
INSIDE: Place = ("", "", "")
_NEAR = 1e-6  # of a block


@dataclass(frozen=True)
class Regions:
    """``places`` name the regions, the same on all ranks; ``cell`` (cells,) has the number of each owned cell's.

    ``tissues`` are the numbers of the regions' tissues; those of one tissue follow each other, its inside first.
    """

    places: tuple[Place, ...]
    cell: NDArray[np.int64]
    tissues: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "tissues", self.tissues or (0,) * len(self.places))

    def of_tissues(self, comm: MPI.Comm, tissue: NDArray[np.int64], keep: Sequence[Callable[[Place], bool]]) -> Regions:
        """These regions, in each of the tissues apart: ``tissue`` (cells,) says which one a cell is of; collective.

        ``keep`` says for each of them at which places it is another material; see :meth:`only`.
        """
        places: list[Place] = []
        tissues: list[int] = []
        cell = np.zeros(len(self.cell), dtype=np.int64)
        for number, there in enumerate(keep):
            own, mine = self.only(there), tissue == number
            count = total(comm, np.bincount(own.cell[mine], minlength=len(own.places)))
            used = [k for k in range(len(own.places)) if k == 0 or count[k] > 0]
            place = np.zeros(len(own.places), dtype=np.int64)
            place[used] = len(places) + np.arange(len(used))
            cell[mine] = place[own.cell[mine]]
            places += [own.places[k] for k in used]
            tissues += [number] * len(used)
        return Regions(tuple(places), cell, tuple(tissues))

    def points(self, points_per_cell: int) -> NDArray[np.int64]:
        """The region of every quadrature point (n,)."""
        return np.repeat(self.cell, points_per_cell)

    def only(self, there: Callable[[Place], bool]) -> Regions:
        """The regions of those places that are ``there``.

        The others are of what their clamps alone would make them, or of the inside where that is not there either.
        """
        kept = (INSIDE, *(place for place in self.places if place != INSIDE and there(place)))
        clamps = [tuple(met if met.startswith("held") else "" for met in place) for place in self.places]
        now = [
            kept.index(place) if place in kept else kept.index(clamp) if clamp in kept else 0
            for place, clamp in zip(self.places, clamps, strict=True)
        ]
        return Regions(kept, np.array(now, dtype=np.int64)[self.cell])

    @classmethod
    def one(cls, cells: int) -> Regions:
        """A body without edges."""
        return cls((INSIDE,), np.zeros(cells, dtype=np.int64))


def edge_regions(
    domain: TaggedMesh, *, held: Collection[str], free: Collection[str], block: float, axes: Sequence[int] = (0, 1, 2)
) -> Regions:
    """The regions of a body of blocks with the edge ``block`` (m), whose sides are held, free, or neither; collective.

    Sides count that are flat and normal to one of ``axes``; a body has edges along an axis where no cell is larger
    than a block along it. The first region is the inside.
    """
    x = domain.mesh.geometry.x[geometry_nodes(domain.mesh)]  # (cells, 8, 3)
    middle, extent = x.mean(axis=1), np.ptp(x, axis=1)
    largest = _over_ranks(domain, extent, MPI.MAX)
    met = np.zeros((len(x), 3, 2), dtype=np.int64)  # along each axis, downwards and upwards: 0 nothing, 1 free, 2 held
    for kind, sides in ((1, free), (2, held)):
        for side in sorted(sides):  # in one order on all ranks
            low, high, _ = domain.extent(side)
            flat = [a for a in axes if high[a] - low[a] <= _NEAR * block and largest[a] <= (1 + _NEAR) * block]
            for axis in flat:
                across = [a for a in range(3) if a != axis]
                beside = ((middle >= low - _NEAR * block) & (middle <= high + _NEAR * block))[:, across].all(axis=1)
                depth = middle[:, axis] - low[axis]
                near = beside & (np.abs(depth) < block)
                met[near & (depth > 0), axis, 0] = kind
                met[near & (depth < 0), axis, 1] = kind
    mine = [_place(row) for row in met]
    there = {place for part in domain.comm.allgather(set(mine)) for place in part}  # a few words per rank
    places = (INSIDE, *sorted(there - {INSIDE}))
    number = {place: i for i, place in enumerate(places)}
    return Regions(places, np.array([number[place] for place in mine], dtype=np.int64))


def _place(met: NDArray[np.int64]) -> Place:
    """What every axis meets, downwards and upwards (3, 2); a clamp counts where it meets both."""
    words = [("", "free", "held")[max(pair)] + (" twice" if min(pair) > 0 else "") for pair in met.tolist()]
    return (words[0], words[1], words[2])


def _over_ranks(domain: TaggedMesh, x: Array, op: MPI.Op) -> Array:
    """Largest entries (3,) of x (n, 3) on all ranks."""
    local = x.max(axis=0, initial=-np.inf) if len(x) else np.full(3, -np.inf)
    found = np.empty(3)
    domain.comm.Allreduce(np.ascontiguousarray(local), found, op)
    return found
