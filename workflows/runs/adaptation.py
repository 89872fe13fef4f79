"""What an adaptive run computes: the plan that the command line asks for, and the RVE that its data are of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset import Dataset, take
from tsg_micro.data.errors import InputError
from workflows.runs.scene import Scene
from workflows.store.record import versions

__all__ = ["adaptation", "material_of", "rve_of", "source_for", "specs_of"]


def adaptation(
    wanted: bool, *, tissue: Tissue | None, rve_budget: int | None, adapt_tolerance: float | None
) -> dd.Adaptation | None:
    """What the command line's options ask for, None where they do not ask for it; None takes a default value.

    Raises:
        InputError: a value is out of range, or given although adaptation is not wanted.
    """
    given = {"budget": rve_budget, "tolerance": adapt_tolerance}
    given = {name: value for name, value in given.items() if value is not None}
    if wanted:
        return dd.Adaptation(**given)  # type: ignore[arg-type]
    if given or tissue is not None:
        raise InputError("bar_force, rve_budget, adapt_tolerance: expected --adapt with them, got none")
    return None


def rve_of(tissue: Tissue | None, dataset: Dataset | None) -> RVESpec:
    """The RVE to compute: that of the data, which ``tissue`` must agree with, or one block of a sheet of ``tissue``.

    Raises:
        InputError: there is none, or the data have another tissue, several, no tangents or another kind of RVE.
    """
    specs = () if dataset is None else RVESpec.of(dataset)
    if dataset is not None and dataset.tangent is None:
        raise InputError("data: expected tangents for --adapt, got none")
    wanted = tissue
    for spec in specs:
        there = spec.tissue
        wanted = there if wanted is None else wanted
        if there.bar_force != wanted.bar_force:
            raise InputError(f"bar_force: expected that of the data, {there.bar_force} N, got {wanted.bar_force}")
        if there != wanted:
            raise InputError(f"tissue: expected that of the data, {there}, got {wanted}")
        if spec.images != "merged":
            raise InputError(f"data: expected RVEs with merged images for --adapt, got {spec.images}")
        if spec.periodic != specs[0].periodic:
            raise InputError(f"data: expected RVEs of one kind for --adapt, got {specs[0]} and {spec}")
    if wanted is None:
        why = "there are no data" if dataset is None else "the data do not say"
        raise InputError(f"bar_force: expected a force in N, since {why}, got none")
    return specs[0] if specs else RVESpec(wanted)


def source_for(scene: Scene, spec: RVESpec, problem: dd.Problem) -> RVESource:
    """The RVEs of a run of ``scene``, shared among the ranks of its mesh; their data say what they were made for."""
    made_for = {"adapted": {"load": scene.load, "strain": scene.strain}}
    return RVESource(spec, comm=problem.operator.comm, parameters=made_for, versions=versions())


def specs_of(spec: RVESpec, problem: dd.Problem) -> tuple[RVESpec, ...]:
    """The RVE of every region of the problem, that of the inside first."""
    places = (dd.INSIDE,) if problem.regions is None else problem.regions.places
    return tuple(spec.at(place) for place in places)


def material_of(
    scene: Scene, spec: RVESpec, problem: dd.Problem, dataset: Dataset | None, *, metric: str, measure: str | None
) -> dd.Material:
    """Sources of data for every region, and of the ``dataset`` what is of its RVE."""
    specs = specs_of(spec, problem)
    parts = [
        dd.Material(given, metric, source=source_for(scene, one, problem), measure=measure)
        for one, given in zip(specs, split(dataset, specs), strict=True)
    ]
    return replace(parts[0], parts=tuple(parts) if len(parts) > 1 else ())


def split(dataset: Dataset | None, specs: tuple[RVESpec, ...]) -> list[Dataset | None]:
    """The data of each of the RVEs, None where there are none; data that are not told apart are of the first one."""
    if dataset is None or dataset.source is None or len(specs) == 1:
        return [dataset, *(None for _ in specs[1:])]
    axes = [(spec.periodic, spec.held) for spec in specs]
    made = [RVESpec.from_parameters(source) for source in dataset.sources]
    of_run = np.array([axes.index((m.periodic, m.held)) if m and (m.periodic, m.held) in axes else 0 for m in made])
    region = of_run[dataset.source]
    return [take(dataset, region == k) if (region == k).any() else None for k in range(len(specs))]
