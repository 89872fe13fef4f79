"""tsgdd bench accuracy."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.options import Kinematics, KinematicsName, Out, Plots
from workflows.runs.printing import say
from workflows.runs.ranks import check_alone

__all__ = ["command"]


def command(
    *,
    out: Out = Path("results/accuracy"),
    case: Annotated[
        list[int] | None, typer.Option(help="Number of a case, from 1; repeat for several. Else all.")
    ] = None,
    kinematics: Kinematics = KinematicsName.small,
    parts: Annotated[bool, typer.Option("--parts/--no-parts", help="Take errors apart by FE2 and a fine mesh.")] = True,
    plots: Plots = True,
) -> None:
    """Error of default answers on a family of scenes against the full tensegrity, and what it is made of."""
    check_alone("bench accuracy")
    from tsg_micro.data.errors import InputError
    from workflows.studies.bench_accuracy import CASES, ZONES, accuracy

    chosen = case or list(range(1, len(CASES) + 1))
    if not all(1 <= number <= len(CASES) for number in chosen):
        raise InputError(f"case: expected numbers from 1 to {len(CASES)}, got {', '.join(map(str, chosen))}")
    options = {"kinematics": kinematics.value}
    summary = accuracy(out, cases=[CASES[n - 1] for n in chosen], options=options, parts=parts, plots=plots, say=say)
    for zone in ZONES:
        say(f"worst, {zone:17} {summary['worst'][zone]:.2%}")
    say(f"{'results':24} {out}")
