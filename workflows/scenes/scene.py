"""A scene from a file as a run sees it: mesh, tissues, supports, loads, and the problem they make."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.cells.tissue_file import read_tissue
from tsg_micro.continuum.rve_spec import KINDS, RVESpec
from tsg_micro.data.errors import InputError
from workflows.scenes.bar_force import bar_forces
from workflows.scenes.bodies import extent, make_body, tissue_of_cells
from workflows.scenes.model import Profile, SceneModel, TissueModel
from workflows.scenes.supports import held_and_free, loads_of, supports_of

__all__ = ["Built", "build", "tissue_named"]

Array = NDArray[np.float64]
Keep = Callable[[dd.Place], bool]
_THICK = 1.5
"""Blocks along z beyond which a body is bulk."""


def tissue_named(name: str, model: TissueModel) -> Tissue:
    """The tissue of the file, its middle's where the bar force varies.

    Raises:
        InputError: a value is not valid.
    """
    try:
        base = Tissue() if model.file is None else read_tissue(model.file)
        cell = {key: value for key, value in model.cell.model_dump().items() if value is not None}
        found = replace(base, cell=replace(base.cell, **cell))
        force = model.bar_force.f_max if isinstance(model.bar_force, Profile) else model.bar_force
        return found if force is None else replace(found, bar_force=force)
    except InputError as error:
        raise InputError(f"tissue.{name}: {error}") from None


@dataclass(frozen=True, eq=False)
class Built:
    """A scene on its mesh: ``tissues`` in the order of the file, and which of them every owned cell is of."""

    model: SceneModel
    domain: dd.TaggedMesh
    names: tuple[str, ...]
    tissues: tuple[Tissue, ...]
    kinds: tuple[str, ...]
    cell_tissue: NDArray[np.int64]
    bar_force: Array
    """f_b (cells,) in N of every owned cell."""
    supports: tuple[dd.Displacement, ...]
    loads: tuple[dd.Load, ...]

    @property
    def free(self) -> bool:
        """Whether rigid motions that are left are held in the mean."""
        return not self.supports or any(support.mean for support in self.model.support)

    @property
    def block(self) -> float:
        """Edge of a block, m."""
        return self.tissues[0].block

    def varies(self, number: int) -> bool:
        """Whether the bar force of this tissue varies from cell to cell."""
        return isinstance(self.model.tissue[self.names[number]].bar_force, Profile)

    def problem(self, rves: Sequence[RVESpec | None], keep: Sequence[Keep] | None = None) -> dd.Problem:
        """What is held and loaded; a region for every tissue, and for its edges where RVEs have them. Collective.

        ``rves`` are of the insides of the tissues, None of measured data; ``keep`` says for each tissue at which places
        edges are another material, everywhere if None.

        Raises:
            InputError: supports or loads do not fit.
        """
        solve, domain = self.model.solve, self.domain
        enhanced = solve.degree == 1 and (solve.element or "enhanced") == "enhanced"
        operator = dd.THEORIES[solve.kinematics].operator(domain, degree=solve.degree, enhanced=enhanced)
        supports = list(self.supports)
        regions = dd.Regions.one(domain.owned_cells)
        first = rves[0]
        if first is not None and self._edges(rves):
            along = [axis for axis in range(3) if first.periodic[axis]]
            held, free = held_and_free(domain, self.model)
            regions = dd.edge_regions(domain, held=held, free=free, block=self.block, axes=along)
            if any(met.startswith("held") for place in regions.places for met in place) and not first.periodic[2]:
                supports = self._thin(held)
        regions = regions.of_tissues(domain.comm, self.cell_tissue, keep or [lambda place: True] * len(rves))
        one = len(regions.places) == 1
        return dd.Problem(operator, supports, self.loads, regions=None if one else regions, free=self.free)

    def _edges(self, rves: Sequence[RVESpec | None]) -> bool:
        """Whether outer blocks are a tissue of their own: by default in sheets, of blocks of one size."""
        first, wanted = rves[0], self.model.solve.edges
        alike = all(rve is not None and rve.periodic == first.periodic for rve in rves) if first else False
        same = len({tissue.block for tissue in self.tissues}) == 1
        if wanted and not (alike and same):
            raise InputError("solve.edges: expected tissues of one kind and one size of block, got others")
        return alike and same and (not all(first.periodic) if wanted is None and first else bool(wanted))

    def _thin(self, held: set[str]) -> list[dd.Displacement]:
        """The supports, those of held sides without what moves along the thickness: their edge's RVEs hold it."""
        low, high = extent(self.domain)
        near = 1e-6 * (high[2] - low[2])
        found = []
        for one in self.supports:
            if one.side not in held or not isinstance(one.value, Sequence) or len(one.components) != 3:
                found.append(one)
                continue
            found.append(replace(one, value=one.value[:2], components=(0, 1)))
            found.append(replace(one, value=one.value[2:], components=(2,), where=_below(low[2] + near)))
        return found


def _below(z: float) -> Callable[[Array], NDArray[np.bool_]]:
    return lambda x: np.asarray(x[:, 2] < z)


def build(comm: MPI.Comm, model: SceneModel) -> Built:
    """The scene on its mesh; collective.

    Raises:
        InputError: a file or value does not fit; before any work is done.
    """
    if model.solve.degree != 1 and model.solve.element is not None:
        raise InputError(f"solve.element: expected none of degree {model.solve.degree}, got {model.solve.element}")
    names = tuple(model.tissue)
    tissues = tuple(tissue_named(name, one) for name, one in model.tissue.items())
    if model.body.mesh is None and len({tissue.block for tissue in tissues}) > 1:
        raise InputError("tissue: expected cells of one height in a body of blocks, got several")
    domain = make_body(comm, model, tissues[0].block)
    low, high = extent(domain)
    thick = (high - low)[2] > _THICK * tissues[0].block
    kinds = tuple(one.kind or ("bulk" if thick else "sheet") for one in model.tissue.values())
    assert set(kinds) <= set(KINDS)
    cell_tissue = tissue_of_cells(domain, model)
    force = bar_forces(domain, model, tissues, cell_tissue)
    supports, loads = supports_of(domain, model), loads_of(domain, model)
    return Built(model, domain, names, tissues, kinds, cell_tissue, force, tuple(supports), tuple(loads))
