"""tsgdd compare: the data-driven stresses against those of the full tensegrity, block by block."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dd_macro.compare import BlockStress, compare_blocks, match_blocks
from dd_macro.output import QuadratureFields, read_quadrature
from tsg_micro.dataset import convert_dataset, read_dataset
from tsg_micro.errors import InputError
from tsg_micro.files import output_folder
from tsg_micro.mandel import pressure, von_mises
from workflows.record import read_summary, write_summary

__all__ = ["compare"]

_SCENE = ("load", "strain", "bar_force")


def compare(out: Path, *, dd: Path, dns: Path, plots: bool = True) -> dict[str, Any]:
    """Errors of p and q of the run in folder ``dd`` against that in folder ``dns``, both in the measure of ``dd``.

    The first Piola and the Kirchhoff stress of a block are means over its members; Cauchy and second Piola stress are
    made from them with the block's mean F.

    Raises:
        InputError: a folder is not what it should be, or the two are of different loads, strains, bar forces or grids.
    """
    solved, reference = read_summary(dd, "solve"), read_summary(dns, "dns")
    for name in _SCENE:
        a, b = solved["parameters"].get(name), reference["parameters"].get(name)
        if a != b and not (name == "bar_force" and a is None):  # None: of joined or measured data
            raise InputError(f"{name}: expected the same in both runs, got {a} in {dd} and {b} in {dns}")
    fields = read_quadrature(dd / "quadrature.h5")
    measure = solved["stress_measure"]
    means = dns / ("blocks_kirchhoff.h5" if measure in ("kirchhoff", "cauchy") else "blocks.h5")
    blocks = convert_dataset(read_dataset(means), measure)
    if blocks.midpoint is None:
        raise InputError(f"{means}: expected block midpoints, got none")
    tensegrity = BlockStress(blocks.midpoint, blocks.stress, measure)
    mechanical = BlockStress(fields.midpoint, fields.cell_mean(fields.mechanical_stress), measure)
    material = BlockStress(fields.midpoint, fields.cell_mean(fields.material_stress), measure)
    comparison = compare_blocks(mechanical, material, tensegrity)
    out = output_folder(out)
    figures = {name: (value, "1" if name.startswith("error") else "") for name, value in comparison.as_dict().items()}
    summary = write_summary(
        out,
        command="compare",
        parameters={"dd": dd, "dns": dns, **{name: solved["parameters"][name] for name in _SCENE}},
        figures={
            **figures,
            "stress_measure": (measure, ""),
            "normalised_distance": (solved["normalised_distance"], "1"),
            "dd_seconds": (solved["seconds"], "s"),
            "dns_seconds": (reference["seconds"], "s"),
        },
    )
    if plots:
        _draw(out, fields, mechanical, material, tensegrity)
    return summary


def _draw(
    out: Path, fields: QuadratureFields, mechanical: BlockStress, material: BlockStress, tensegrity: BlockStress
) -> None:
    """The paper's four panels, for p and for q."""
    from dd_macro.plot import plot_comparison, save_figure

    found = match_blocks(mechanical, tensegrity)
    outline = fields.corners[:, :4, :2]
    for symbol, invariant in (("p", pressure), ("q", von_mises)):
        figure = plot_comparison(
            outline,
            material=invariant(material.stress),
            mechanical=invariant(mechanical.stress),
            tensegrity=np.asarray(invariant(tensegrity.stress))[found],
            symbol=symbol,
        )
        save_figure(figure, out / f"{symbol}.png")
