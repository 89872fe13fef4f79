"""Options that the studies share, in groups."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from workflows.runs.option_groups import Group
from workflows.runs.options import BarForce, HowLoaded, Load, OutOrDefault, Plots, Strain
from workflows.runs.printing import say

if TYPE_CHECKING:
    from workflows.studies.one_load import Study
    from workflows.studies.prerequisites import Chain

__all__ = ["ChainOptions", "Data", "Dns", "LoadOrBoth", "Paths", "Seed", "Steps", "StudyOptions"]

Blocks = Annotated[tuple[int, int], typer.Option(help="2x2x2-cell blocks along x and y.")]
Paths = Annotated[int, typer.Option(help="Loading paths to sample.")]
Steps = Annotated[int, typer.Option(help="Points along each path.")]
Seed = Annotated[int, typer.Option(help="Seed of the data.")]
Dns = Annotated[Path | None, typer.Option(help="Folder of 'tsgdd dns'; computed here if not given.")]
Data = Annotated[Path | None, typer.Option(help="Material data, HDF5; sampled here if not given.")]
LoadOrBoth = Annotated[Load | None, typer.Option(help="How the top side moves; both if not given.")]


@dataclass(frozen=True)
class ChainOptions(Group):
    """The scene of a study and its data."""

    blocks: Blocks = (60, 30)
    strain: Strain = 0.05
    bar_force: BarForce = 1e-8
    paths: Paths = 1000
    steps: Steps = 10
    seed: Seed = 0

    def make(self) -> Chain:
        """The chain of runs that the study stands on.

        Raises:
            InputError: a value is not valid.
        """
        from workflows.studies.prerequisites import Chain

        return Chain(self.blocks, self.strain, self.bar_force, self.paths, self.steps, self.seed)


@dataclass(frozen=True, kw_only=True)
class StudyOptions(Group):
    """A study of one load: its results, and the runs it starts from where they are there already."""

    load: HowLoaded
    out: OutOrDefault = None
    dns: Dns = None
    data: Data = None
    plots: Plots = True

    def make(self, name: str, chain: ChainOptions) -> Study:
        """The study; without a folder its results are in one in results, called by ``name``.

        Raises:
            InputError: a value is not valid.
        """
        from workflows.studies.one_load import Study

        out = self.out or Path("results") / f"{name}-{self.load.value}"
        return Study(out, self.load.value, chain.make(), self.dns, self.data, say=say)
