"""The macroscopic scene of a data-driven run: mesh, load, material data and metric."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

import dd_macro as dd
from dd_macro.parallel import span
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_spec import KINDS, RVESpec
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import from_mandel
from workflows.runs.loads import LOADS, check_load, check_reach
from workflows.scenes.bodies import MOST_BLOCKS, PER_ELEMENT
from workflows.scenes.grading import graded_by_default, halved_sides
from workflows.store.limits import check_memory

__all__ = ["CLAMPS", "ELEMENTS", "KINEMATICS", "OLDER", "Scene", "read_material", "tissue_of"]

KINEMATICS = tuple(dd.THEORIES)
CLAMPS = ("full", "inplane")
ELEMENTS = ("enhanced", "trilinear")
"""Of degree 1: the first one is the default."""
OLDER: dict[str, object] = {
    "element": "trilinear",
    "mesh_unit": "m",
    "merge_nodes": False,
    "edges": False,
    "refine": 1,
    "graded": False,
    "kind": None,
}
"""What the scene of a run was that does not say."""


@dataclass(frozen=True)
class Scene:
    """What is loaded, and how: a box of one element a block, or the hexahedra of a gmsh file.

    ``kinematics`` is "small" or "finite" strain. The sides with a displacement are held in all three components
    (``clamp`` "full"), or in the plane of the sheet alone ("inplane"), where their thickness is free: the hold on the
    thickness fades over a third of a block, which elements of a block cannot follow. ``degree`` of the elements; those
    of degree 1 are an ``element`` of ELEMENTS, its default if None. A ``flat`` sheet has its back side held in its
    plane, so that it cannot buckle. ``mesh_unit`` is that of the file's coordinates; ``merge_nodes`` joins those nodes
    that are at one place. With ``edges`` the outer blocks at clamps and at free sides have a tissue of their own,
    where RVEs of it can be had; if None, those of a sheet have, since in bulk tissue it does not pay (docs/edges.md).
    ``kind`` of tissue is one of tsg_micro.continuum.rve_spec.KINDS, None where the data decide. A block has ``refine``
    elements along each axis, twice as many across the two outer rows of blocks at every side of a ``graded`` box, since
    stress varies within a block beside clamps and corners; by default sheets of the default element are.
    """

    load: str
    strain: float
    elements: tuple[int, int, int] | None = None
    mesh: Path | None = None
    kinematics: str = "small"
    clamp: str = "full"
    degree: int = 1
    flat: bool = False
    element: str | None = None
    mesh_unit: str = "m"
    merge_nodes: bool = False
    edges: bool | None = None
    refine: int = 1
    graded: bool | None = None
    kind: str | None = None

    def __post_init__(self) -> None:
        check_load(self.load, self.strain)
        for name, known in (("kinematics", KINEMATICS), ("clamp", CLAMPS), ("degree", (1, 2))):
            if getattr(self, name) not in known:
                raise InputError(f"{name}: expected {' or '.join(map(str, known))}, got {getattr(self, name)!r}")
        if self.kind is not None and self.kind not in KINDS:
            raise InputError(f"kind: expected {' or '.join(KINDS)}, got {self.kind!r}")
        if self.element is not None and (self.degree != 1 or self.element not in ELEMENTS):
            raise InputError(
                f"element: expected {' or '.join(ELEMENTS)}, of degree 1, got {self.element!r} of degree {self.degree}"
            )
        if self.refine < 1 or (self.refine > 1 and self.mesh is not None):
            raise InputError(f"refine: expected at least 1, of a box, got {self.refine}")
        if self.graded and self.mesh is not None:
            raise InputError("graded: expected a box, --elements NX NY NZ, got a mesh")
        if (self.elements is None) == (self.mesh is None):
            raise InputError(
                "elements, mesh: expected one of them, --elements NX NY NZ or --mesh FILE.msh, or a scene file"
            )

    def build(self, comm: MPI.Comm, tissue: Tissue | None = None) -> dd.TaggedMesh:
        """The mesh, distributed over ``comm``; an element is a block of ``tissue``, the default one if None."""
        block = (tissue or Tissue()).block
        if self.mesh is not None:
            size = (block, MOST_BLOCKS * block)
            return dd.read_msh(self.mesh, comm, unit=self.mesh_unit, size=size, merge_nodes=self.merge_nodes)
        assert self.elements is not None
        if min(self.elements) > 0:
            needed = PER_ELEMENT * (self.refine * self.degree) ** 3 * math.prod(self.elements)
            dd.parallel.together(comm, lambda: check_memory(f"elements: {math.prod(self.elements or ())}", needed))
        nx, ny, nz = self.elements
        held, back = ("bottom", "top"), ("back",) * self.flat
        halved = halved_sides(self.elements, held, (*held, *back)) if self.parameters()["graded"] else ()
        lengths = (block * nx, block * ny, block * nz)
        return dd.box(comm, elements=self.elements, size=lengths, refine=self.refine, halved=halved)

    def problem(
        self,
        comm: MPI.Comm,
        tissue: Tissue | None = None,
        rve: RVESpec | None = None,
        there: Callable[[dd.Place], bool] | None = None,
    ) -> dd.Problem:
        """What is held and moved, on the mesh, whose outer blocks are regions where the inner ones are of ``rve``.

        ``there`` says at which places they are; everywhere if None. An RVE that is held across an axis holds its free
        faces there too, so the supports of the body leave free what does not move along periodic axes. Collective.

        Raises:
            InputError: as :meth:`supports`, or the mesh is not valid.
        """
        domain = self.build(comm, tissue)
        theory, enhanced = dd.THEORIES[self.kinematics], self.parameters()["element"] == "enhanced"
        operator = theory.operator(domain, degree=self.degree, enhanced=enhanced)
        if rve is None or not (self.edges if self.edges is not None else not all(rve.periodic)):
            return dd.Problem(operator, self.supports(domain))
        clamps = {"bottom", "top"} if self.clamp == "full" else set()
        free = set(domain.names) - {"bottom", "top"} - ({"back"} if self.flat else set())
        along = [axis for axis in range(3) if rve.periodic[axis]]
        regions = dd.edge_regions(domain, held=clamps, free=free, block=rve.tissue.block, axes=along)
        regions = regions if there is None else regions.only(there)
        holds = any(met.startswith("held") for place in regions.places for met in place)
        thin = replace(self, clamp="inplane") if holds and not rve.periodic[2] else self
        return dd.Problem(operator, thin.supports(domain), regions=regions if len(regions.places) > 1 else None)

    def supports(self, domain: dd.TaggedMesh) -> list[dd.Displacement]:
        """Bottom side held, top side moved by the strain times the height of the mesh; collective.

        Raises:
            InputError: a flat sheet without a side called back, or bottom and top of a mesh are not where they should
                be for this load.
        """
        bottom, top = _extent(domain, 1)
        if self.mesh is not None:
            for side in ("bottom", "top"):
                _check_place(domain, side, bottom, top)
        moved = LOADS[self.load].top_displacement(self.strain, top - bottom)
        if self.flat and "back" not in domain.names:
            raise InputError(f"flat: expected a side named back in the mesh, got {', '.join(sorted(domain.names))}")
        back = [dd.Displacement("back", (0.0,), (2,))] if self.flat else []
        if self.clamp == "full":
            return [*back, dd.Displacement("bottom"), dd.Displacement("top", value=moved)]
        in_plane = [dd.Displacement("bottom", (0.0, 0.0), (0, 1)), dd.Displacement("top", moved[:2], (0, 1))]
        return [*in_plane, *back, *(_lower_edges(domain, moved[2]) if moved[2] or not back else ())]

    def top_force(self, solution: dd.Solution) -> float:
        """Force in N along which the top side moves, that of its support; collective."""
        return float(solution.reaction("top")[LOADS[self.load].axis])

    @property
    def bends(self) -> tuple[int, ...]:
        """The axes across which the sheet may bend."""
        return (0, 1) if self.flat or self.kinematics == "small" else (0, 1, 2)

    @property
    def trilinear(self) -> bool:
        """Whether its elements are the plain ones of degree 1."""
        return self.degree == 1 and self.element == "trilinear"

    def parameters(self) -> dict[str, object]:
        """For the summary; the element that is taken, None if of degree 2, and what is taken where nothing is said."""
        edges = self.kind != "bulk" if self.edges is None else self.edges
        element = (self.element or ELEMENTS[0]) if self.degree == 1 else None
        graded = self.graded
        if graded is None:
            box = self.elements
            graded = box is not None and graded_by_default(box, degree=self.degree, element=self.element)
        return asdict(self) | {"element": element, "edges": edges, "graded": graded}


def _lower_edges(domain: dd.TaggedMesh, moved: float) -> list[dd.Displacement]:
    """Bottom held, top ``moved`` (m) across the plane where z is least; they leave their thickness free."""
    back, front = _extent(domain, 2)

    def lower(x: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(x[:, 2] < back + 1e-6 * (front - back))

    return [dd.Displacement(side, (z,), (2,), where=lower) for side, z in (("bottom", 0.0), ("top", moved))]


def _check_place(domain: dd.TaggedMesh, side: str, low: float, high: float) -> None:
    """Raise InputError where a side is not across y at its end of the body from ``low`` to ``high``; collective.

    Its facets must lie, in the mean, in the outer quarter of the body, and rise along y less than a third of their
    width.
    """
    least, most, middle = domain.extent(side)
    width, mean = most - least, (middle[1] - low) / (high - low)
    if (mean if side == "bottom" else 1.0 - mean) > 0.25 or 3.0 * width[1] > max(width[0], width[2]):
        raise InputError(
            f"mesh: expected the side called {side} across y, at the {'least' if side == 'bottom' else 'largest'} y of "
            f"the body, where a stretch or shear needs it; got it at {mean:.0%} of the height, {width[0]:.3g} x "
            f"{width[1]:.3g} x {width[2]:.3g} m: turn the mesh, or name its sides anew"
        )


def _extent(domain: dd.TaggedMesh, axis: int) -> tuple[float, float]:
    """Least and largest coordinate of the mesh along ``axis``, m; collective."""
    low, high = span(domain.comm, domain.mesh.geometry.x[:, axis])
    return float(low), float(high)


def read_material(data: Path, scene: Scene, stress_measure: str | None = None) -> Dataset:
    """The data as the kinematics of the scene and the measure want them, with the unstrained state of their RVEs.

    Raises:
        InputError: the file is not valid, or its data do not reach the nominal strain of the scene; those that were
            adapted to this load, up to this strain or more, hold what its scene needs, whatever their range.
    """
    dataset = dd.THEORIES[scene.kinematics].dataset(read_dataset(data), stress_measure)
    for source in dataset.sources:
        made_for = source.get("adapted")
        if isinstance(made_for, dict) and made_for["load"] == scene.load and 0 < scene.strain / made_for["strain"] <= 1:
            return dataset
    i, j = ("xyz".index(axis) for axis in LOADS[scene.load].component)
    values = from_mandel(dataset.strain)[:, i, j]
    check_reach(scene.load, scene.strain, float(values.min()), float(values.max()))
    return dataset


def tissue_of(dataset: Dataset | None) -> Tissue | None:
    """The first tissue that the data are from; None of measured data."""
    specs = () if dataset is None else RVESpec.of(dataset)
    return specs[0].tissue if specs else None
