"""tsgdd study data-size."""

from __future__ import annotations

from typing import Annotated

import typer

from workflows.runs.printing import report, say
from workflows.runs.ranks import check_alone
from workflows.studies.options import ChainOptions, StudyOptions

__all__ = ["command"]


def command(
    *,
    study: StudyOptions,
    chain: ChainOptions,
    sizes: Annotated[int, typer.Option(help="Numbers of data, over three decades.")] = 16,
    draws: Annotated[int, typer.Option(help="Random draws of each size.")] = 10,
) -> None:
    """Error and distance of the data-driven solution against the number of data, and the self-consistent benchmark."""
    check_alone("study data-size")
    from workflows.studies.data_size import data_size as run

    made = study.make("data-size", chain)
    summary = run(made, count=sizes, draws=draws, plots=study.plots)
    for name, value in summary["largest"].items():
        say(f"{name:24} {value:.2%}   data of the tensegrity itself {summary['self_consistent'][name]:.2%}")
    report(summary, "solves seconds_solves", made.out)
