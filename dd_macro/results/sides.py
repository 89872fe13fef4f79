"""What a solution does at the sides of the body, and to its volume."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dd_macro.methods.solution import Solution
from dd_macro.parallel import total
from dd_macro.scene.facets import SideFacets, ghosted

__all__ = ["side_displacement", "volume_change"]


def side_displacement(solution: Solution, side: str) -> NDArray[np.float64]:
    """Mean displacement (3,) in m of a side, by its area at rest; collective.

    Raises:
        InputError: there is no such side, or no outer facet on it.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))])
        >>> law = dd.LinearLaw(dd.isotropic(young=1e3, poisson=0.3).C)
        >>> solution = dd.LawMethod().prepare(problem, dd.Material(law=law)).solve()
        >>> float(dd.side_displacement(solution, "top")[1].round(9))
        1e-06
    """
    operator = solution.problem.operator
    facets = SideFacets(operator, side)
    u = np.einsum("fqk,fki->fqi", facets.shape, ghosted(operator, solution.mechanical.u)[facets.dofs])
    area = np.linalg.norm(facets.areas, axis=-1)
    sums = total(operator.comm, np.append(np.einsum("fq,fqi->i", area, u), area.sum()))
    return np.asarray(sums[:3] / sums[3])


def volume_change(solution: Solution) -> float:
    """Change of the body's volume over that at rest: mean of det F - 1 in finite strain, of tr epsilon in small.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))])
        >>> law = dd.LinearLaw(dd.isotropic(young=1e3, poisson=0.3).C)
        >>> solution = dd.LawMethod().prepare(problem, dd.Material(law=law)).solve()
        >>> round(dd.volume_change(solution), 4)
        0.0149
    """
    operator, z = solution.problem.operator, solution.mechanical
    if operator.theory == "small":
        change = z.strain[:, :3].sum(axis=1)
    else:
        H = operator.strain(z.u)[:, :9].reshape(-1, 3, 3)
        change = np.linalg.det(np.eye(3) + H) - 1.0
    w = operator.weights
    sums = total(operator.comm, [float(w @ change), float(w.sum())])
    return float(sums[0] / sums[1])
