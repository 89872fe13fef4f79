"""tsgdd study sampling: what the material data cover, and where the macroscopic solution goes (paper, Section 4.2).

For each load: p-q paths, coverage of the strain box that was sampled, and the states of a data-driven solution drawn
over the data, in strain and in stress.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.sampling import BOXES
from tsg_micro.data.dataset import Dataset, convert_dataset
from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from tsg_micro.data.mandel import COMPONENTS, pressure, von_mises
from workflows.runs.loads import LOADS
from workflows.runs.sample import sample
from workflows.runs.sample_plan import Plan
from workflows.store.record import peak_memory, read_summary, write_summary
from workflows.studies.coverage import FEWEST, box_coverage, box_strain, visited_states

__all__ = ["study_sampling"]

Array = NDArray[np.float64]
STRAIN = 0.05


def study_sampling(
    out: Path,
    *,
    load: str | None = None,
    data: Path | None = None,
    dd: Path | None = None,
    paths: int = 1000,
    steps: int = 10,
    tissue: Tissue = Tissue(),
    seed: int = 0,
    elements: tuple[int, int] = (30, 15),
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Coverage of the data, and the states that a data-driven solution visits, for ``load`` or for both loads.

    ``data`` is a data set, ``dd`` a folder made by 'tsgdd solve' with these data; what is not given is made here, in
    ``out``: ``paths`` paths of ``steps`` points through an RVE of ``tissue``, and a sheet of ``elements`` under 5 %
    strain. Without ``load`` it is that of the given files, or both where none is given.

    Raises:
        InputError: an argument or a file is not valid, or the solution in ``dd`` is not one with these data.
        ConvergenceError: the data-driven solve did not converge.
    """
    if load is not None and load not in LOADS:
        raise InputError(f"load: expected {' or '.join(LOADS)}, got {load!r}")
    if min(elements) < 1:
        raise InputError(f"elements: expected at least 1 along x and y, got {elements[0]} {elements[1]}")
    solved, given, loads = _inputs(load, data, dd, paths * steps)
    data = Path(solved["parameters"]["data"]) if solved is not None and data is None else data
    load = loads[0] if load is None and (given is not None or solved is not None) else load
    for name in loads:
        Plan(name, paths, steps, seed, tissue)
    out = output_folder(out)
    begin = time.perf_counter()
    figures: dict[str, tuple[Any, str]] = {}
    drawn = {}
    for name in loads:
        file = data or out / f"data-{name}.h5"
        if given is None:
            say(f"{name}: sampling {paths} paths of {steps} points")
            sample(file, load=name, paths=paths, steps=steps, tissue=tissue, seed=seed, plots=plots)
        folder = dd or out / f"dd-{name}"
        if dd is None:
            _solve(folder, file, name, elements, plots, say)
        study = _Study(name, given or read_dataset(file), folder)
        figures |= study.figures()
        drawn[name] = study
        say(study.sentence())
    summary = write_summary(
        out,
        command="study sampling",
        parameters={
            "load": load,
            "data": data,
            "dd": dd,
            **(
                {"paths": paths, "steps": steps, "bar_force": tissue.bar_force, "seed": seed}
                if given is None
                else {name: given.parameters.get(name) for name in ("paths", "steps", "bar_force", "seed")}
            ),
            "elements": (*elements, 1) if solved is None else solved["parameters"]["elements"],
            "strain": STRAIN if solved is None else solved["parameters"]["strain"],
        },
        figures={
            "loads": (loads, ""),
            **figures,
            "peak_memory": (peak_memory(), "B"),
            "seconds": (time.perf_counter() - begin, "s"),
        },
    )
    if plots:
        _draw(out, drawn)
    return summary


def _inputs(
    load: str | None, data: Path | None, dd: Path | None, points: int
) -> tuple[dict[str, Any] | None, Dataset | None, list[str]]:
    """Summary of the solution and the data that are given, and the loads to study; ``points`` would be sampled."""
    solved = None if dd is None else read_summary(dd, "solve")
    if solved is not None:
        data = data or Path(solved["parameters"]["data"])
        load = load or solved["parameters"]["load"]
    given = None if data is None else read_dataset(data)
    if given is not None:
        sampled = given.parameters.get("load")
        load = load or sampled
        if load not in LOADS or (sampled in LOADS and sampled != load):
            wanted = " or ".join(LOADS) if load not in LOADS else load
            raise InputError(f"load: expected {wanted}, the data in {data} were sampled for {sampled!r}")
    points = points if given is None else len(given)
    if points < FEWEST:
        raise InputError(f"data: expected at least {FEWEST} points to tell how they cover the box, got {points}")
    loads = [load] if load else list(LOADS)
    if solved is not None and solved["parameters"]["load"] != load:
        raise InputError(f"dd: expected a solution under {load}, got {solved['parameters']['load']} in {dd}")
    return solved, given, loads


def _solve(
    folder: Path, file: Path, load: str, elements: tuple[int, int], plots: bool, say: Callable[[str], None]
) -> None:
    """A data-driven solution with the data of ``file``."""
    from workflows.runs.scene import Scene
    from workflows.runs.solve import solve

    say(f"{load}: data-driven solve on {elements[0]} x {elements[1]} x 1 elements, {STRAIN:.0%} strain")
    solve(
        folder, data=file, scene=Scene(load, STRAIN, elements=(*elements, 1), element="trilinear"), plots=plots, say=say
    )


class _Study:
    """One load: its data, the solution with them, and what both come to."""

    def __init__(self, load: str, dataset: Dataset, folder: Path) -> None:
        from dd_macro.results.quadrature_file import read_quadrature

        self.load = load
        self.fields = read_quadrature(folder / "quadrature.h5")
        self.dataset = convert_dataset(dataset, self.fields.stress_measure)
        self.visited = visited_states(self.fields, self.dataset, load)
        self.coverage = box_coverage(box_strain(dataset.strain, load))

    def figures(self) -> dict[str, tuple[Any, str]]:
        """Figures and units for the summary, their names led by the load."""
        cover, visited = self.coverage, self.visited
        named = {
            "points": (len(self.dataset), ""),
            "points_outside_box": (cover.outside, ""),
            "fill_distance": (cover.fill_distance, "box side"),
            "mean_gap": (cover.mean_gap, "box side"),
            "mean_neighbour": (cover.mean_neighbour, "box side"),
            "mean_neighbour_over_random": (2.0 * cover.mean_neighbour * np.sqrt(len(self.dataset)), "1"),
            "counts_min_mean_max": ([cover.counts.min(), cover.counts.mean(), cover.counts.max()], "points a cell"),
            "subset_sizes": (cover.sizes, ""),
            "fill_distance_by_size": (cover.fill_by_size, "box side"),
            "mean_gap_by_size": (cover.gap_by_size, "box side"),
            "fill_distance_slope": (cover.slope(cover.fill_by_size), "1"),
            "mean_gap_slope": (cover.slope(cover.gap_by_size), "1"),
            "normalised_distance": (self.fields.normalised_distance, "1"),
            "quadrature_points": (self.fields.datum.size, ""),
            "share_of_data_used": (visited.share_used, "1"),
            "outside_box": (visited.outside_box, "fraction of volume"),
            "outside_range": (_by_component(visited.outside_range), "fraction of volume"),
            "strain_rms": ({name: _by_component(v) for name, v in visited.rms.items()}, "1, Mandel"),
            "stress_rms": ({name: _by_component(v) for name, v in visited.rms_stress.items()}, "Pa, Mandel"),
            "strain_not_spanned": (visited.unspanned, "fraction of mean square"),
        }
        return {f"{self.load}_{name}": value for name, value in named.items()}

    def sentence(self) -> str:
        """The figures that a person wants to see."""
        cover, visited = self.coverage, self.visited
        return (
            f"{self.load}: {len(self.dataset)} data leave gaps of at most {cover.fill_distance:.1%} of a box side "
            f"(slope {cover.slope(cover.fill_by_size):.2f}); the solution uses {visited.share_used:.1%} of them, "
            f"{visited.outside_box:.1%} of its volume is outside the sampled box, {visited.unspanned:.1%} of its mean "
            f"square strain is in components that the data do not have"
        )


def _by_component(values: Array) -> dict[str, float]:
    return dict(zip(COMPONENTS, values.tolist(), strict=True))


def _draw(out: Path, studies: dict[str, _Study]) -> None:
    """The figures."""
    from tsg_micro.data.figure_style import save_figure
    from workflows.studies import sampling_figures as plot

    save_figure(plot.plot_paths({load: study.dataset for load, study in studies.items()}), out / "pq_paths.png")
    for load, study in studies.items():
        figure = plot.plot_coverage(study.dataset.strain, BOXES[load], study.coverage)
        save_figure(figure, out / f"coverage_{load}.png")
        fields = study.fields
        states = {
            "mechanical": (fields.mechanical_strain.reshape(-1, 6), fields.mechanical_stress.reshape(-1, 6)),
            "material": (fields.material_strain.reshape(-1, 6), fields.material_stress.reshape(-1, 6)),
        }
        invariants = {name: (pressure(stress), von_mises(stress)) for name, (_, stress) in states.items()}
        strains = {name: strain for name, (strain, _) in states.items()}
        data = study.dataset
        figure = plot.plot_visited(
            BOXES[load],
            data=(data.strain, pressure(data.stress), von_mises(data.stress)),
            strains=strains,
            invariants=invariants,
            rms=study.visited.rms,
            rms_stress=study.visited.rms_stress,
            stress_measure=data.stress_measure,
        )
        save_figure(figure, out / f"visited_{load}.png")
