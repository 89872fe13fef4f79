"""The full tensegrity of any body of voxels, one block each, under the supports and loads of a scene.

Every step leaves checkpoint.h5 in the folder of results, as those of a sheet do (workflows.runs.dns): a run that was
cut goes on after the last one that was done.
"""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import dd_macro as dd
from tsg_micro.bodies.sheet_means import block_data
from tsg_micro.bodies.voxel_body import memory_of_body
from tsg_micro.bodies.voxel_path import LoadedBody
from tsg_micro.cells.structure import Structure
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.homogenise import BlockFields, block_fields
from tsg_micro.continuum.radial_profiles import ball_radius, block_radius, radial_profile, radial_stress, shell_count
from tsg_micro.continuum.response import compressed_tendons
from tsg_micro.data.dataset_file import write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from tsg_micro.data.mandel import pressure, to_mandel, von_mises
from tsg_micro.figures.vtu import VtuSeries, write_vtu
from workflows.runs.progress import tracked
from workflows.runs.voxel_scene import VoxelScene, scene_loads, voxel_scene
from workflows.store.checkpoint import (
    Checkpoint,
    LoadStep,
    fingerprint,
    latest_checkpoint,
    remove_checkpoint,
    write_checkpoint,
)
from workflows.store.limits import check_count, check_memory
from workflows.store.record import drop_summary, peak_memory, versions, write_summary

__all__ = ["FACTORS", "body_dns"]

Array = NDArray[np.float64]
Say = Callable[[str], None]
FACTORS = (0.25, 0.5, 0.75, 1.0)
"""Of the load, at the recorded steps."""


def body_dns(
    out: Path,
    *,
    domain: dd.TaggedMesh,
    tissue: Tissue,
    bar_force: ArrayLike,
    supports: Sequence[dd.Displacement],
    loads: Sequence[dd.Load],
    free: bool = False,
    factors: Sequence[float] = FACTORS,
    linear_solver: str = "auto",
    parameters: Mapping[str, Any] | None = None,
    plots: bool = True,
    say: Say = lambda text: None,
) -> dict[str, Any]:
    """Load the body that a mesh of voxels is to all ``factors`` of its load, in recorded steps, each stable.

    A voxel is a block of the ``tissue`` with a ``bar_force`` of its own (cells,), N. Supports and loads act as
    :func:`scene_loads` says; with ``free`` what rigid motions the supports leave are held in the mean. ``parameters``
    are those of the scene, for the summary. Writes blocks.h5 and blocks_kirchhoff.h5 (block means as data sets, in the
    mesh's coordinates; of a member that two blocks share each has its own prestress), structure.vtu, structure.pvd of
    the load steps as they are done, figures and, last of all, summary.json into ``out``.

    Raises:
        InputError: an argument is not valid, the mesh is none of voxels or on several ranks, or the body needs more
            memory than there is.
        ConvergenceError: the equilibrium was lost.
    """
    begin = time.perf_counter()
    levels = [float(factor) for factor in factors]
    if not levels or not np.isfinite(levels).all():
        raise InputError(f"factors: expected at least one finite number, got {levels}")
    check_count("factors", len(levels))
    _check_memory(domain, tissue, linear_solver)
    scene = voxel_scene(domain, tissue, bar_force)
    applied = scene_loads(scene, supports, loads)
    body = LoadedBody(scene.body, applied, free=free, linear_solver=linear_solver)
    out = output_folder(out)
    drop_summary(out)
    structure = scene.body.structure
    arrays = (structure.nodes, structure.rest_length, applied.fixed, applied.displacement, applied.force)
    decisive = {"arrays": _digest(*arrays), "pressure": applied.pressure, "factors": levels, "tissue": tissue.as_dict()}
    series = VtuSeries(out / "structure.pvd", _placed(scene)) if plots else None
    state, resumed = _follow(body, levels, out / "checkpoint.h5", fingerprint(decisive), begin, say, series)
    fields = block_fields(structure, body.displacement, body.members, prestress=scene.body.prestress)
    fields = dataclasses.replace(fields, midpoint=fields.midpoint + scene.body.origin)
    data = block_data(fields, parameters={"tissue": tissue.as_dict()}, versions=versions())
    for name, dataset in zip(("blocks.h5", "blocks_kirchhoff.h5"), data, strict=True):
        write_dataset(out / name, dataset)
    figures = _figures(scene, body, supports, levels, state, fields) | _radial(scene, body, fields)
    seconds = sum(step.seconds for step in state.done[:resumed]) + time.perf_counter() - begin
    figures |= {"resumed_after_step": (resumed, ""), "seconds": (seconds, "s")}
    if plots:
        _draw(out, scene, body, fields)
    force = scene.body.bar_force
    given = {**tissue.as_dict(), "bar_force": float(force[0]) if np.ptp(force) == 0.0 else None}
    given |= {"free": free, "factors": levels, "linear_solver": linear_solver, **(parameters or {})}
    summary = write_summary(out, command="dns", parameters=given, figures=figures)
    remove_checkpoint(out / "checkpoint.h5")
    return summary


def _digest(*arrays: NDArray[Any]) -> str:
    """Of the content of arrays."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def _check_memory(domain: dd.TaggedMesh, tissue: Tissue, linear_solver: str) -> None:
    """Raise InputError where the linear solver is not known, or the body needs more memory than is available."""
    backend, needed = memory_of_body(tissue, dd.voxel_grid(domain, tissue.block).index, linear_solver)
    check_memory(f"mesh: {domain.global_cells} blocks with {backend}", needed)


def _follow(
    body: LoadedBody,
    levels: Sequence[float],
    file: Path,
    run: str,
    begin: float,
    say: Say,
    series: VtuSeries | None,
) -> tuple[Checkpoint, int]:
    """Load the body to all ``levels``, or to those after the checkpoint in ``file``.

    Returns where it ends, and how many steps had been done before; times count from ``begin``.
    """
    last, steps = begin, len(levels)
    choice = body.solver.newton.choice
    say(f"{len(body.body.structure.blocks)} blocks, {body.dofs} unknowns, {choice.backend} ({choice.reason})")
    state = latest_checkpoint(file, run, body.body.structure.nodes.shape, say)
    resumed = len(state.done)
    if resumed:
        say(f"going on after step {resumed} of {steps}")
        body.resume(state.displacement, levels[resumed - 1])
        if series:
            series.keep(resumed)
    for number in tracked(range(resumed, steps), "load steps"):
        result = body.load(levels[number])
        now = time.perf_counter()
        assert result.negative_pivots is not None  # a stable solution has been factorised
        step = LoadStep(
            answer=body.stored_energy(),
            residual=result.residual,
            iterations=result.iterations,
            factorisations=result.factorisations,
            load_steps=result.load_steps,
            negative_pivots=result.negative_pivots,
            most_negative_pivots=max((i.negative_pivots for i in result.history), default=0),
            seconds=now - last,
            peak_memory=peak_memory(),
        )
        last, state = now, Checkpoint(result.displacement, (*state.done, step))
        if series:
            series.add(number + 1, result)
        write_checkpoint(file, state, run)
        say(
            f"step {number + 1} of {steps}: {levels[number]:.4g} of the load, {step.iterations} iterations, "
            f"{step.negative_pivots} negative pivots, {now - begin:.0f} s"
        )
    return state, resumed


def _placed(scene: VoxelScene) -> Structure:
    """The structure in the mesh's coordinates."""
    return dataclasses.replace(scene.body.structure, nodes=scene.body.position)


def _figures(
    scene: VoxelScene,
    body: LoadedBody,
    supports: Sequence[dd.Displacement],
    levels: Sequence[float],
    state: Checkpoint,
    fields: BlockFields,
) -> dict[str, tuple[Any, str]]:
    """What the summary says of the body, and of how every recorded step converged."""
    structure, choice, done, members = scene.body.structure, body.solver.newton.choice, state.done, body.members
    support, mean_force = body.forces_of_supports(), float(np.abs(members.force).mean())
    loose = np.where(body.loads.fixed, 0.0, support)
    reactions = {one.name: support[scene.nodes(one.side)].sum(axis=0).tolist() for one in supports}
    moved = {side: body.displacement[scene.nodes(side)].mean(axis=0).tolist() for side in scene.sides}
    figures: dict[str, tuple[Any, str]] = {
        "blocks": (len(structure.blocks), ""),
        "cells": (len(structure.cells), ""),
        "nodes": (len(structure.nodes), ""),
        "dofs": (body.dofs, ""),
        "bar_force_range": ([float(scene.body.bar_force.min()), float(scene.body.bar_force.max())], "N"),
        "reactions": (reactions, "N"),
        "displacements": (moved, "m"),
        "volume_change": (float(np.linalg.det(fields.F).mean() - 1.0), "1"),
        "enclosed_volume_change": (body.enclosed_volume_change(), "1"),
        "pressure_follows": (body.surface is not None, ""),
        "free_motions": (len(body.solver.newton.border.constraint), ""),
        "unsupported_force": (float(np.abs(loose).max() / mean_force), "mean member force"),
        "newton_iterations": (sum(step.iterations for step in done), ""),
        "factorisations": (sum(step.factorisations for step in done), ""),
        "load_steps": (sum(step.load_steps for step in done), ""),
        "negative_pivots": (done[-1].negative_pivots, ""),
        "most_negative_pivots": (max(step.most_negative_pivots for step in done), ""),
        "residual": (done[-1].residual, "mean member force"),
        "compressed_tendons": (compressed_tendons(structure, members), ""),
        "linear_solver": (choice.backend, ""),
        "linear_solver_reason": (choice.reason, ""),
        "peak_memory": (max(peak_memory(), *(step.peak_memory for step in done)), "B"),
        "factor_history": (list(levels), "1"),
        "energy_history": ([step.answer for step in done], "J"),
    }
    units = {"residual": "mean member force", "seconds": "s"}
    for name in ("residual", "iterations", "factorisations", "negative_pivots", "most_negative_pivots", "seconds"):
        figures[f"step_{name}"] = ([getattr(step, name) for step in done], units.get(name, ""))
    return figures


def _radial(scene: VoxelScene, body: LoadedBody, fields: BlockFields) -> dict[str, tuple[Any, str]]:
    """Radial Cauchy stress by shells, of a round body."""
    structure, edge = scene.body.structure, scene.body.tissue.block
    radius = ball_radius(fields.midpoint, edge)
    if radius is None:
        return {}
    stress = radial_stress(structure, body.displacement, body.members, scene.body.prestress).cauchy
    profile = radial_profile(block_radius(structure, radius), stress, shells=shell_count(radius, edge))
    return {
        "radius": (radius, "m"),
        "r_over_R": (profile.r.tolist(), "1"),
        "sigma_rr": ({"mean": profile.mean.tolist(), "std": profile.std.tolist()}, "Pa"),
        "blocks_in_shell": (profile.count.tolist(), ""),
    }


def _draw(out: Path, scene: VoxelScene, body: LoadedBody, fields: BlockFields) -> None:
    """The figures and the file for ParaView."""
    from tsg_micro.data.figure_style import save_figure
    from tsg_micro.data.slices import plot_slices, slices_of_blocks
    from tsg_micro.figures.shells import plot_shells
    from tsg_micro.figures.space import View, plot_body

    structure, edge, members = scene.body.structure, scene.body.tissue.block, body.members
    placed = _placed(scene)
    write_vtu(out / "structure.vtu", placed, body.displacement, members)
    rest = body.solver.system.state(np.zeros(body.solver.system.size))
    views = [View("at rest", None, rest.force), View("loaded", body.displacement, members.force)]
    save_figure(plot_body(placed, views), out / "body.png")
    stress = to_mandel(fields.kirchhoff / np.linalg.det(fields.F)[:, None, None])
    p, q, force = pressure(stress), von_mises(stress), scene.body.bar_force
    shown = {"pressure $p$ (Cauchy)": (p, "$p$ / Pa"), "effective stress $q$ (Cauchy)": (q, "$q$ / Pa")}
    if np.ptp(force) > 0.0:
        shown["bar force at rest"] = (1e9 * force, "$f_b$ / nN")
    save_figure(plot_slices(slices_of_blocks(fields.midpoint, edge), shown), out / "slices.png")
    radius = ball_radius(fields.midpoint, edge)
    if radius is not None:
        radial = radial_stress(structure, body.displacement, members, scene.body.prestress)
        curves = {"full tensegrity, Cauchy": radial.cauchy}
        r = block_radius(structure, radius)
        save_figure(plot_shells(r, curves, shells=shell_count(radius, edge)), out / "shells.png")
