"""FE2 as the reference without data error: its state, errors against it, and random RVE states of its strains."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import dd_macro as dd
from dd_macro.methods.projection import relative_distance
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import state_dataset
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import pressure, von_mises
from workflows.runs.loads import LOADS
from workflows.runs.scene import OLDER, Scene
from workflows.store.record import read_summary, versions
from workflows.studies.methods import adaptive

__all__ = ["Exact", "box_states", "check_fe2", "fe2_parameters", "read_exact"]

Array = NDArray[np.float64]
_INVARIANTS = {"p": pressure, "q": von_mises}
_NAMES = ("p", "q", "p_mat", "q_mat", "state")


@dataclass(frozen=True)
class Exact:
    """A scene, and FE2's strain (n, 6) and stress (n, 6) in Pa at its quadrature points, in this process.

    ``metric`` is that in which states are compared, from secants of the solution itself.
    """

    scene: Scene
    problem: dd.Problem
    strain: Array
    stress: Array
    metric: dd.Metric
    inner: NDArray[np.bool_]

    @property
    def symbol(self) -> str:
        """p or q, whose error counts."""
        return LOADS[self.scene.load].symbol

    @property
    def operator(self) -> dd.StrainOperator:
        """B and W."""
        return self.problem.operator

    def projection(self, dataset: Dataset, order: int) -> dd.Projection:
        """The scene with the default metric of the data for solves of ``order``."""
        return dd.project(self.problem, dd.choose_metric("auto", self.problem, dataset, order=order))

    def adapted(self, tissue: Tissue, budget: int) -> dd.AdaptiveResult:
        """An adaptive run from nothing that uses all of its ``budget``.

        Raises:
            ConvergenceError: a solve failed.
        """
        return adaptive(self.problem, self.scene, tissue=tissue, budget=budget)

    def errors(self, result: dd.Solution) -> dict[str, float | None]:
        """Relative errors (l2): p and q of the inner blocks, mechanical and material, and the state in the metric."""
        result = dd.in_space(result)
        z = result.mechanical
        exact = self.operator.cell_mean(self.stress)[self.inner]
        errors: dict[str, float | None] = {}
        for suffix, stress in (("", z.stress), ("_mat", result.material_stress)):
            mean = self.operator.cell_mean(stress)[self.inner]
            for name, invariant in _INVARIANTS.items():
                a, b = invariant(mean), invariant(exact)
                errors[name + suffix] = float(np.linalg.norm(a - b) / np.linalg.norm(b))
        errors["state"] = relative_distance(self.operator, self.metric, z, self)
        return errors | {"held": getattr(result, "held", 0)}

    @staticmethod
    def no_errors() -> dict[str, float | None]:
        """The same of a solve that did not converge."""
        return dict.fromkeys((*_NAMES, "held"))


def fe2_parameters(fe2: Path) -> dict[str, Any]:
    """The parameters of the run in folder ``fe2``; what an older run does not say is at its default.

    Raises:
        InputError: it is not there.
    """
    said = read_summary(fe2, "fe2")["parameters"]
    scene = {"kinematics": "small", "clamp": "full", "degree": 1, "flat": False, **OLDER}
    if said.get("degree", 1) > 1:
        scene["element"] = None
    return scene | Tissue().as_dict() | said


def check_fe2(fe2: Path, scene: Scene, tissue: Tissue) -> None:
    """Raise InputError where the run in folder ``fe2`` is not there, or of another scene or tissue."""
    there = fe2_parameters(fe2)
    for name, wanted in {**scene.parameters(), **tissue.as_dict()}.items():
        found = tuple(there[name]) if isinstance(there.get(name), list) else there.get(name)
        if found != wanted:
            raise InputError(f"fe2: expected {name} {wanted} in {fe2}, got {found}")


def read_exact(fe2: Path, scene: Scene, tissue: Tissue) -> Exact:
    """What the run in folder ``fe2`` left.

    Raises:
        InputError: it is not there, or of another scene or tissue.
    """
    check_fe2(fe2, scene, tissue)
    fields = dd.read_quadrature(fe2 / "quadrature.h5")
    problem = scene.problem(MPI.COMM_SELF, tissue)
    operator, domain = problem.operator, problem.operator.domain
    rows = domain.mesh.topology.original_cell_index[: domain.owned_cells]
    strain, stress = (a[rows].reshape(-1, 6) for a in (fields.mechanical_strain, fields.mechanical_stress))
    metric = dd.secant_modulus(Dataset(strain, stress, fields.stress_measure, **_points(len(strain))))
    inner = dd.interior_blocks(operator.cell_corners.mean(axis=1))
    return Exact(scene, problem, strain, stress, metric, inner)


def box_states(*, low: Array, high: Array, tissue: Tissue, states: int, seed: int) -> Dataset:
    """RVE states of a sheet, with tangents, at random strains (Mandel) in a box from ``low`` to ``high`` (6,).

    Strains where the RVE has no equilibrium are drawn anew; the parameters say how many there were.

    Raises:
        ConvergenceError: more strains failed than there are to be ``states``.
    """
    rng, spec = np.random.default_rng(seed), RVESpec(tissue, free=())
    rve = spec.build()
    found: list[Any] = []
    failed = 0
    with threadpool_limits(1):
        while len(found) < states:
            rve.reset()
            try:
                found.append(rve.solve_strain(rng.uniform(low, high)))
            except (ConvergenceError, InputError) as error:  # the latter: inside out
                failed += 1
                if failed > states:
                    raise ConvergenceError(f"RVEs in the box of strains: most have no equilibrium, {error}") from None
    box = {"name": "random", "low": low.tolist(), "high": high.tolist(), "free": []}
    return state_dataset(
        F=np.array([state.F for state in found]),
        first_piola=np.array([state.first_piola for state in found]),
        tangent=np.array([state.tangent for state in found]),
        energy=np.array([state.energy for state in found]),
        **_points(states),
        parameters={
            "bar_force": tissue.bar_force,
            "box": box,
            "failed": failed,
            "images": "merged",
            **spec.parameters(),
        },
        versions=versions(),
    )


def _points(count: int) -> dict[str, Any]:
    """Each state is a path of its own."""
    return {"path": np.arange(count), "step": np.zeros(count, dtype=np.int64)}
