"""Studies and benchmarks: all that are in workflows/studies/commands, and the paper's, which runs most of them."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from workflows.runs.option_groups import grouped
from workflows.runs.options import out_option
from workflows.runs.printing import say
from workflows.runs.ranks import check_alone
from workflows.studies import commands
from workflows.studies.options import ChainOptions

__all__ = ["find_studies", "paper"]


def find_studies() -> tuple[typer.Typer, typer.Typer]:
    """The commands ``tsgdd study ...`` and ``tsgdd bench ...``: one for every file of workflows/studies/commands."""
    study = typer.Typer(help="Studies of the paper's Section 4, and of what goes beyond it.", no_args_is_help=True)
    bench = typer.Typer(help="Benchmarks: agreement and run time.", no_args_is_help=True)
    for file in pkgutil.iter_modules(commands.__path__):
        name = file.name.removeprefix("bench_")
        command = import_module(f"{commands.__name__}.{file.name}").command
        (study if name == file.name else bench).command(name=name.replace("_", "-"))(grouped(command))
    return study, bench


@grouped
def paper(
    *,
    out: Annotated[Path, out_option("Folder of all stages and of report.md.")] = Path("results/paper"),
    chain: ChainOptions,
    largest: Annotated[int, typer.Option(help="Largest RVE of the size study, in blocks.")] = 6,
    sizes: Annotated[int, typer.Option(help="Numbers of data of the data-size study.")] = 16,
    draws: Annotated[int, typer.Option(help="Random draws of each of them.")] = 10,
) -> None:
    """The paper's multiscale study, all of it; what is there already is not repeated."""
    check_alone("paper")
    from workflows.studies.paper import paper as run

    run(out, chain=chain.make(), largest=largest, sizes=sizes, draws=draws, say=say)
