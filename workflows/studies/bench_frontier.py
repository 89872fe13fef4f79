"""tsgdd bench frontier: run time against error, of all that solves the same scene; the tensegrity is the reference."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.dataset import take
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from workflows.runs.loads import LOADS
from workflows.runs.scene import Scene
from workflows.runs.tensegrity import describe, read_blocks
from workflows.store.record import read_summary, write_summary, write_table
from workflows.studies.fe2_reference import check_fe2, fe2_parameters
from workflows.studies.methods import adaptive, entries
from workflows.studies.one_load import Inputs, Study

__all__ = ["MODELS", "frontier"]

Model = tuple[str, str, bool]
MODELS: dict[str, Model] = {
    "small strain": ("small", "full", False),
    "finite strain": ("finite", "full", False),
    "finite strain, in-plane clamps": ("finite", "inplane", True),
}
"""Macroscopic models: kinematics, clamps, and whether the sheet is held flat, as the tensegrity is.

In small strain a sheet cannot buckle, and where the clamps hold its thickness it does not."""
_BUDGETS = (4, 16, 64, 200)
_REPEATS, _ENOUGH = 3, 10.0
"""Every point is timed as often, unless that takes so many seconds; the shortest time counts."""
_NEAR, _OWN = 0.03, 0.01
"""The quickest point is sought among those so near to the tensegrity, and so near to FE2: not by chance."""


@dataclass(frozen=True)
class _Point:
    """A way to solve the scene: what it took, and how far its p or q is (l2) from the tensegrity's and from FE2's."""

    method: str
    model: str
    data: int
    """Those it was given, or RVEs that it computed."""
    seconds_sampling: float
    """For these data, or RVEs."""
    seconds_solve: float
    """All else that the scene needs: mesh, metric or fit, matrix, iterations."""
    note: str
    error_mech: float | None = None
    error_mat: float | None = None
    """None: a law has no material solution."""
    error_mech_all: float | None = None
    error_mat_all: float | None = None
    error_fe2: float | None = None
    """Of the mechanical solution against FE2 of the same model: what the data leave."""

    @property
    def seconds(self) -> float:
        return self.seconds_sampling + self.seconds_solve

    @property
    def name(self) -> str:
        return f"{self.method}, {self.model}, {self.data} data"


@dataclass(frozen=True)
class _References:
    """Block means of the tensegrity and, if it is there, of FE2; ``symbol`` p or q counts."""

    symbol: str
    tensegrity: dd.BlockStress
    fe2: dd.BlockStress | None

    def errors(self, mechanical: dd.BlockStress, material: dd.BlockStress | None) -> dict[str, float]:
        """Those of a point."""
        found = dd.compare_blocks(mechanical, material or mechanical, self.tensegrity)
        mech, mat = (getattr(found, f"error_{self.symbol}_{name}") for name in ("mech", "mat"))
        errors = {"error_mech": mech.l2, "error_mech_all": mech.l2_all}
        if material is not None:
            errors |= {"error_mat": mat.l2, "error_mat_all": mat.l2_all}
        if self.fe2 is not None and self.fe2.stress_measure == mechanical.stress_measure:
            data = dd.compare_blocks(mechanical, mechanical, self.fe2)
            errors["error_fe2"] = getattr(data, f"error_{self.symbol}_mech").l2
        return errors


def frontier(
    study: Study,
    *,
    fe2: Sequence[Path] = (),
    models: Sequence[str] = tuple(MODELS),
    budgets: Sequence[int] = _BUDGETS,
    plots: bool = True,
) -> dict[str, Any]:
    """Time and error of data-driven solves (numbers of data, metrics, tangents), adaptive ones, fitted laws, and FE2.

    ``models`` are names of :data:`MODELS`, ``budgets`` RVEs of the adaptive solves. ``fe2`` are folders of
    ``tsgdd fe2`` for some of the models; the others are stages, as tensegrity and data are where they are not given.
    Where all is run here, it is on one machine and the ratios are of one run. A method that fails is a point that says
    so. frontier.csv has a row for every point. None of them is tuned to the reference.

    Raises:
        InputError: an argument or a file is not valid.
        ConvergenceError: the tensegrity did not converge.
    """
    if not models or not set(models) <= set(MODELS):
        raise InputError(f"models: expected some of {', '.join(MODELS)}, got {', '.join(models) or 'none'}")
    known = _known_fe2(study, fe2)
    if study.data is not None:
        _seconds_per_datum(study.data)
    out, load = output_folder(study.out), study.load
    found = study.prepare()
    full = read_summary(found.dns, "dns")
    per_datum = _seconds_per_datum(found.data)
    points: list[_Point] = []
    for model in models:
        for point in _points_of(study, found, model, known.get(MODELS[model]), per_datum, budgets):
            points.append(point)
            study.say(f"{point.name:60} {_shown(point)}, {point.seconds_solve:.2f} + {point.seconds_sampling:.2f} s")
    rows = [dataclasses.asdict(point) for point in points]
    write_table(out / "frontier.csv", rows)
    reached = [p for p in points if p.error_mech is not None]
    best = min(reached, key=lambda p: p.error_mech or 0.0, default=None)
    near = [p for p in reached if (p.error_mech or 0) <= _NEAR and p.error_fe2 is not None and p.error_fe2 <= _OWN]
    quickest = min(near, key=lambda p: p.seconds, default=None)
    summary = write_summary(
        out,
        command="bench frontier",
        parameters={
            **study.parameters(found),
            "fe2": list(fe2),
            "models": {name: MODELS[name] for name in models},
            "budgets": list(budgets),
        },
        figures={
            "symbol": (LOADS[load].symbol, ""),
            "dns_seconds": (full["seconds"], "s"),
            "dns_resumed_after_step": (full["resumed_after_step"], ""),
            "reference": (describe(full), ""),
            "dns_machine": (full["machine"], ""),
            "points": (rows, ""),
            "most_accurate": (None if best is None else best.name, ""),
            "quickest_near": (None if quickest is None else quickest.name, ""),
            "dns_over_quickest_near": (None if quickest is None else full["seconds"] / quickest.seconds, "1"),
            "dns_over_solve": ({p.name: full["seconds"] / p.seconds_solve for p in reached}, "1"),
            "dns_over_all": ({p.name: full["seconds"] / p.seconds for p in reached}, "1"),
        },
    )
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.frontier_figure import plot_frontier

        save_figure(plot_frontier(rows, full["seconds"], summary), out / "frontier.png")
    return summary


def _seconds_per_datum(data: Path) -> float:
    """What sampling of the file ``data`` took, s.

    Raises:
        InputError: no summary beside it says so.
    """
    sampled = read_summary(data, "sample")
    if sampled.get("seconds_in_file") is None:
        raise InputError(f"data: expected the time of sampling in the summary beside {data}, got none")
    return float(sampled["seconds_in_file"] / sampled["points_in_file"])


def _shown(point: _Point) -> str:
    if point.error_mech is None:
        return point.note
    return f"error {point.error_mech:.2%}" + (f", of data {point.error_fe2:.2%}" if point.error_fe2 else "")


def _points_of(
    study: Study, found: Inputs, model: str, fe2: Path | None, per_datum: float, budgets: Sequence[int]
) -> Iterator[_Point]:
    """All points of one model; sampling took ``per_datum`` seconds."""
    scene = _of_model(found.scene, MODELS[model])
    dataset = dd.THEORIES[scene.kinematics].dataset(found.dataset, None)
    methods = [entry for entry in entries() if scene.kinematics in entry.theories]
    adapted = partial(_adaptive, tissue=study.chain.tissue, measure=dataset.stress_measure)
    point: Callable[..., _Point] = partial(_Point, model=model)
    small, few = dataclasses.replace(scene, elements=(3, 3, 1)), take(dataset, np.arange(min(20, len(dataset))))
    warm_up: list[Callable[[], dd.Solution]] = [partial(method.solve, small, few) for method in methods]
    warm_up.append(partial(adapted, small, budget=2))
    for run in warm_up:
        _timed(run, repeats=1)  # kernels are compiled and libraries loaded before the clock runs

    measure, symbol, exact = dataset.stress_measure, LOADS[scene.load].symbol, None
    try:
        folder = fe2 or study.chain.fe2(found.stages, scene, study.say)
    except ConvergenceError as error:
        yield point("FE2", data=0, seconds_sampling=0.0, seconds_solve=0.0, note=f"failed: {error}")
    else:
        ran, exact = read_summary(folder, "fe2"), _fe2_blocks(folder)
        cost = {"data": ran["rve_solves"], "seconds_sampling": ran["seconds_rve"]}
        note = f"{ran['iterations']} Newton iterations, {ran['ranks']} rank{'s' * (ran['ranks'] > 1)}"
        own = _References(symbol, _tensegrity(found.dns, exact.stress_measure), None).errors(exact, None)
        yield point("FE2", **cost, seconds_solve=ran["seconds"] - ran["seconds_rve"], note=note, **own)
    references = _References(symbol, _tensegrity(found.dns, measure), exact)

    order = np.random.default_rng([0, len(dataset)]).permutation(len(dataset))
    for size in sorted({max(1, len(dataset) // 100), max(1, len(dataset) // 10), len(dataset)}):
        part = take(dataset, np.sort(order[:size]))
        for method in methods:
            solution, seconds, note = _timed(partial(method.solve, scene, part), repeats=_REPEATS)
            times = {"seconds_sampling": per_datum * size, "seconds_solve": seconds}
            yield point(method.name, data=size, note=note, **times, **_errors(solution, references, measure))
    for budget in budgets:
        solution, seconds, note = _timed(partial(adapted, scene, budget=budget), repeats=_REPEATS)
        last = None if solution is None else solution.rounds[-1]
        rves, rve = (budget, 0.0) if last is None else (last.rves, last.seconds_rve)
        times = {"seconds_sampling": rve, "seconds_solve": seconds - rve}
        yield point("adaptive from nothing", data=rves, note=note, **times, **_errors(solution, references, measure))


def _adaptive(scene: Scene, *, tissue: Tissue, measure: str, budget: int) -> dd.AdaptiveResult:
    """The adaptive solution, its mesh included."""
    return adaptive(scene.problem(MPI.COMM_SELF), scene, tissue=tissue, budget=budget, measure=measure)


def _timed[S: dd.Solution](run: Callable[[], S], *, repeats: int) -> tuple[S | None, float, str]:
    """The solution, the shortest time in s, and what is to be said of it; None where it failed."""
    solution, shortest, spent = None, np.inf, 0.0
    for _ in range(repeats):
        begin = time.perf_counter()
        try:
            again = run()
        except (ConvergenceError, InputError) as error:
            return None, time.perf_counter() - begin, f"failed: {error}"
        seconds = time.perf_counter() - begin
        spent += seconds
        if seconds < shortest:
            solution, shortest = again, seconds
        if spent > _ENOUGH:
            break
    assert solution is not None
    return solution, shortest, solution.note


def _errors(solution: dd.Solution | None, references: _References, measure: str) -> dict[str, float]:
    if solution is None:
        return {}
    operator, shown = solution.problem.operator, dd.in_space(solution, measure)
    midpoint = operator.cell_corners.mean(axis=1)
    stresses = (shown.mechanical.stress, shown.material_stress)
    mechanical, material = (dd.BlockStress(midpoint, operator.cell_mean(s), measure) for s in stresses)
    return references.errors(mechanical, material if solution.metric is not None else None)


def _tensegrity(dns: Path, measure: str) -> dd.BlockStress:
    blocks = read_blocks(dns, measure)
    assert blocks.midpoint is not None
    return dd.BlockStress(blocks.midpoint, blocks.stress, measure)


def _fe2_blocks(folder: Path) -> dd.BlockStress:
    fields = dd.read_quadrature(folder / "quadrature.h5")
    return dd.BlockStress(fields.midpoint, fields.cell_mean(fields.mechanical_stress), fields.stress_measure)


def _known_fe2(study: Study, folders: Sequence[Path]) -> dict[Model, Path]:
    """The folders by their model.

    Raises:
        InputError: one is not of FE2, or of another scene or none of the models, or two are of one model.
    """
    chain = study.chain
    known: dict[Model, Path] = {}
    for folder in folders:
        there = fe2_parameters(folder)
        model = there["kinematics"], there["clamp"], there["flat"]
        scene = chain.scene(study.load)
        if model in MODELS.values():
            scene = _of_model(scene, model)
        check_fe2(folder, scene, chain.tissue)
        if model in known:
            raise InputError(f"fe2: expected one folder of every model, got {known[model]} and {folder}")
        known[model] = folder
    return known


def _of_model(scene: Scene, model: Model) -> Scene:
    kinematics, clamp, flat = model
    return dataclasses.replace(scene, kinematics=kinematics, clamp=clamp, flat=flat)
