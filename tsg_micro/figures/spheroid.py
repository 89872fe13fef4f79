"""Figures and ParaView files of a compressed spheroid (paper, Section 3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import NDArray

from tsg_micro.bodies.spheroid import Compression, Spheroid, SpheroidState
from tsg_micro.data.figure_style import MICRO, STYLE, new_figure, save_figure, tidy
from tsg_micro.figures.space import View, plot_body
from tsg_micro.figures.vtu import VtuSeries

__all__ = ["draw_spheroid"]

Array = NDArray[np.float64]

_BLUE, _ORANGE, _GREEN, _GREY = "#0072b2", "#d55e00", "#009e73", "0.35"


def draw_spheroid(out: Path, result: Compression) -> None:
    """All figures, a VTU file of the members at each level, and spheroid.pvd, whose time is the number of the level."""
    body, records = result.body, result.records
    series = VtuSeries(out / "spheroid.pvd", body.structure)
    for step, record in enumerate(records):
        series.add(step, record.state)
    save_figure(_bar_force(body), out / "bar_force.png")
    if len(records) > 1:
        save_figure(_profile(body, records), out / "radial_stress.png")
        save_figure(_slice(body, records[-1]), out / "slice.png")
        save_figure(_levels(result), out / "levels.png")
    save_figure(_voxels(body, records[-1]), out / "blocks.png")
    last = records[-1]
    views = [
        View("before", None, records[0].state.members.force),
        View(f"after: {_text(last.level, result.load)}", last.state.displacement, last.state.members.force),
    ]
    save_figure(plot_body(body.structure, views[: len(records)]), out / "body.png")


def _text(level: float, load: str) -> str:
    return f"pressure {level:.4g} Pa" if load == "pressure" else f"surface moved by {100 * level:.3g} %"


def _bar_force(body: Spheroid) -> Figure:
    """The paper's figure of initial bar forces over their maximum."""
    with mpl.rc_context(STYLE):
        figure = new_figure(6.4, 4.8)
        axes = figure.add_subplot()
        order = np.argsort(body.r)
        top = body.bar_force.max()
        axes.plot(body.r[order], body.bar_force[order] / top, "o-", color=_BLUE, markersize=4, linewidth=1.0)
        axes.set(xlim=(0.0, 1.02), ylim=(0.0, 1.05), xlabel="$r/R$", ylabel=r"bar force $f_b\,/\,\max f_b$")
        axes.set_title(rf"{len(body.r)} blocks, $\max f_b$ = {1e9 * top:.3g} nN")
        tidy(axes)
    return figure


def _curve(axes: Axes, body: Spheroid, values: Array, colour: str, style: str, label: str) -> None:
    profile = body.profile(values)
    axes.errorbar(
        profile.r,
        profile.mean,
        profile.std,
        fmt=style,
        color=colour,
        markersize=6,
        capsize=4,
        linewidth=1.8,
        label=label,
    )


def _profile(body: Spheroid, records: Sequence[SpheroidState]) -> Figure:
    """Normalised radial stress over the radius, and the stress itself before, after, and by how it is counted."""
    before, after = records[0].stress, records[-1].stress
    largest = np.abs(after.cauchy).max()
    with mpl.rc_context(STYLE):
        figure = new_figure(13.0, 5.6)
        left, right = figure.subplots(1, 2)
        left.scatter(body.r, np.abs(after.cauchy) / largest, s=14, color="0.7", linewidths=0, label="blocks, after")
        _curve(left, body, np.abs(after.cauchy) / largest, _BLUE, "o-", "mean and scatter, after")
        _curve(left, body, np.abs(before.cauchy) / largest, _GREY, "s--", "before (prestress alone)")
        left.set(xlim=(0.0, 1.02), ylim=(-0.03, 1.05), xlabel="$r/R$")
        left.set_ylabel(r"$|\sigma_{rr}|\,/\,\max|\sigma_{rr}|$ (Cauchy)")
        _curve(right, body, after.cauchy, _BLUE, "o-", "Cauchy, after")
        _curve(right, body, after.kirchhoff, _GREEN, "^-", "Kirchhoff, after")
        if np.abs(before.cauchy).max() > 1e-3 * largest:  # else the two are one curve
            _curve(right, body, after.cauchy - before.cauchy, "0.0", ":", "Cauchy, after less before")
        _curve(right, body, after.halves, _ORANGE, "o--", "shared tendons halved, after")
        _curve(right, body, before.halves, _ORANGE, "s:", "shared tendons halved, before")
        right.set(xlim=(0.0, 1.02), xlabel="$r/R$", ylabel=r"radial stress $\sigma_{rr}$ / Pa")
        for axes in (left, right):
            tidy(axes)
            axes.legend(frameon=False, fontsize=11, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    return figure


def _slice(body: Spheroid, record: SpheroidState) -> Figure:
    """Radial stress and bar force of the layer of blocks above the middle plane, each where it is now."""
    blocks = body.structure.blocks
    layer = blocks[:, 2] == (blocks[:, 2].min() + blocks[:, 2].max() + 1) // 2
    half = body.structure.height * np.cbrt(record.stress.J[layer])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    squares = MICRO * (record.stress.midpoint[layer, None, :2] + half[:, None, None] * corners)
    sigma = np.abs(record.stress.cauchy)
    fields = (
        ("radial stress, after", r"$|\sigma_{rr}|\,/\,\max|\sigma_{rr}|$", sigma[layer] / sigma.max(), "viridis"),
        ("bar force at rest", r"$f_b\,/\,\max f_b$", body.bar_force[layer] / body.bar_force.max(), "cividis"),
    )
    with mpl.rc_context(STYLE):
        figure = new_figure(12.5, 5.2)
        for axes, (title, label, values, colours) in zip(figure.subplots(1, 2), fields, strict=True):
            drawn = PolyCollection(list(squares), array=values, cmap=colours, edgecolors="white", linewidths=0.4)
            drawn.set_clim(float(values.min()), 1.0)
            axes.add_collection(drawn)
            axes.set_aspect("equal")
            axes.autoscale_view()
            axes.set(xlabel="$x$ / µm", ylabel="$y$ / µm", title=f"{title}: middle slice")
            figure.colorbar(drawn, ax=axes, label=label)
    return figure


def _levels(result: Compression) -> Figure:
    """How the volume and the rise towards the core follow the load."""
    pressure, records = result.load == "pressure", result.records
    scale, unit = (1.0, "pressure / Pa") if pressure else (100.0, "displacement of the surface / %")
    levels = scale * np.array([record.level for record in records])
    volume = 100.0 * (np.array([record.volume for record in records]) / records[0].volume - 1.0)
    with mpl.rc_context(STYLE):
        figure = new_figure(11.5, 4.6)
        left, right = figure.subplots(1, 2)
        left.plot(levels, volume, "o-", color=_BLUE)
        left.set_ylabel("change of enclosed volume / %")
        for name, colour, style, label in (
            ("cauchy", _BLUE, "o-", "each cell its own prestress"),
            ("halves", _ORANGE, "s--", "shared tendons halved"),
        ):
            ratio = np.array(result.core_over_rim(name), dtype=float)
            right.plot(levels[1:], ratio, style, color=colour, label=label)
        right.axhline(1.0, color="0.5", linewidth=0.8)
        right.set_ylabel(r"$\sigma_{rr}$, core over rim")
        right.legend(frameon=False, fontsize=11)
        for axes in (left, right):
            axes.set_xlabel(unit)
            tidy(axes)
    return figure


def _voxels(body: Spheroid, record: SpheroidState) -> Figure:
    """The blocks as cubes, an eighth taken out, coloured by normalised radial stress (or bar force, without a load)."""
    loaded = record.level > 0.0
    values = np.abs(record.stress.cauchy) if loaded else body.bar_force
    low = body.structure.blocks.min(axis=0)
    place = body.structure.blocks - low
    filled = np.zeros(place.max(axis=0) + 1, dtype=bool)
    middle = np.array(filled.shape) / 2.0
    shown = ~((place[:, 0] >= middle[0]) & (place[:, 1] < middle[1]) & (place[:, 2] >= middle[2]))
    filled[tuple(place[shown].T)] = True
    scale = ScalarMappable(Normalize(float(values.min() / values.max()), 1.0), "viridis" if loaded else "cividis")
    colours = np.zeros((*filled.shape, 4))
    colours[tuple(place.T)] = scale.to_rgba(values / values.max())
    with mpl.rc_context(STYLE):
        figure = new_figure(8.0, 6.8)
        axes = figure.add_subplot(projection="3d")
        assert isinstance(axes, Axes3D)
        axes.voxels(filled, facecolors=colours, edgecolors=(0.1, 0.1, 0.1), linewidth=0.5, shade=False)
        axes.set_box_aspect(filled.shape, zoom=1.2)
        axes.view_init(elev=25, azim=-50)
        axes.set_axis_off()
        label = r"$|\sigma_{rr}|\,/\,\max|\sigma_{rr}|$" if loaded else r"$f_b\,/\,\max f_b$"
        figure.colorbar(scale, ax=axes, label=label, shrink=0.7)
        axes.set_title(f"{len(place)} blocks, one eighth taken out")
    return figure
