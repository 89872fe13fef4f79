"""tsgdd bench frontier."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.options import Load, OutOrDefault, Plots
from workflows.runs.printing import say
from workflows.runs.ranks import check_alone
from workflows.studies.options import ChainOptions, Data, Dns, LoadOrBoth

__all__ = ["command"]


def command(
    *,
    load: LoadOrBoth = None,
    out: OutOrDefault = None,
    chain: ChainOptions,
    dns: Dns = None,
    data: Data = None,
    fe2: Annotated[list[Path] | None, typer.Option(help="Folder of 'tsgdd fe2'; repeat for other kinematics.")] = None,
    plots: Plots = True,
) -> None:
    """Run time against error: data-driven and adaptive solves, FE2, fitted laws, and the full tensegrity."""
    check_alone("bench frontier")
    from tsg_micro.data.errors import InputError
    from workflows.studies.bench_frontier import frontier as run
    from workflows.studies.one_load import Study

    if load is None and (dns or data or fe2):
        raise InputError("load: expected stretch or shear beside --dns, --data or --fe2, got none")
    made = chain.make()
    for one in Load if load is None else [load]:
        folder = out / one.value if out and load is None else out or Path("results") / f"frontier-{one.value}"
        run(Study(folder, one.value, made, dns, data, say=say), fe2=fe2 or (), plots=plots)
        say(f"{'results':24} {folder}")
