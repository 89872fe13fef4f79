"""tsgdd compare: data-driven or FE2 stresses against those of the full tensegrity, block by block, on any body."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dd_macro.results.compare import BlockStress, ErrorMap, compare_blocks, error_map, interior_blocks, match_blocks
from dd_macro.results.quadrature_file import QuadratureFields, read_quadrature
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.figure_style import block_outlines
from tsg_micro.data.files import output_folder
from tsg_micro.data.mandel import pressure, von_mises
from workflows.runs.compare_bodies import block_edge, block_stress, body_figures, draw_body
from workflows.runs.tensegrity import SCENE, check_same_scene, read_blocks
from workflows.store.record import number, read_summary, write_summary

__all__ = ["compare"]

Array = NDArray[np.float64]
Figures = dict[str, tuple[Any, str]]
Draw = Callable[[Path], None]

_BUCKLED = 1e-7
"""Deflection of the mid-plane, m, that is no round-off any more: a hundredth of a cell's height."""
_COMMANDS = {"solve": "data-driven", "fe2": "FE2"}
_INVARIANTS = {"p": pressure, "q": von_mises}


def compare(out: Path, *, dd: Path, dns: Path, plots: bool = True) -> dict[str, Any]:
    """Errors of the stress of the run in folder ``dd`` against that in folder ``dns``, both in the measure of ``dd``.

    Of a sheet between clamps they are those of p and q, and the summary also says where they sit: how much of the
    squared error each ring of blocks holds, and what the error is with ever more rings left out. Of other bodies they
    are what :func:`body_figures` says. Elements that share a block are averaged. FE2 has a mechanical solution only;
    its material one is the same.

    Raises:
        InputError: a folder is not what it should be, or the two are of different loads, strains, bar forces or grids.
    """
    solved, reference = read_summary(dd, *_COMMANDS), read_summary(dns, "dns")
    check_same_scene(solved["parameters"], dns, str(dd))
    fields = read_quadrature(dd / "quadrature.h5")
    if fields.normalised_distance != number(solved, "normalised_distance"):
        raise InputError(f"{dd}: expected the files of one run, got summary.json and quadrature.h5 of different ones")
    measure = str(solved["stress_measure"])
    blocks = read_blocks(dns, measure)
    more = {
        "stress_measure": (measure, ""),
        "normalised_distance": (solved["normalised_distance"], "1"),
        "dns_buckled": ("deflection" in reference and number(reference, "deflection") > _BUCKLED, ""),
        "dd_seconds": (number(solved, "seconds"), "s"),
        "dns_seconds": (number(reference, "seconds"), "s"),
    }
    if "nominal_stress" in reference:
        scene = {name: solved["parameters"][name] for name in SCENE}
        figures, draw = _of_sheet(solved, fields, blocks)
    else:
        scene = {}
        figures, draw = _of_body(solved, fields, blocks)
    out = output_folder(out)
    parameters = {"dd": dd, "dns": dns, **scene}
    summary = write_summary(out, command="compare", parameters=parameters, figures=figures | more)
    if plots:
        draw(out)
    return summary


def _of_body(solved: dict[str, Any], fields: QuadratureFields, blocks: Dataset) -> tuple[Figures, Draw]:
    """Figures of any body, and what draws them."""
    solutions = {"mech": block_stress(fields, fields.mechanical_stress, blocks)}
    titles = {"mech": _COMMANDS[solved["command"]]}
    if solved["command"] != "fe2":
        solutions["mat"] = block_stress(fields, fields.material_stress, blocks)
        titles = {"mech": "mechanical", "mat": "material"}
    return body_figures(solutions, blocks), lambda out: draw_body(out, solutions, blocks, titles)


def _of_sheet(solved: dict[str, Any], fields: QuadratureFields, blocks: Dataset) -> tuple[Figures, Draw]:
    """Figures of a sheet, and what draws them."""
    assert blocks.midpoint is not None
    measure, fe2 = blocks.stress_measure, solved["command"] == "fe2"
    midpoint, outline = fields.midpoint, fields.deformed_corners[:, :4, :2]
    stresses = {"mech": fields.mechanical_stress, "mat": fields.material_stress}
    if len(midpoint) > len(blocks):  # blocks of several elements
        midpoint, outline = blocks.midpoint, block_outlines(blocks.midpoint, single=block_edge(blocks))
        means = {name: block_stress(fields, stress, blocks) for name, stress in stresses.items()}
    else:
        means = {name: fields.cell_mean(stress) for name, stress in stresses.items()}
    tensegrity = BlockStress(blocks.midpoint, blocks.stress, measure)
    solutions = {name: BlockStress(midpoint, stress, measure) for name, stress in means.items()}
    mechanical, material = solutions["mech"], solutions["mat"]
    comparison = compare_blocks(mechanical, material, tensegrity)
    maps = {
        symbol: {name: error_map(solution, tensegrity, invariant) for name, solution in solutions.items()}
        for symbol, invariant in _INVARIANTS.items()
    }
    figures: Figures = {
        name: (value, "1" if name.startswith("error") else "") for name, value in comparison.as_dict().items()
    }
    for symbol, pair in maps.items():
        for name, found in pair.items():
            unit = "shares of the squared error, and relative error"
            figures[f"boundary_{symbol}_{name}"] = (found.as_dict(), unit)

    def draw(out: Path) -> None:
        _draw(out, outline, None if fe2 else material, mechanical, tensegrity)
        _draw_boundary(out, outline, maps, _COMMANDS[solved["command"]])

    return figures, draw


def _draw(
    out: Path, outline: Array, material: BlockStress | None, mechanical: BlockStress, tensegrity: BlockStress
) -> None:
    """The paper's four panels, for p and for q; FE2 has no material solution of its own."""
    from dd_macro.results.figures import plot_comparison
    from tsg_micro.data.figure_style import save_figure

    found = match_blocks(mechanical, tensegrity)
    inner = interior_blocks(mechanical.midpoint)
    for symbol, invariant in _INVARIANTS.items():
        figure = plot_comparison(
            outline,
            material=None if material is None else invariant(material.stress),
            mechanical=invariant(mechanical.stress),
            tensegrity=np.asarray(invariant(tensegrity.stress))[found],
            inner=inner,
            symbol=symbol,
        )
        save_figure(figure, out / f"{symbol}.png")


def _draw_boundary(out: Path, outline: Array, maps: dict[str, dict[str, ErrorMap]], method: str) -> None:
    from dd_macro.results.figures import plot_boundary
    from tsg_micro.data.figure_style import save_figure

    named = {"mech": "mechanical", "mat": "material"} if method == "data-driven" else {"mech": method}
    chosen = {f"{title} ${symbol}$": maps[symbol][name] for symbol in maps for name, title in named.items()}
    save_figure(plot_boundary(outline, chosen), out / "boundary.png")
