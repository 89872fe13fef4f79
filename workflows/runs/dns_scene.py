"""tsgdd dns SCENE.toml: the full tensegrity of a scene from a file, every voxel of its body a block of cells."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

from tsg_micro.data.errors import InputError
from workflows.runs.body_dns import FACTORS, body_dns
from workflows.runs.solve_scene import scene_parameters
from workflows.scenes.model import SceneModel
from workflows.scenes.scene import build

__all__ = ["dns_scene"]


def dns_scene(
    out: Path,
    model: SceneModel,
    *,
    linear_solver: str = "auto",
    plots: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Load the body with every bar and tendon in the steps of the scene, in four where it has one; see body_dns.

    Raises:
        InputError: the scene is not valid, its tissues differ in more than the bar force, or as body_dns.
        ConvergenceError: the equilibrium was lost.
    """
    body = model.body.model_copy(update={"graded": False})
    built = build(MPI.COMM_WORLD, model.model_copy(update={"body": body}))
    first, *others = built.tissues
    for name, tissue in zip(built.names[1:], others, strict=True):
        if (tissue.cell, tissue.law, tissue.unit) != (first.cell, first.law, first.unit):
            raise InputError(f"tissue.{name}: expected the cells of tissue.{built.names[0]} in dns, got others")
    factors = model.solve.factors
    return body_dns(
        out,
        domain=built.domain,
        tissue=first,
        bar_force=built.bar_force,
        supports=built.supports,
        loads=built.loads,
        free=built.free,
        factors=factors if len(factors) > 1 else [part * factors[0] for part in FACTORS],
        linear_solver=linear_solver,
        parameters=scene_parameters(built),
        plots=plots,
        say=say,
    )
