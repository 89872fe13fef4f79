"""What can be said against a solution without its error: data of another tissue, too few blocks, stiff elements."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

import dd_macro as dd
from dd_macro.compat import geometry_nodes
from dd_macro.parallel import total
from tsg_micro.continuum.rve_spec import KINDS, RVESpec

__all__ = ["body_cautions", "scatter_caution"]

Array = NDArray[np.float64]
_NEAR, _FEW = 1e-3, 2.0
_NOTICEABLE = 0.1


def body_cautions(problem: dd.Problem, rve: RVESpec | None, *, bends: Sequence[int], trilinear: bool) -> list[str]:
    """What the body is too small for, or of another tissue than its data, ``rve`` if it is known; collective.

    The body may bend across the axes ``bends``; its elements are ``trilinear`` or others.
    """
    size, cell = _sizes(problem.operator.domain)
    found = []
    if rve is not None:
        across = size / rve.tissue.block
        thick = [axis for axis in range(3) if not rve.periodic[axis] and across[axis] > rve.blocks[axis] + _NEAR]
        if rve.periodic in KINDS.values() and thick:
            found.append(
                f"sheet data, with free faces across {_names(thick)}, for a body {across[thick[0]]:.3g} blocks thick: "
                "inside it is stiffer; use data of --kind bulk"
            )
        thin = [axis for axis in range(3) if across[axis] <= 1 + _NEAR]
        if rve.periodic == KINDS["bulk"] and thin:
            found.append(
                f"bulk data for a body one block thick across {_names(thin)}: both faces of a block are free there, "
                "and it is softer; use data of --kind sheet"
            )
        small = [axis for axis in range(3) if rve.periodic[axis] and across[axis] < max(_FEW, rve.blocks[axis]) - _NEAR]
        small = [axis for axis in small if not (rve.periodic == KINDS["bulk"] and axis in thin)]
        if small:
            wide = f"{across[small[0]]:.3g}"
            found.append(
                f"the body is {wide} block{'' if wide == '1' else 's'} across {'xyz'[small[0]]}, no more than an RVE: "
                "an average over blocks says little of it; use tsgdd dns or tsgdd monolayer"
            )
    stiff = [axis for axis in bends if size[axis] < (1 + _NEAR) * cell[axis]]
    if trilinear and stiff:
        found.append(
            f"one trilinear element across {_names(stiff)}: it is too stiff where it bends; use --element enhanced, "
            "--degree 2 or more elements"
        )
    return found


def scatter_caution(solution: dd.Solution) -> list[str]:
    """Whether strains vary within the elements as much as between them, in the mean over the body; collective."""
    op, strain = solution.problem.operator, solution.mechanical.strain
    comm, w = op.comm, op.weights
    C = np.eye(6) if solution.metric is None else solution.metric.factor
    of_cell = np.repeat(op.cell_mean(strain), op.points_per_cell, axis=0)
    sums = total(comm, np.concatenate([[w.sum()], w @ strain]))
    mean = sums[1:] / sums[0]
    parts = (strain - of_cell, of_cell - mean, strain)
    inside, between, whole = np.sqrt(total(comm, [w @ ((part @ C) ** 2).sum(axis=1) for part in parts]))
    if inside < between or inside <= _NOTICEABLE * whole:
        return []
    return [
        f"strains vary within the elements ({inside / whole:.0%} of their size) as much as between them "
        f"({between / whole:.0%}): an RVE, which takes them as uniform in a block, does not see it; look at more blocks"
    ]


def _sizes(domain: dd.TaggedMesh) -> tuple[Array, Array]:
    """Edges (3,) in m of the body's bounding box, and of the largest cell's along each axis; collective."""
    x = domain.mesh.geometry.x[geometry_nodes(domain.mesh)][: domain.owned_cells]
    low, high = np.min(x, axis=(0, 1), initial=np.inf), np.max(x, axis=(0, 1), initial=-np.inf)
    cell = np.max(np.ptp(x, axis=1), axis=0, initial=0.0) if len(x) else np.zeros(3)
    found = np.concatenate([-low, high, cell])
    most = np.empty_like(found)
    domain.comm.Allreduce(found, most, MPI.MAX)
    return most[3:6] + most[:3], most[6:]


def _names(axes: list[int]) -> str:
    return " and ".join("xyz"[axis] for axis in axes)
