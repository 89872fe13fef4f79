"""tsgdd bench stability: random designs far from the paper's values, what converged, and whether that is true.

Micro states and macroscopic solves are drawn by number. Each is solved within a time limit, in processes that share the
work. A solution is rebalanced by workflows/studies/rebalance.py, which knows no solver; one that is out of balance, or
unstable, is silent: wrong, and said to be right. A case that has none must say why, by an error that has a name.
"""

from __future__ import annotations

import re
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from types import FrameType
from typing import Any

from threadpoolctl import threadpool_limits

from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.files import output_folder
from workflows.runs.progress import progress
from workflows.store.record import write_summary, write_table
from workflows.studies.stability_macro import METHODS, MacroCase, draw_macro, sampled
from workflows.studies.stability_micro import SCENES, MicroCase, draw_micro

__all__ = ["STATES", "run_case", "stability"]

Row = dict[str, Any]
Case = MicroCase | MacroCase
STATES = ("converged", "not converged", "refused", "time limit", "silent", "unnamed")
"""How a case can end; the last two are defects."""
_BALANCED = 1e-9
"""Largest force on a node, over the mean member force, or the largest of a body; more than the tolerance of 1e-10."""
_NUMBER = re.compile(r"-?\d[\d.]*(e[-+]\d+)?%?")
_NOTHING: Row = dict.fromkeys(("iterations", "residual", "rounding", "negative_pivots")) | {"detail": ""}


class _TimeLimit(Exception):
    """A case took too long."""


def stability(
    out: Path,
    *,
    micro: int,
    sheets: int,
    macro: int,
    seed: int = 0,
    limit: float = 30.0,
    processes: int = 2,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> Row:
    """``micro`` cells and RVEs of each kind, ``sheets`` of each size, ``macro`` solves with points and with tangents.

    A case may take ``limit`` seconds. Writes micro.csv, macro.csv, stability.png and summary.json into ``out``.

    Raises:
        InputError: an argument is not valid.
    """
    counts = {"micro": micro, "sheets": sheets, "macro": macro}
    for name, value, least in (*((n, v, 0) for n, v in counts.items()), ("seed", seed, 0), ("processes", processes, 1)):
        if value < least:
            raise InputError(f"{name}: expected at least {least}, got {value}")
    if not any(counts.values()):
        raise InputError("micro, sheets, macro: expected cases, got none")
    if not 0.0 < limit < 1e6:
        raise InputError(f"limit: expected a positive number of seconds, got {limit}")
    output_folder(out)
    begin = time.perf_counter()
    cases: list[Case] = []
    for scene in SCENES:
        cases += draw_micro(scene, sheets if scene.endswith("sheet") else micro, seed)
    for scene in METHODS:
        cases += draw_macro(scene, macro, seed)
    rows: list[Row] = []
    last = {case.scene: k for k, case in enumerate(cases)}
    with progress("cases", len(cases)) as told:
        for k, row in enumerate(_all(cases, limit, processes)):
            rows.append(row)
            told(k + 1.0)
            if last[row["scene"]] == k:
                say(f"{row['scene']:14} {_told(rows, row['scene'])}")
    tables = {"micro": [r for r in rows if r["scene"] in SCENES], "macro": [r for r in rows if r["scene"] in METHODS]}
    for name, table in tables.items():
        if table:
            write_table(out / f"{name}.csv", table)
    figures: dict[str, tuple[Any, str]] = {state.replace(" ", "_"): (_count(rows, state), "") for state in STATES}
    figures |= {
        "by_scene": ({scene: _of(rows, scene) for scene in dict.fromkeys(row["scene"] for row in rows)}, ""),
        "reasons": (dict(Counter(row["reason"] for row in rows if row["reason"]).most_common()), ""),
        "defects": ([row for row in rows if row["state"] in STATES[-2:]], ""),
        "seconds": (time.perf_counter() - begin, "s"),
    }
    parameters = {**counts, "seed": seed, "limit": limit, "processes": processes}
    summary = write_summary(out, command="bench stability", parameters=parameters, figures=figures)
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.stability_figure import plot_stability

        save_figure(plot_stability(tables["micro"], tables["macro"]), out / "stability.png")
    return summary


def _all(cases: Sequence[Case], limit: float, processes: int) -> Iterator[Row]:
    """The rows of all cases, in their order."""
    if processes == 1:
        yield from (run_case(case, limit) for case in cases)
        return
    with ProcessPoolExecutor(processes, get_context("spawn"), initializer=threadpool_limits, initargs=(1,)) as pool:
        yield from pool.map(run_case, cases, [limit] * len(cases))


def run_case(case: Case, limit: float) -> Row:
    """The row of a case: all that it is, how it ended, and why if it has no solution."""
    if isinstance(case, MacroCase):
        sampled()  # not a matter of the case
    begin = time.perf_counter()
    state, text, found = STATES[0], "", _NOTHING
    try:
        with _within(limit):
            found = case.solve()
        if not found["residual"] <= max(_BALANCED, found["rounding"]) or found["negative_pivots"]:
            state = "silent"
    except ConvergenceError as error:
        state, text, found = "not converged", str(error), _NOTHING | {"iterations": len(error.history)}
    except InputError as error:
        state, text = "refused", str(error)
    except _TimeLimit:
        state, text = "time limit", f"more than {limit:g} s"
    except Exception as error:
        state, text = "unnamed", f"{type(error).__name__}: {error}"
    told = " ".join(text.split())
    ended = {"state": state, "reason": _NUMBER.sub("N", told)[:160], "text": told, **found}
    return {**_plain(case), **ended, "seconds": time.perf_counter() - begin}


@contextmanager
def _within(limit: float) -> Iterator[None]:
    """Raise _TimeLimit where the block takes longer, in s."""

    def end(signum: int, frame: FrameType | None) -> None:
        raise _TimeLimit

    old = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, limit)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old)


def _plain(case: Case) -> Row:
    return {k: " ".join(f"{x:.4g}" for x in v) if isinstance(v, tuple) else v for k, v in asdict(case).items()}


def _count(rows: Sequence[Row], state: str) -> int:
    return sum(row["state"] == state for row in rows)


def _of(rows: Sequence[Row], scene: str) -> Row:
    """The figures of a scene: how its cases ended, and iterations of those that converged, median and most."""
    here = [row for row in rows if row["scene"] == scene]
    took = sorted(row["iterations"] for row in here if row["state"] == STATES[0]) or [None]
    counts = {state: _count(here, state) for state in STATES}
    worst = max((row["residual"] for row in here if row["residual"] is not None), default=None)
    return {**counts, "iterations": [took[len(took) // 2], took[-1]], "residual": worst}


def _told(rows: Sequence[Row], scene: str) -> str:
    found = _of(rows, scene)
    ended = ", ".join(f"{found[state]} {state}" for state in STATES if found[state])
    middle, most = found["iterations"]
    return f"{ended}; iterations {middle}, at most {most}; out of balance {found['residual'] or 0.0:.1e} at most"
