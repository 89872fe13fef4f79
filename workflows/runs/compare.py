"""tsgdd compare: data-driven or FE2 stresses against those of the full tensegrity, block by block."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dd_macro.results.compare import BlockStress, ErrorMap, compare_blocks, error_map, interior_blocks, match_blocks
from dd_macro.results.quadrature_file import QuadratureFields, read_quadrature
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from tsg_micro.data.mandel import pressure, von_mises
from workflows.runs.tensegrity import SCENE, check_same_scene, read_blocks
from workflows.store.record import number, read_summary, write_summary

__all__ = ["compare"]

_BUCKLED = 1e-7
"""Deflection of the mid-plane, m, that is no round-off any more: a hundredth of a cell's height."""
_COMMANDS = {"solve": "data-driven", "fe2": "FE2"}
_INVARIANTS = {"p": pressure, "q": von_mises}


def compare(out: Path, *, dd: Path, dns: Path, plots: bool = True) -> dict[str, Any]:
    """Errors of p and q of the run in folder ``dd`` against that in folder ``dns``, both in the measure of ``dd``.

    The summary also says where they sit: how much of the squared error each ring of blocks holds, and what the error is
    with ever more rings left out. FE2 has a mechanical solution only; its material one is the same.

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
    assert blocks.midpoint is not None
    tensegrity = BlockStress(blocks.midpoint, blocks.stress, measure)
    mechanical = BlockStress(fields.midpoint, fields.cell_mean(fields.mechanical_stress), measure)
    material = BlockStress(fields.midpoint, fields.cell_mean(fields.material_stress), measure)
    comparison = compare_blocks(mechanical, material, tensegrity)
    solutions = {"mech": mechanical, "mat": material}
    maps = {
        symbol: {name: error_map(solution, tensegrity, invariant) for name, solution in solutions.items()}
        for symbol, invariant in _INVARIANTS.items()
    }
    out = output_folder(out)
    figures = {name: (value, "1" if name.startswith("error") else "") for name, value in comparison.as_dict().items()}
    summary = write_summary(
        out,
        command="compare",
        parameters={"dd": dd, "dns": dns, **{name: solved["parameters"][name] for name in SCENE}},
        figures={
            **figures,
            **{
                f"boundary_{symbol}_{name}": (found.as_dict(), "shares of the squared error, and relative error")
                for symbol, pair in maps.items()
                for name, found in pair.items()
            },
            "stress_measure": (measure, ""),
            "normalised_distance": (solved["normalised_distance"], "1"),
            "dns_buckled": ("deflection" in reference and number(reference, "deflection") > _BUCKLED, ""),
            "dd_seconds": (number(solved, "seconds"), "s"),
            "dns_seconds": (number(reference, "seconds"), "s"),
        },
    )
    if plots:
        _draw(out, fields, None if solved["command"] == "fe2" else material, mechanical, tensegrity)
        _draw_boundary(out, fields, maps, _COMMANDS[solved["command"]])
    return summary


def _draw(
    out: Path, fields: QuadratureFields, material: BlockStress | None, mechanical: BlockStress, tensegrity: BlockStress
) -> None:
    """The paper's four panels, for p and for q; FE2 has no material solution of its own."""
    from dd_macro.results.figures import plot_comparison
    from tsg_micro.data.figure_style import save_figure

    found = match_blocks(mechanical, tensegrity)
    outline, inner = fields.corners[:, :4, :2], interior_blocks(mechanical.midpoint)
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


def _draw_boundary(out: Path, fields: QuadratureFields, maps: dict[str, dict[str, ErrorMap]], method: str) -> None:
    from dd_macro.results.figures import plot_boundary
    from tsg_micro.data.figure_style import save_figure

    named = {"mech": "mechanical", "mat": "material"} if method == "data-driven" else {"mech": method}
    chosen = {f"{title} ${symbol}$": maps[symbol][name] for symbol in maps for name, title in named.items()}
    save_figure(plot_boundary(fields.corners[:, :4, :2], chosen), out / "boundary.png")
