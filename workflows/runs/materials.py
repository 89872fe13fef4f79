"""What answers a strain in each tissue of a scene: data from files, RVEs that are computed, laws."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dd_macro as dd
from dd_macro.material.regional import RegionalLaw
from dd_macro.methods.metric_choice import check_metric
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.graded_source import GradedSource
from tsg_micro.continuum.rve_law import FOLLOW, RVELaw
from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.errors import InputError
from workflows.runs.adaptation import rve_of
from workflows.runs.edges import data_of, in_parts, inside_of, sampled_places
from workflows.runs.rest import with_rest
from workflows.scenes.model import TissueModel
from workflows.scenes.scene import Built
from workflows.store.record import versions

__all__ = [
    "METHOD_NAMES",
    "TissueData",
    "method_of",
    "point_bar_forces",
    "read_tissues",
    "scene_sources",
    "the_material",
]

METHOD_NAMES = {"points": "classical", "tangents": "second order"}
"""Short names of methods in scene files."""
Array = NDArray[np.float64]
Keep = Callable[[dd.Place], bool]


@dataclass(frozen=True)
class TissueData:
    """What is known of a tissue before the mesh is: the RVE of its inside, None of measured data, and its data."""

    rve: RVESpec | None
    dataset: Dataset | None

    def keep(self, *, computed: bool) -> Keep:
        """Whether its edges can be another material at a place: where RVEs are ``computed``, or the data hold some.

        No RVE is strained at a corner where all axes are free.
        """
        rve = self.rve
        if rve is None:
            return lambda place: True
        if computed or self.dataset is None:
            return lambda place: any(face != "free" for face, _ in rve.at(place).faces)
        return sampled_places(rve, self.dataset)


def method_of(built: Built) -> dd.Method:
    """The method of the scene with its numbers.

    Raises:
        InputError: there is no such method, or it has no such number.
    """
    solve = built.model.solve
    try:
        check_metric(solve.metric)
    except InputError as error:
        raise InputError(f"solve.{error}") from None
    name = METHOD_NAMES.get(solve.method, solve.method)
    if name not in dd.METHODS:
        raise InputError(
            f"solve.method: expected one of {'; '.join([*METHOD_NAMES, *dd.METHODS])}, got {solve.method!r}"
        )
    method = dd.METHODS[name]
    if isinstance(method, dd.AdaptiveMethod):
        plan = method.plan
        budget, tolerance = solve.budget or plan.budget, solve.tolerance or plan.tolerance
        method = replace(method, plan=replace(plan, budget=budget, tolerance=tolerance))
    elif solve.budget or solve.tolerance:
        raise InputError(f"solve.budget, tolerance: expected with method adaptive alone, got {solve.method!r}")
    if solve.kinematics not in method.theories:
        raise InputError(f"solve.method: expected one that knows {solve.kinematics} strain, got {solve.method!r}")
    return method.tuned(max_iterations=solve.max_iterations)


def read_tissues(built: Built, method: dd.Method) -> list[TissueData]:
    """What is known of every tissue, in the order of the file.

    Raises:
        InputError: a file is not valid, or not what the tissue or the method needs.
    """
    found = []
    for name, tissue, kind in zip(built.names, built.tissues, built.kinds, strict=True):
        model = built.model.tissue[name]
        try:
            found.append(_read(built, method, model, tissue, kind))
        except InputError as error:
            raise InputError(f"tissue.{name}: {error}") from None
    if len({one.dataset is None for one in found}) > 1 and not isinstance(method, dd.AdaptiveMethod):
        raise InputError("tissue: expected data of every tissue, got none of some")
    return found


def _read(built: Built, method: dd.Method, model: TissueModel, tissue: Tissue, kind: str) -> TissueData:
    raw = None if model.data is None else read_dataset(model.data)
    needed = not isinstance(method, dd.AdaptiveMethod) and not _is_fe2(method)
    if raw is None:
        if needed:
            raise InputError(f"data: expected a file for method {built.model.solve.method!r}, got none")
        return TissueData(RVESpec.of_kind(kind, tissue), None)
    dataset = dd.THEORIES[built.model.solve.kinematics].dataset(raw, None)
    if needed:
        _check_force(dataset, model, tissue)
        return TissueData(inside_of(dataset, model.kind), with_rest(dataset))
    given = tissue if model.bar_force is not None or model.file is not None else None
    return TissueData(rve_of(given, raw, model.kind), dataset)


def _check_force(dataset: Dataset, model: TissueModel, tissue: Tissue) -> None:
    """Raise InputError where the data are of another tissue than the file says."""
    if model.bar_force is None and model.file is None:
        return
    for spec in RVESpec.of(dataset):
        if spec.tissue != tissue:
            raise InputError(f"data: expected those of the tissue that is given, {tissue}, got {spec.tissue}")


def _is_fe2(method: dd.Method) -> bool:
    return isinstance(method, dd.LawMethod) and method.fit is None


def the_material(built: Built, method: dd.Method, known: Sequence[TissueData], problem: dd.Problem) -> dd.Material:
    """One material of all regions of the problem."""
    places, tissues = _regions(problem)
    theory = dd.THEORIES[built.model.solve.kinematics]
    parts: list[dd.Material] = []
    for number, one in enumerate(known):
        own = [place for place, tissue in zip(places, tissues, strict=True) if tissue == number]
        metric: Any = built.model.solve.metric
        if one.rve is None:
            parts += [dd.Material(one.dataset, metric, measure=theory.solved(None))] * len(own)
            continue
        specs, force = [one.rve.at(place) for place in own], built.bar_force if built.varies(number) else None
        for spec, data in zip(specs, data_of(one.dataset, specs), strict=True):
            part = dd.Material(data, metric, measure=theory.solved(None), bar_force=force)
            if _is_fe2(method):
                part = replace(part, law=_law(spec, part, problem, len(parts)))
            if isinstance(method, dd.AdaptiveMethod):
                part = replace(part, source=_source(spec, problem, varies=force is not None))
            parts.append(part)
    return in_parts(parts)


def point_bar_forces(built: Built, problem: dd.Problem) -> Array:
    """f_b (n,) in N at the points, 0 where it is one in their tissue."""
    varies = np.array([built.varies(number) for number in range(len(built.names))])
    force = np.where(varies[built.cell_tissue], built.bar_force, 0.0)
    return np.repeat(force, problem.operator.points_per_cell)


def scene_sources(built: Built, known: Sequence[TissueData], problem: dd.Problem) -> list[dd.Source] | None:
    """RVEs of every region of the problem; None where some tissue is of measured data."""
    places, tissues = _regions(problem)
    found: list[dd.Source] = []
    for place, number in zip(places, tissues, strict=True):
        rve = known[number].rve
        if rve is None:
            return None
        found.append(_source(rve.at(place), problem, varies=built.varies(number)))
    return found


def _regions(problem: dd.Problem) -> tuple[Sequence[dd.Place], Sequence[int]]:
    """Place and number of the tissue of every region."""
    regions = problem.regions
    return ((dd.INSIDE,), (0,)) if regions is None else (regions.places, regions.tissues)


def _law(spec: RVESpec, part: dd.Material, problem: dd.Problem, number: int) -> dd.Law:
    """An RVE at every point of the region, of the point's own bar force."""
    force = part.bar_forces(problem, number)
    if force is None:
        return RVELaw(spec.build(), follow=FOLLOW)
    values, which = np.unique(force, return_inverse=True)
    return RegionalLaw([RVELaw(spec.with_bar_force(value).build(), follow=FOLLOW) for value in values], which)


def _source(spec: RVESpec, problem: dd.Problem, *, varies: bool) -> dd.Source:
    kind = GradedSource if varies else RVESource
    made_for = {"adapted": {"load": "scene", "strain": 1.0}}
    return kind(spec, comm=problem.operator.comm, parameters=made_for, versions=versions())
