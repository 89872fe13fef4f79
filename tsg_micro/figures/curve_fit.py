"""The figure of a fit: measured points, the fitted curve, and what is left between them."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from tsg_micro.bodies.curve_fit import PARAMETERS, Fit
from tsg_micro.data.figure_style import STYLE, new_figure, save_figure, tidy

__all__ = ["draw_fit"]

_AXES = {
    "cell": (("force / nN", 1e9), ("displacement / µm", 1e6)),
    "monolayer": (("nominal strain / %", 1e2), ("nominal stress / Pa", 1.0)),
}
_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))


def draw_fit(out: Path, fit: Fit, load: NDArray[np.float64], answer: NDArray[np.float64]) -> None:
    """Data and fit, and the differences below."""
    (x_label, x_scale), (y_label, y_scale) = _AXES[fit.model.scene]
    dense = load.max() * np.linspace(0.0, 1.0, 61)[1:]
    with mpl.rc_context(STYLE):
        figure = new_figure(8.0, 6.4)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
        upper.plot(x_scale * load, y_scale * answer, "o", color="0.45", markersize=5, label=f"data, {len(load)} points")
        curve = np.append(y_scale * fit.model.contact_point, y_scale * fit.model.answer(dense))
        upper.plot(x_scale * np.append(0.0, dense), curve, "-", color="#20639b", linewidth=2, label="fit")
        lower.plot(x_scale * load, y_scale * (answer - fit.model.answer(load)), "o", color="0.45", markersize=4)
        lower.axhline(0.0, color="#20639b", linewidth=1.5)
        upper.set_ylabel(y_label)
        lower.set_ylabel("data - fit / " + y_label.split(" / ")[1], fontsize=11)
        lower.set_xlabel(x_label)
        text = []
        for k, (name, value) in enumerate(zip(fit.names, fit.values, strict=True)):
            known = (
                ""
                if fit.interval is None
                else " .. ".join(_quantity(v, PARAMETERS[name].unit) for v in fit.interval[k])
            )
            text.append(
                f"{name.replace('_', ' ')}: {_quantity(value, PARAMETERS[name].unit)} ({known or 'no interval'})"
            )
        upper.set_title("\n".join([*text, "(95 % intervals)"]), fontsize=11, loc="left")
        for axes in (upper, lower):
            tidy(axes)
        upper.legend(frameon=False)
        save_figure(figure, out / "fit.png")


def _quantity(value: float, unit: str) -> str:
    """A number with the prefix that suits it."""
    if unit == "1":
        return f"{value:.3g}"
    factor, prefix = next(((f, p) for f, p in _PREFIXES if abs(value) >= 0.9995 * f), _PREFIXES[-1])
    return f"{value / factor:.3g} {prefix}{unit}"
