"""What an adaptive run computes: the plan that the command line asks for, and the RVE that its data are of."""

from __future__ import annotations

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError
from workflows.runs.edges import inside_of
from workflows.runs.scene import Scene
from workflows.store.record import versions

__all__ = ["adaptation", "rve_of", "source_for"]


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


def rve_of(tissue: Tissue | None, dataset: Dataset | None, kind: str | None = None) -> RVESpec:
    """The RVE of the inside: that of the data, which ``tissue`` must agree with, or one block of ``tissue``.

    ``kind`` is that of the tissue; None is a sheet where there are no data.

    Raises:
        InputError: there is none, or the data have another tissue, several, no tangents or another kind of RVE.
    """
    specs, inside = () if dataset is None else RVESpec.of(dataset), inside_of(dataset, kind)
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
        if inside is not None and not spec.is_edge_of(inside):
            raise InputError(f"data: expected RVEs of one kind for --adapt, got {inside} and {spec}")
    if wanted is None:
        why = "there are no data" if dataset is None else "the data do not say"
        raise InputError(f"bar_force: expected a force in N, since {why}, got none")
    return inside or RVESpec.of_kind(kind or "sheet", wanted)


def source_for(scene: Scene, spec: RVESpec, problem: dd.Problem) -> RVESource:
    """The RVEs of a run of ``scene``, shared among the ranks of its mesh; their data say what they were made for."""
    made_for = {"adapted": {"load": scene.load, "strain": scene.strain}}
    return RVESource(spec, comm=problem.operator.comm, parameters=made_for, versions=versions())
