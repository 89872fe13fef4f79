"""What every method gives: the state of a problem, and how well it is the material's; dd_macro.results writes it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.metric import Metric
from dd_macro.methods.projection import MechanicalState
from dd_macro.parallel import total
from dd_macro.scene.linear import LinearSolver
from dd_macro.scene.problem import Problem
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.display import Displayed

__all__ = ["Solution"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, repr=False)
class Solution(Displayed):
    """Mechanical and material state of ``problem``; arrays hold what this rank owns, numbers are of the whole body.

    ``mechanical`` has u, eta, strain and stress; ``material_strain`` (n, 6), ``material_stress`` (n, 6) in Pa are what
    the material answers, ``index`` (n,) the data, -1 where there are none, ``local_distance`` (n,) in sqrt(J/m^3).
    ``distance`` = |y - z| in sqrt(J), ``normalised_distance`` = |y - z| / |z| (paper, Section 4.2), in ``metric``; it
    is None where the material is a law: its states are the mechanical ones. ``solver`` is that of the linear systems,
    ``dataset`` the data that it was found with. ``reason`` says why it ended after so many ``iterations``.
    """

    problem: Problem
    metric: Metric | None
    mechanical: MechanicalState
    material_strain: Array
    material_stress: Array
    index: NDArray[np.int64]
    local_distance: Array
    distance: float
    normalised_distance: float
    iterations: int
    converged: bool
    reason: str
    solver: str
    support: Array | None = None
    """What clamps carry beside the stress at the points (n, 6), Pa; dd_macro.in_space adds it to both stresses."""
    dataset: Dataset | None = None
    linear: LinearSolver | None = field(default=None, repr=False, compare=False)
    """That of the last tangents, whose factorisation near matrices may go on with."""

    def _display(self) -> tuple[str, dict[str, object]]:
        operator = self.problem.operator
        how = "converged" if self.converged else "not converged"
        return f"{type(self).__name__}: {how} ({self.reason}), {self.note}", {
            "body": f"{operator.domain.global_cells} hexahedra, {operator.global_dofs} unknowns",
            "normalised distance": f"{self.normalised_distance:.2%}",
            "data": "" if self.dataset is None else len(self.dataset),
            "linear solver": self.solver,
        }

    @property
    def note(self) -> str:
        """How it went."""
        return f"{self.iterations} iterations"

    def reaction(self, side: str) -> Array:
        """Force (3,) in N that the supports of ``side`` exert on the body; collective.

        Raises:
            InputError: no such side.
        """
        return self.problem.support_force(
            side, self.problem.out_of_balance(self.mechanical.nominal_stress, self.mechanical.u)
        )

    def figures(self) -> dict[str, tuple[Any, str]]:
        """Numbers of the solution for a summary, each with its unit; collective."""
        operator = self.problem.operator
        found: dict[str, tuple[Any, str]] = {
            "iterations": (self.iterations, ""),
            "normalised_distance": (self.normalised_distance, "1"),
            "quadrature_points": (int(total(operator.comm, len(operator.weights))), ""),
            "dofs": (operator.global_dofs, ""),
            "ranks": (operator.comm.size, ""),
            "linear_solver": (self.solver, ""),
        }
        return found if self.dataset is None else found | {"data_points": (len(self.dataset), "")}
