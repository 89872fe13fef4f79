"""Study of edges: the stress of a clamped sheet row by row, of every bar and tendon, with edges and without."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dd_macro as dd
from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.errors import InputError
from workflows.runs.compare import compare
from workflows.runs.dns import dns
from workflows.runs.scene import Scene
from workflows.runs.solve import solve
from workflows.runs.tensegrity import read_blocks
from workflows.store.record import read_summary, write_summary
from workflows.store.stages import Stages

__all__ = ["edges", "errors_of", "row_means"]

Array = NDArray[np.float64]
COMPONENTS = ("xx", "yy", "zz")
_LEAST = 5


def edges(
    out: Path,
    *,
    blocks: tuple[int, int],
    load: str,
    strain: float,
    tissue: Tissue,
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """A sheet of ``blocks``, held flat, as full tensegrity and by adaptive data, with edges and without.

    Writes the runs, rows.png and summary.json with the errors of p and q and the rows into ``out``.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: a run did not converge.
    """
    if min(blocks) < _LEAST:
        raise InputError(f"blocks: expected at least {_LEAST} along x and y, got {blocks[0]} {blocks[1]}")
    stages = Stages(out, say)
    asked: dict[str, Any] = {"blocks": blocks, "load": load, "strain": strain, **tissue.as_dict()}
    of_load: dict[str, Any] = {"load": load, "strain": strain}

    whole = partial(dns, blocks=blocks, tissue=tissue, flat=True, plots=False, say=say, **of_load)
    reference = stages.run("dns", asked, whole)
    blocks_of = read_blocks(reference, "first_piola")
    assert blocks_of.midpoint is not None
    rows = {"every bar and tendon": row_means(blocks_of.midpoint, blocks_of.stress, tissue.block)}
    figures: dict[str, tuple[Any, str]] = {}
    for name, on in (("without edges", False), ("with edges", True)):
        scene = Scene(elements=(*blocks, 1), kinematics="finite", element="enhanced", edges=on, **of_load)
        action = partial(_run, scene=scene, tissue=tissue, say=say)
        folder = stages.run(name.replace(" ", "-"), {**asked, **scene.parameters()}, action)
        fields = dd.read_quadrature(folder / "quadrature.h5")
        rows[name] = row_means(fields.midpoint, fields.cell_mean(fields.mechanical_stress), tissue.block)
        errors = compare(out / f"compare-{folder.name}", dd=folder, dns=reference, plots=False)
        for symbol in "pq":
            figures[f"error_{symbol} {name}"] = (errors[f"error_{symbol}_mech"], "1")
        figures[f"rves {name}"] = (read_summary(folder, "solve")["rves"], "")
    figures |= {f"rows {name}": (values.tolist(), "Pa") for name, values in rows.items()}
    summary = write_summary(out, command="study edges", parameters=asked, figures=figures)
    if plots:
        from tsg_micro.data.figure_style import save_figure
        from workflows.studies.edges_figure import plot_rows

        save_figure(plot_rows(rows), out / "rows.png")
    return summary


def _run(folder: Path, *, scene: Scene, tissue: Tissue, say: Callable[[str], None]) -> None:
    solve(folder, data=None, scene=scene, tissue=tissue, adaptation=dd.Adaptation(), plots=False, say=say)


def row_means(midpoint: Array, stress: Array, block: float) -> Array:
    """Mean stress xx, yy, zz (rows, 3) of the blocks at ``midpoint`` (b, 3), m, in each row along y, from the bottom.

    The two outer columns at each side are left out.
    """
    i, j = (np.round(midpoint[:, axis] / block - 0.5).astype(int) for axis in (0, 1))
    inner = (i > 1) & (i < i.max() - 1)
    return np.array([stress[inner & (j == row), : len(COMPONENTS)].mean(axis=0) for row in range(j.max() + 1)])


def errors_of(summary: Mapping[str, Any], symbol: str) -> dict[str, dict[str, float]]:
    """The errors of p or q of the study's runs, by name."""
    begin = f"error_{symbol} "
    return {name.removeprefix(begin): value for name, value in summary.items() if name.startswith(begin)}
