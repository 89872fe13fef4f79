"""tsgdd study causes."""

from __future__ import annotations

from workflows.runs.printing import say
from workflows.runs.ranks import check_alone
from workflows.studies.options import ChainOptions, StudyOptions

__all__ = ["command"]


def command(*, study: StudyOptions, chain: ChainOptions) -> None:
    """What the error is made of: the same solve with another metric, stress, RVE, data or reference."""
    check_alone("study causes")
    from workflows.studies.causes import causes as run

    made = study.make("causes", chain)
    run(made, plots=study.plots)
    say(f"{'results':24} {made.out}")
