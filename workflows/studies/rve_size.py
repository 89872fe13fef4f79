"""tsgdd study rve-size: energy and stress against the size of the RVE (paper, Section 4.2), and which RVE is needed.

Blocks of n x n x 1, with the images of members on opposite faces merged or duplicated. The reference is one block with
merged images, which is an infinite sheet as long as the sheet does not buckle with a wave longer than a block. Whether
it does is asked directly: the state of one block, repeated n x n times, is an equilibrium of the larger RVE, and the
inertia of the tangent there tells whether it is a stable one.

The energy that is compared is the change from zero strain, the work that the strain does. The stored energy holds that
of the prestress too, whose error has the other sign, so that the sum of the two errors need not fall like 1/n.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.lattice import Images
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.long_waves import COMPRESSED, buckling, negative_pivots_repeated, tensor_strain
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from workflows.runs.progress import tracked
from workflows.store.record import peak_memory, write_summary

__all__ = ["IMAGES", "LOADINGS", "Sizes", "study_rve_size"]

Array = NDArray[np.float64]
IMAGES: tuple[Images, ...] = ("merged", "duplicated")
LOADINGS: dict[str, dict[str, float]] = {
    "stretch": {"yy": 0.05},
    "shear": {"xy": 0.025},
    "biaxial": {"xx": 0.05, "yy": 0.05},
    "mixed": {"xx": -0.03, "yy": 0.05, "xy": 0.02},
}
"""Tensor strains, in-plane components that are not named are zero; the shear is gamma = 5 %."""
_WANTED, _FLAT = 0.01, 1e-8


@dataclass
class Sizes:
    """What was computed, by images; rows are bar forces, columns loadings, then sizes."""

    sizes: Sequence[int]
    bar_forces: Sequence[float]
    stored: dict[str, Array] = field(default_factory=dict)
    """Stored energy (F, L, N), prestress included, J/m^3."""
    change: dict[str, Array] = field(default_factory=dict)
    """Stored energy less that of the same RVE at zero strain (F, L, N), J/m^3: what the strain has put in."""
    first_piola: dict[str, Array] = field(default_factory=dict)
    """P (F, L, N, 3, 3), Pa."""
    seconds: dict[str, Array] = field(default_factory=dict)
    """Time of a state from zero strain, its tangent included (F, L, N), s."""
    unstable: list[str] = field(default_factory=list)
    """Where the state of one block, repeated n x n times, is unstable."""

    def errors(self, images: str) -> dict[str, Array]:
        """Relative errors (F, L, N) against one block with merged images."""
        reference = self.first_piola["merged"][:, :, :1]
        size = np.linalg.norm(reference, axis=(-1, -2))
        return {
            "energy_change": np.abs(self.change[images] / self.change["merged"][:, :, :1] - 1.0),
            "stress": np.linalg.norm(self.first_piola[images] - reference, axis=(-1, -2)) / size,
            "stored_energy": np.abs(self.stored[images] / self.stored["merged"][:, :, :1] - 1.0),
        }

    def slopes(self, images: str) -> dict[str, Array]:
        """Slopes (F, L) of log error over log n."""
        n = np.log(self.sizes)
        return {
            name: np.apply_along_axis(lambda e: np.polyfit(n, np.log(e), 1)[0], -1, np.maximum(error, 1e-300))
            for name, error in self.errors(images).items()
        }


def study_rve_size(
    out: Path,
    *,
    largest: int = 6,
    bar_force: Sequence[float] = (1e-9, 1e-8, 5e-8),
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Energy and stress of RVEs of 1 x 1 to ``largest`` x ``largest`` blocks, and buckling by waves beyond one block.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: an RVE lost its equilibrium.
    """
    if not 2 <= largest <= 20:  # 20 x 20 blocks have 120,000 unknowns
        raise InputError(f"largest: expected 2 (a slope needs two sizes) to 20, got {largest}")
    if not bar_force or len(set(bar_force)) < len(bar_force):
        raise InputError(f"bar_force: expected different forces in N, at least one, got {list(bar_force)}")
    tissues = [Tissue(bar_force=force) for force in sorted(bar_force)]
    out = output_folder(out)
    begin = time.perf_counter()
    found = _compute(range(1, largest + 1), tissues, say)
    buckled = {name: buckling(name, sizes=found.sizes, tissues=tissues, say=say) for name in COMPRESSED}
    errors, slopes = found.errors("duplicated"), found.slopes("duplicated")
    deviation = max(float(found.errors("merged")[name].max()) for name in ("energy_change", "stress"))
    leading = np.stack([slopes["energy_change"], slopes["stress"]])
    worst = np.maximum(errors["energy_change"], errors["stress"]).max(axis=(0, 1))
    blocks_for_1_percent = _blocks_needed(found.sizes, worst)
    answer = _answer(found, deviation, worst, blocks_for_1_percent, buckled)
    summary = write_summary(
        out,
        command="study rve-size",
        parameters={"largest": largest, "bar_force": list(bar_force), "loadings": LOADINGS, "compressed": COMPRESSED},
        figures={
            "answer": (answer, ""),
            "chosen": ("1x1x1, images merged, while the sheet stays flat" if deviation < _FLAT else "none of them", ""),
            "sizes": (list(found.sizes), "blocks"),
            "merged_largest_deviation": (deviation, "1"),
            "duplicated_slope_min": (leading.min(), "1"),
            "duplicated_slope_max": (leading.max(), "1"),
            "duplicated_largest_error": (worst, "1"),
            "error_at_3x3": (worst[2] if largest >= 3 else None, "1"),
            "blocks_for_1_percent": (blocks_for_1_percent, "blocks along x and y"),
            "slopes": ({name: _named(found, values) for name, values in slopes.items()}, "1"),
            "errors_duplicated": ({name: _named(found, values) for name, values in errors.items()}, "1"),
            "errors_merged": ({n: _named(found, values) for n, values in found.errors("merged").items()}, "1"),
            "energy_change": ({images: _named(found, found.change[images]) for images in IMAGES}, "J/m^3"),
            "stored_energy": ({images: _named(found, found.stored[images]) for images in IMAGES}, "J/m^3"),
            "first_piola": ({images: _named(found, found.first_piola[images]) for images in IMAGES}, "Pa"),
            "unstable_states": (found.unstable, ""),
            "buckling": (buckled, "fraction of the corner strain; Pa"),
            "seconds_per_state_merged": (np.median(found.seconds["merged"], axis=(0, 1)), "s"),
            "seconds_per_state_duplicated": (np.median(found.seconds["duplicated"], axis=(0, 1)), "s"),
            "peak_memory": (peak_memory(), "B"),
            "seconds": (time.perf_counter() - begin, "s"),
        },
    )
    say(answer)
    if plots:
        _draw(out, found, buckled)
    return summary


def _compute(sizes: Sequence[int], tissues: Sequence[Tissue], say: Callable[[str], None]) -> Sizes:
    """All states, each from zero strain."""
    found = Sizes(sizes, [tissue.bar_force for tissue in tissues])
    ones = [RVESpec(tissue).build() for tissue in tissues]
    states = [[one.solve_strain(tensor_strain(loading)) for loading in LOADINGS.values()] for one in ones]
    shape = (len(tissues), len(LOADINGS), len(sizes))
    for images in IMAGES:
        stored, change, seconds = (np.zeros(shape) for _ in range(3))
        P = np.zeros((*shape, 3, 3))
        for k, n in enumerate(tracked(sizes, f"sizes, images {images}")):
            for i, tissue in enumerate(tissues):
                rve = RVESpec(tissue, (n, n, 1), images=images).build()
                rest = rve.solve_strain(np.zeros(6)).energy
                for j, (name, loading) in enumerate(LOADINGS.items()):
                    if images == "merged" and negative_pivots_repeated(states[i][j], ones[i], rve):
                        found.unstable.append(f"{name}, {tissue.bar_force:g} N, {n}x{n}")
                    rve.reset()
                    begin = time.perf_counter()
                    state = rve.solve_strain(tensor_strain(loading))
                    seconds[i, j, k] = time.perf_counter() - begin
                    stored[i, j, k], change[i, j, k] = state.energy, state.energy - rest
                    P[i, j, k] = state.first_piola
            say(f"{images} {n}x{n}x1: {np.median(seconds[..., k]):.3f} s a state")
        found.stored[images], found.change[images] = stored, change
        found.first_piola[images], found.seconds[images] = P, seconds
    return found


def _blocks_needed(sizes: Sequence[int], worst: Array) -> int:
    """The size at which the largest error falls to 1 %, by the power law of the last two sizes."""
    (n0, n1), (e0, e1) = sizes[-2:], worst[-2:]
    slope = math.log(e1 / e0) / math.log(n1 / n0)
    return math.ceil(n1 * (_WANTED / e1) ** (1.0 / slope) - 1e-9)


def _answer(found: Sizes, deviation: float, worst: Array, needed: int, buckled: Mapping[str, Any]) -> str:
    """Which RVE is needed, in one sentence, from the figures."""
    n = found.sizes[-1]
    three = min(3, n)
    seconds = {images: np.median(found.seconds[images], axis=(0, 1)) for images in IMAGES}
    ratio = seconds["duplicated"][three - 1] / seconds["merged"][0]
    has, to, larger = ("has", "to", "nothing larger") if deviation < _FLAT else ("misses", "by", "a larger RVE")
    text = (
        f"Merged images: one block (1x1x1) {has} the energy and stress of {n}x{n}x1 {to} {deviation:.0e}, {larger} is "
        f"needed while the sheet stays flat; with duplicated images the error is up to {worst[0]:.1%} at 1x1, "
        f"{three}x{three} is off by {worst[three - 1]:.1%} and takes {ratio:.0f} times as long, 1 % needs "
        f"{needed}x{needed}"
    )
    for name, result in buckled.items():
        onsets = [t for values in result["onset"].values() for t in values if t is not None]
        if not onsets:
            text += f"; towards the most compressed corner of the {name} box the sheet does not buckle"
            continue
        most = max(values[0] / min(v for v in values if v is not None) for values in result["stress_norm"].values())
        text += (
            f"; towards the most compressed corner of the {name} box the sheet buckles with waves longer than a block "
            f"from {min(onsets):.0%} of the strain on, and one block overrates the stress there up to {most:.1f} times"
        )
    return text + "."


def _named(found: Sizes, values: Array) -> dict[str, dict[str, Any]]:
    """Values (F, L, ...) by loading and bar force."""
    return {
        loading: {f"{force:g}": values[i, j].tolist() for i, force in enumerate(found.bar_forces)}
        for j, loading in enumerate(LOADINGS)
    }


def _draw(out: Path, found: Sizes, buckled: Mapping[str, Any]) -> None:
    """The figures."""
    from tsg_micro.data.figure_style import save_figure
    from workflows.studies import rve_size_figures as plot

    names, forces = list(LOADINGS), found.bar_forces
    errors: dict[str, dict[str, Array]] = {images: found.errors(images) for images in IMAGES}
    save_figure(plot.plot_errors(found.sizes, names, forces, errors), out / "rve_size.png")
    energies = {"energy change $\\Delta W$": found.change, "stored energy $W$": found.stored}
    save_figure(plot.plot_energies(found.sizes, names, forces, energies), out / "energy.png")
    shown = {name: result for name, result in buckled.items() if any(map(any, result["onset"].values()))}
    for name, result in shown.items():
        save_figure(plot.plot_buckling(result), out / f"buckling_{name}.png")
