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
from tsg_micro.data.dataset import Dataset, read_dataset, take, write_dataset
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from workflows.runs.fe2 import MEASURE
from workflows.runs.loads import check_load
from workflows.runs.scene import Scene, read_material
from workflows.store.record import write_summary, write_table
from workflows.store.stages import Stages
from workflows.studies.fe2_reference import Exact, box_states, read_exact
from workflows.studies.methods import named
from workflows.studies.prerequisites import Chain

__all__ = ["ADAPTIVE", "BUDGETS", "data_error", "fitted_slope", "mean_errors", "states_needed"]

_METHODS = ("classical", "second order", "second order, estimated tangents")
SIX, ADAPTIVE = "all strains that FE2 visits, at random", "adaptive, from nothing"
BUDGETS = (4, 8, 16, 32, 64, 128, 256, 400)
TARGETS = (0.02, 0.01, 0.005)
_ABOVE = 1.5
"""Errors are fitted where they are at least as many times their floor."""
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
    scene = Scene(load, chain.strain, elements=chain.elements, kinematics=kinematics)
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
    fits = _fits(rows, exact.symbol, {name for name, one in sources.items() if _under_plane_stress(one)})
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
        figures={
            "symbol": (exact.symbol, ""),
            "box": ({"lowest": exact.strain.min(axis=0), "highest": exact.strain.max(axis=0)}, "1, Mandel"),
            "box_failed": (sources[SIX].parameters["failed"], "strains without equilibrium"),
            "fits": (fits, "slope of log error over log number of states; error at most, and states for it"),
            "slope_ratio": (_ratios(fits), "second order over classical"),
            "random_over_adaptive": (_savings(fits), "states for the same error"),
            "error_with_400": (_at(rows, exact.symbol, 400), "1"),
            "rows": (rows, ""),
        },
    )
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.data_error_figure import plot_data_error

        save_figure(plot_data_error(summary), out / "data_error.png")
    return summary


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


def _fits(rows: list[dict[str, Any]], symbol: str, floors: set[str]) -> list[dict[str, Any]]:
    """Slope of every source and method, and the states that it needs for each of the targets.

    The floor of a source, where it has one, is the least error of the method, of all methods for the classical one.
    """
    fits = []
    for source, method in dict.fromkeys((row["source"], row["method"]) for row in rows):
        most = max(row["states"] for row in rows if row["source"] == source)
        fit: dict[str, Any] = {"source": source, "method": method, "states": most}
        for name in (symbol, "state"):
            sizes, errors = mean_errors(rows, source, method, name)
            alike = {row["method"] for row in rows} if method == "classical" else {method}
            below = [r[name] for r in rows if r["source"] == source and r["method"] in alike and r[name] is not None]
            floor = min(below, default=0.0) if source in floors else 0.0
            slope, at_one = fitted_slope(sizes, errors, floor=floor)
            fit[f"slope_{name}"], fit[f"at_one_{name}"] = slope, at_one
            fit[f"least_{name}"] = float(errors.min()) if len(errors) else None
            fit[f"needed_{name}"] = {f"{target:g}": states_needed(sizes, errors, target) for target in TARGETS}
        fits.append(fit)
    return fits


def mean_errors(rows: list[dict[str, Any]], source: str, method: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of states, and geometric means over the draws of the error ``name``; solves that failed are left out."""
    own = [row for row in rows if (row["source"], row["method"]) == (source, method) and row[name] is not None]
    sizes = sorted({row["states"] for row in own})
    logs = [np.mean([np.log(row[name]) for row in own if row["states"] == size]) for size in sizes]
    return np.array(sizes, dtype=float), np.exp(logs)


def fitted_slope(sizes: np.ndarray, errors: np.ndarray, *, floor: float) -> tuple[float | None, float | None]:
    """Slope of log error over log number of states by least squares, and the error that the line has at one state.

    The ``floor`` is taken off the squares, and errors near it do not count. None of less than three.
    """
    used = errors > _ABOVE * floor
    if used.sum() < 3:
        return None, None
    slope, level = np.polyfit(np.log(sizes[used]), 0.5 * np.log(errors[used] ** 2 - floor**2), 1)
    return float(slope), float(np.exp(level))


def states_needed(sizes: np.ndarray, errors: np.ndarray, target: float) -> float | None:
    """The number of states from which on the error is ``target`` or less, on straight lines in the logarithms.

    The smallest number there is if all of them reach it; None if the largest does not.
    """
    above = np.flatnonzero(errors > target)
    if len(above) == 0:
        return float(sizes[0]) if len(sizes) else None
    k = above[-1]
    if k == len(errors) - 1:
        return None
    part = np.log(errors[k] / target) / np.log(errors[k] / errors[k + 1])
    return float(sizes[k] * (sizes[k + 1] / sizes[k]) ** part)


def _ratios(fits: list[dict[str, Any]]) -> dict[str, dict[str, float | None]]:
    """Slope of second-order over that of classical data, for every source with both."""
    slopes = {(fit["source"], fit["method"]): fit for fit in fits}
    ratios: dict[str, dict[str, float | None]] = {}
    for source in dict.fromkeys(fit["source"] for fit in fits if fit["source"] != ADAPTIVE):
        one, two = (slopes[source, name] for name in ("classical", "second order"))
        names = [name for name in one if name.startswith("slope_")]
        ratios[source] = {n[6:]: None if None in (one[n], two[n]) else two[n] / one[n] for n in names}
    return ratios


def _savings(fits: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """How many ``times`` the states of adaptive data others need, for every target that adaptive data reach.

    None where they never reach it; ``at_least`` is what they had, all in vain.
    """
    adaptive = next(fit for fit in fits if fit["source"] == ADAPTIVE)
    rows = []
    for fit in (fit for fit in fits if fit["source"] != ADAPTIVE):
        for name in [key[7:] for key in fit if key.startswith("needed_")]:
            for target, needed in adaptive[f"needed_{name}"].items():
                if needed is not None:
                    theirs, most = fit[f"needed_{name}"][target], fit["states"]
                    times = {
                        "times": None if theirs is None else theirs / needed,
                        "at_least": (theirs or most) / needed,
                    }
                    named = {"source": fit["source"], "method": fit["method"], "error": name, "target": float(target)}
                    rows.append(named | times)
    return rows


def _at(rows: list[dict[str, Any]], symbol: str, count: int) -> list[dict[str, Any]]:
    """Errors with ``count`` states, on straight lines in the logarithms."""
    found = []
    for source, method in dict.fromkeys((row["source"], row["method"]) for row in rows):
        row: dict[str, Any] = {"source": source, "method": method}
        for name in (symbol, "state"):
            sizes, errors = mean_errors(rows, source, method, name)
            inside = len(sizes) > 0 and sizes[0] <= count <= sizes[-1]
            row[name] = float(np.exp(np.interp(np.log(count), np.log(sizes), np.log(errors)))) if inside else None
        found.append(row)
    return found
