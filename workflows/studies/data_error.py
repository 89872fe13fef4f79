"""tsgdd study data-error: what the data alone leave of error, against FE2 of the same scene and kinematics.

FE2 has an RVE at every quadrature point, so no data error. Ways to choose RVE states are held against it: a box of
in-plane strains and one of all six, sampled along paths before anything is known of the scene; the box of the strains
that FE2 visits, filled at random, which takes the solution to know; and adaptive sampling, from nothing. Data under
plane stress lack the states of a clamped edge and have a floor, the others do not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.dataset import Dataset, take
from tsg_micro.data.dataset_file import read_dataset, write_dataset
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from workflows.runs.fe2 import MEASURE
from workflows.runs.loads import check_load
from workflows.runs.scene import Scene, read_material
from workflows.store.record import write_summary, write_table
from workflows.store.stages import Stages
from workflows.studies.data_error_fits import ADAPTIVE, errors_at, fits, ratios, savings
from workflows.studies.fe2_reference import Exact, box_states, read_exact
from workflows.studies.methods import named
from workflows.studies.prerequisites import Chain

__all__ = ["BUDGETS", "SIX", "data_error"]

_METHODS = ("classical", "second order", "second order, estimated tangents")
SIX = "all strains that FE2 visits, at random"
BUDGETS = (4, 8, 16, 32, 64, 128, 256, 400)
_LEAST = 16


def data_error(
    out: Path,
    *,
    load: str,
    chain: Chain,
    fe2: Path | None = None,
    data: Sequence[Path] = (),
    states: int = 2048,
    draws: int = 3,
    budgets: Sequence[int] = BUDGETS,
    kinematics: str = "small",
    plots: bool = True,
    stages: Stages | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Errors of p, q and of the state against FE2, by the number of RVE states; data_error.csv has every solve.

    Args:
        out: folder of the results.
        load: stretch or shear.
        chain: scene and bar force, and the paths of what is sampled.
        fe2: folder of ``tsgdd fe2``; a stage if None.
        data: files of ``tsgdd sample``; the boxes inplane and full are sampled if there are none.
        states: random RVE states in the box of the strains that FE2 visits.
        draws: random draws of every number of data below the largest.
        budgets: RVE states of the adaptive runs.
        kinematics: of FE2 and of the solves, small or finite.
        plots: whether to draw the figure.
        stages: where stages are; in ``out`` if None.
        say: gets a line a solve.

    Raises:
        InputError: an argument or a file is not valid.
        ConvergenceError: a stage did not converge.
    """
    check_load(load, chain.strain)
    if states < 2 * _LEAST or draws < 1 or not budgets or min(budgets) < 1:
        raise InputError(
            f"states, draws, budgets: expected at least {2 * _LEAST}, 1 and 1, got {states}, {draws}, {list(budgets)}"
        )
    scene = chain.scene(load, kinematics=kinematics)
    sources = _sources(data, scene, chain)
    given = None if fe2 is None else read_exact(fe2, scene, chain.tissue)
    stages = stages or Stages(output_folder(out), say)
    fe2 = fe2 or chain.fe2(stages, scene, say)
    exact = given or read_exact(fe2, scene, chain.tissue)
    if not data:
        data = [chain.data(stages, box) for box in ("inplane", "full")]
        sources = _sources(data, scene, chain)
    sources = {SIX: _box(stages, exact, chain, states), **sources}
    rows: list[dict[str, Any]] = []
    for row in _rows(exact, sources, draws, budgets, chain.tissue):
        rows.append(row)
        shown = row["reason"] if row["state"] is None else f"{exact.symbol} {row[exact.symbol]:.2%}"
        say(f"{row['source']}, {row['method']}, {row['states']} states: {shown}, state {row['state'] or 0:.2%}")
        write_table(out / "data_error.csv", rows)
    summary = write_summary(
        out,
        command="study data-error",
        parameters={
            "load": load,
            **chain.parameters(),
            "fe2": fe2,
            "data": list(map(str, data)),
            "kinematics": kinematics,
            "states": states,
            "draws": draws,
            "budgets": list(budgets),
        },
        figures=_figures(exact, sources, rows),
    )
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.data_error_figure import plot_data_error

        save_figure(plot_data_error(summary), out / "data_error.png")
    return summary


def _figures(exact: Exact, sources: dict[str, Dataset], rows: list[dict[str, Any]]) -> dict[str, tuple[Any, str]]:
    fitted = fits(rows, exact.symbol, {name for name, one in sources.items() if _under_plane_stress(one)})
    return {
        "symbol": (exact.symbol, ""),
        "box": ({"lowest": exact.strain.min(axis=0), "highest": exact.strain.max(axis=0)}, "1, Mandel"),
        "box_failed": (sources[SIX].parameters["failed"], "strains without equilibrium"),
        "fits": (fitted, "slope of log error over log number of states; error at most, and states for it"),
        "slope_ratio": (ratios(fitted), "second order over classical"),
        "random_over_adaptive": (savings(fitted), "states for the same error"),
        "error_with_400": (errors_at(rows, exact.symbol, 400), "1"),
        "rows": (rows, ""),
    }


def _box(stages: Stages, exact: Exact, chain: Chain, states: int) -> Dataset:
    """Random states of all six strains, a stage."""
    low, high = exact.strain.min(axis=0), exact.strain.max(axis=0)
    box: dict[str, Any] = {"low": low, "high": high, "states": states, "seed": chain.seed}

    def make(out: Path) -> None:
        write_dataset(out / "data.h5", box_states(**box, tissue=chain.tissue))

    folder = stages.run(f"six-strains-{exact.scene.load}", {**box, "bar_force": chain.bar_force}, make)
    found = read_dataset(folder / "data.h5")  # made for this scene, whatever its nominal strain
    return dd.THEORIES[exact.scene.kinematics].dataset(found, None)


def _sources(files: Sequence[Path], scene: Scene, chain: Chain) -> dict[str, Dataset]:
    """The data of the files, in the stress measure of FE2, by where they are from."""
    sources: dict[str, Dataset] = {}
    for file in files:
        dataset = read_material(file, scene, MEASURE)
        chain.check_bar_force(dataset, file)
        if len(dataset) < _LEAST:
            raise InputError(f"data: expected at least {_LEAST} points in {file}, got {len(dataset)}")
        name = f"box {dataset.parameters.get('load', 'of the file')}, along paths"
        alike = sum(known.startswith(name) for known in sources)
        sources[name + f", file {alike + 1}" * (alike > 0)] = dataset
    return sources


def _under_plane_stress(dataset: Dataset) -> bool:
    """Whether components were free, so that the data lack states that a clamped edge has; data that do not say are."""
    return bool(dataset.parameters.get("box", {}).get("free", True))


def _rows(
    exact: Exact, sources: dict[str, Dataset], draws: int, budgets: Sequence[int], tissue: Tissue
) -> Iterator[dict[str, Any]]:
    """One row a solve."""
    for source, dataset in sources.items():
        methods = named(*_METHODS)
        seen = {name: method.given(dataset) for name, method in methods.items()}
        scenes = {name: exact.projection(seen[name], method.order) for name, method in methods.items()}
        sizes = [_LEAST * 2**k for k in range(30) if _LEAST * 2**k < len(dataset)] + [len(dataset)]
        for draw in range(draws):
            order = np.random.default_rng([draw, len(dataset)]).permutation(len(dataset))
            for size in sizes if draw == 0 else sizes[:-1]:
                for name, method in methods.items():
                    few, projection = take(seen[name], order[:size]), scenes[name]
                    row = {"source": source, "method": name, "states": size, "draw": draw}
                    try:
                        result = method.solve(projection, method.search(few, projection.metric))
                    except ConvergenceError as error:
                        yield row | exact.no_errors() | {"iterations": len(error.history), "reason": str(error)}
                        continue
                    yield row | exact.errors(result) | {"iterations": result.iterations, "reason": result.reason}
    for budget in sorted(set(budgets)):
        row = {"source": ADAPTIVE, "method": "second order", "states": budget, "draw": 0}
        try:
            adapted = exact.adapted(tissue, budget)
        except ConvergenceError as error:
            yield row | exact.no_errors() | {"iterations": len(error.history), "reason": str(error)}
            continue
        row |= {"states": adapted.rounds[-1].rves, "iterations": sum(one.iterations for one in adapted.rounds)}
        yield row | exact.errors(adapted) | {"reason": adapted.adapt_reason}
