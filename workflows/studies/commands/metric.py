"""tsgdd study metric."""

from __future__ import annotations

from workflows.runs.printing import say
from workflows.runs.ranks import check_alone
from workflows.studies.options import ChainOptions, StudyOptions

__all__ = ["command"]


def command(*, study: StudyOptions, chain: ChainOptions) -> None:
    """How much the error depends on the metric: 0.1 to 10 times the default one, classical and second-order data."""
    check_alone("study metric")
    from workflows.studies.metric import metric as run

    made = study.make("metric", chain)
    summary = run(made, plots=study.plots)
    for name, spreads in summary["spread"].items():
        for row in spreads:
            errors = (row["error_mech"], row["error_mat"])
            shown = ", ".join("none" if e is None else f"{100 * e:.2f}" for e in errors)
            say(f"spread {name:10} {row['method']:13} {row['data']:6} data: {shown} points (mechanical, material)")
    say(f"{'results':24} {made.out}")
