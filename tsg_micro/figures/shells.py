"""Means over shells of a round body, over the distance from its middle."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tsg_micro.continuum.radial_profiles import radial_profile
from tsg_micro.data.figure_style import STYLE, finite, new_figure, tidy

__all__ = ["plot_shells"]

Array = NDArray[np.float64]


def plot_shells(r: Array, curves: Mapping[str, Array], *, shells: int, label: str = r"$\sigma_{rr}$ / Pa") -> Figure:
    """Every curve's values (b,) of blocks at r/R (b,): dots, and the mean and scatter of each of the ``shells``.

    Raises:
        InputError: a curve of another length, or not finite.
    """
    with mpl.rc_context(STYLE):
        figure = new_figure(8.0, 5.6)
        axes = figure.add_subplot()
        for (name, values), colour, marker in zip(
            curves.items(), cycle(("#0072b2", "#d55e00", "#009e73")), cycle("os^")
        ):
            profile = radial_profile(r, finite(name, values, r.shape), shells=shells)
            axes.scatter(r, values, s=9, color=colour, alpha=0.3, linewidths=0)
            axes.errorbar(profile.r, profile.mean, profile.std, fmt=f"{marker}-", color=colour, capsize=4, label=name)
        axes.set(xlim=(0.0, None), xlabel="$r/R$", ylabel=label)
        tidy(axes)
        axes.legend(frameon=False)
    return figure
