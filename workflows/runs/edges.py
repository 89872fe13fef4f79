"""Which RVE each place of a body is of, and which data: the inside, and the edges at its clamps and free sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

import dd_macro as dd
from tsg_micro.continuum.rve_spec import KINDS, RVESpec
from tsg_micro.data.dataset import Dataset, take
from tsg_micro.data.errors import InputError

__all__ = ["data_of", "in_parts", "inside_of", "sampled_places", "specs_of"]


def inside_of(dataset: Dataset | None, kind: str | None = None) -> RVESpec | None:
    """The RVE of the inside of a body: that of the data with the most periodic axes; None where they do not say.

    Raises:
        InputError: it is of another ``kind`` of tissue, or what the data say is not valid.
    """
    specs = () if dataset is None else RVESpec.of(dataset)
    if not specs:
        return None
    inside = max(specs, key=lambda spec: sum(spec.periodic))
    if kind is not None and inside.periodic != KINDS[kind]:
        there = next((name for name, periodic in KINDS.items() if periodic == inside.periodic), "an edge")
        raise InputError(f"kind: expected that of the data, {there}, got {kind}")
    return inside


def specs_of(inside: RVESpec, problem: dd.Problem) -> tuple[RVESpec, ...]:
    """The RVE of every region of the problem, that of the ``inside`` first."""
    places = (dd.INSIDE,) if problem.regions is None else problem.regions.places
    return tuple(inside.at(place) for place in places)


def sampled_places(inside: RVESpec, dataset: Dataset) -> Callable[[dd.Place], bool]:
    """Whether the data hold some of a place's RVE."""
    there = {spec.faces for spec in RVESpec.of(dataset)}
    return lambda place: inside.at(place).faces in there


def data_of(dataset: Dataset | None, specs: Sequence[RVESpec]) -> list[Dataset | None]:
    """The data of each of the RVEs, that of the inside first, None where there are none.

    Data that are not told apart are of the inside, those of an edge that is not among the RVEs of none.
    """
    if dataset is None or dataset.source is None:
        return [dataset, *(None for _ in specs[1:])]
    faces, inside = [spec.faces for spec in specs], specs[0]
    made = [RVESpec.from_parameters(source) or inside for source in dataset.sources]
    of_run = np.array(
        [faces.index(one.faces) if one.faces in faces else 0 if one.periodic == inside.periodic else -1 for one in made]
    )
    region = of_run[dataset.source]
    return [take(dataset, region == k) if (region == k).any() else None for k in range(len(specs))]


def in_parts(parts: Sequence[dd.Material]) -> dd.Material:
    """One material of the parts of a body, that of the inside first."""
    return replace(parts[0], parts=tuple(parts) if len(parts) > 1 else ())
