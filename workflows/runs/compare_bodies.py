"""A data-driven or FE2 solution against the full tensegrity on any body of voxels: errors, slices, shells."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dd_macro.results.compare_bodies import block_means, body_errors, inner_blocks, relative_errors
from dd_macro.results.quadrature_file import QuadratureFields
from tsg_micro.continuum.radial_profiles import ball_radius, radial_profile, shell_count
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import from_mandel, pressure, von_mises
from tsg_micro.data.stress import measure_words

__all__ = ["block_edge", "block_stress", "body_figures", "draw_body"]

Array = NDArray[np.float64]


def block_edge(blocks: Dataset) -> float:
    """Edge in m of the blocks of a tensegrity, as its tissue says.

    Raises:
        InputError: its data set does not say.
    """
    try:
        return 2.0 * float(blocks.parameters["tissue"]["cell"]["height"])
    except (KeyError, TypeError, ValueError):
        raise InputError("blocks of the tensegrity: expected the height of their cells, it is missing") from None


def block_stress(fields: QuadratureFields, stress: Array, blocks: Dataset) -> Array:
    """Volume means (b, 6) in the tensegrity's ``blocks`` of a ``stress`` (cells, points, 6) at quadrature points, Pa.

    Raises:
        InputError: the elements do not fill the blocks.
    """
    assert blocks.midpoint is not None
    volume = fields.weight.sum(axis=1)
    return block_means(fields.midpoint, volume, fields.cell_mean(stress), blocks.midpoint, block_edge(blocks))


def body_figures(solutions: Mapping[str, Array], blocks: Dataset) -> dict[str, tuple[Any, str]]:
    """Errors of the stress (b, 6) of every solution, "mech" and "mat", of inner blocks and of all, for a summary.

    A block is an inner one if it has no outer face. Of a round body there are also the radial stress n . sigma . n of
    both, n from the middle of the body to that of the block at rest, its means over shells, and their errors.
    """
    assert blocks.midpoint is not None
    edge = block_edge(blocks)
    inner, radial = inner_blocks(blocks.midpoint, edge), _Shells.of(blocks.midpoint, edge)
    figures: dict[str, tuple[Any, str]] = {
        "blocks": (len(inner), ""),
        "interior_blocks": (int(inner.sum()), ""),
        "round": (radial is not None, ""),
    }
    for name, stress in solutions.items():
        figures[f"errors_{name}"] = (body_errors(stress, blocks.stress).as_dict(), "1")
        figures[f"errors_{name}_inner"] = (body_errors(stress[inner], blocks.stress[inner]).as_dict(), "1")
        square = ((stress - blocks.stress) ** 2).sum(axis=1)
        figures[f"error_share_outer_{name}"] = (float(square[~inner].sum() / (square.sum() or 1.0)), "1")
    if radial is None:
        return figures
    sigma = radial.stress(blocks.stress)
    figures["r_over_R"] = (radial.profile(sigma).r.tolist(), "1")
    figures["blocks_in_shell"] = (radial.profile(sigma).count.tolist(), "")
    figures["sigma_rr"] = (radial.profile(sigma).mean.tolist(), "Pa")
    for name, stress in solutions.items():
        mean, reference = radial.profile(radial.stress(stress)).mean, radial.profile(sigma).mean
        error = relative_errors(radial.stress(stress), sigma)
        figures[f"sigma_rr_{name}"] = (mean.tolist(), "Pa")
        figures[f"error_sigma_rr_{name}"] = (None if error is None else {"l2": error[0], "mean": error[1]}, "1")
        if reference.all():
            figures[f"error_shells_{name}"] = ((mean / reference - 1.0).tolist(), "1")
            figures[f"error_shells_largest_{name}"] = (float(np.abs(mean / reference - 1.0).max()), "1")
    return figures


class _Shells:
    """A round body: r/R (b,) and outward directions (b, 3) of its blocks at rest."""

    def __init__(self, midpoint: Array, edge: float, radius: float) -> None:
        away = midpoint - midpoint.mean(axis=0)
        length = np.linalg.norm(away, axis=1)
        self.r, self.n = length / radius, away / np.maximum(length, 1e-9 * edge)[:, None]
        self.count = shell_count(radius, edge)

    @classmethod
    def of(cls, midpoint: Array, edge: float) -> _Shells | None:
        """None where the body is not round."""
        radius = ball_radius(midpoint, edge)
        return None if radius is None else cls(midpoint, edge, radius)

    def stress(self, stress: Array) -> Array:
        """n . sigma . n (b,) of Mandel stress (b, 6)."""
        return np.asarray(np.einsum("ba,bac,bc->b", self.n, from_mandel(stress), self.n))

    def profile(self, values: Array) -> Any:
        """Means over shells."""
        return radial_profile(self.r, values, shells=self.count)


def draw_body(out: Path, solutions: Mapping[str, Array], blocks: Dataset, titles: Mapping[str, str]) -> None:
    """Slices of p and q of the solutions (b, 6) and of the tensegrity, of the errors, and profiles of a round body.

    ``titles`` are the solutions' names in the figures; the first one's errors are drawn.
    """
    from tsg_micro.data.figure_style import save_figure
    from tsg_micro.data.slices import plot_slices, slices_of_blocks
    from tsg_micro.figures.shells import plot_shells

    assert blocks.midpoint is not None
    midpoint, edge = blocks.midpoint, block_edge(blocks)
    slices = slices_of_blocks(midpoint, edge)
    everyone = {titles[name]: stress for name, stress in solutions.items()} | {"full tensegrity": blocks.stress}
    first = next(iter(solutions))
    errors = {}
    for symbol, invariant in (("p", pressure), ("q", von_mises)):
        fields = {f"{title}, ${symbol}$": (invariant(stress), f"${symbol}$ / Pa") for title, stress in everyone.items()}
        save_figure(plot_slices(slices, fields), out / f"{symbol}.png")
        b = invariant(blocks.stress)
        mean_square = float(np.sqrt((b**2).mean())) or 1.0
        size = 100.0 * np.abs(invariant(solutions[first]) - b) / mean_square
        errors[f"error of ${symbol}$, {titles[first]}"] = (size, f"${symbol}$: % of r.m.s.")
    save_figure(plot_slices(slices, errors, cmap="magma"), out / "errors.png")
    radial = _Shells.of(midpoint, edge)
    if radial is not None:
        label = rf"$\sigma_{{rr}}$ ({measure_words(blocks.stress_measure)}) / Pa"
        curves = {title: radial.stress(stress) for title, stress in everyone.items()}
        save_figure(plot_shells(radial.r, curves, shells=radial.count, label=label), out / "shells.png")
