"""From the residual of the material to the error of a state, by one linear solve.

The stress sigma of a state z = (epsilon, sigma) is in equilibrium, that of the material at its strain, sigma - r, is
not. With the material's tangents D the state moves by
    (sum w B^T D B) du = sum w B^T r,     d epsilon = B du,     d sigma = D d epsilon - r
to first order in r. d epsilon is compatible and d sigma in equilibrium with nothing, so where C = D
    |d epsilon|_C^2 + |d sigma|_{C^-1}^2 = |r|_{C^-1}^2      (Prager and Synge)
the residual is the error in the energy norm, and elsewhere close to it. In finite strain all of it are Biot strain and
stress, and the matrix has the terms of the stress too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dd_macro.material.metric import Metric
from dd_macro.methods.projection import MechanicalState
from dd_macro.parallel import total
from dd_macro.products import times
from dd_macro.scene.linear import LinearSolver
from dd_macro.scene.problem import Problem
from tsg_micro.data.errors import ConvergenceError

__all__ = ["Correction", "correct"]

Array = NDArray[np.float64]
_CLOSE = 1e-4
"""Residual of the linear solve, relative: the error is wanted to two digits."""


@dataclass(frozen=True)
class Correction:
    """Lengths in sqrt(J) in a metric, of the whole body: the change of the state, the corrected state, the residual r
    as the stress of a state. ``change`` may be the residual where no matrix could be had (``linear`` is False).
    """

    change: float
    state: float
    residual: float
    linear: bool = True


def correct(
    problem: Problem,
    z: MechanicalState,
    residual: Array,
    tangents: Array,
    own: NDArray[np.int64],
    metric: Metric,
    *,
    older: LinearSolver | None = None,
) -> Correction:
    """The correction of ``z`` for the ``residual`` (n, 6) in Pa of the material; collective.

    Of its ``tangents`` (k, 6, 6) in Pa each point has its ``own`` (n,). The solver has PETSc options with the prefix
    ``dd_check_``; the factorisation of an ``older`` one of the same problem is used where that will do, and one that
    iterates takes the new values itself, since two of them would be most of the memory. Where the tangents give no
    matrix that can be solved, as those of a tissue that lost its stability, the residual is taken for the change.
    """
    op = problem.operator
    found, linear = op.local(op.strain(z.u)), True
    try:
        moduli: tuple[Array, NDArray[np.int64] | None] = tangents, own
        if op.theory != "small":
            moduli = found.nominal_tangent(z.stress - residual, tangents[own]), None
        solver = None if older is None or older.direct else older
        matrix = op.stiffness() if solver is None else solver.stiffness
        problem.add_load_stiffness(z.u, matrix.assemble(0.5 * (moduli[0] + moduli[0].swapaxes(1, 2)), moduli[1]))
        if solver is None:
            solver = LinearSolver(problem, matrix, prefix="dd_check_", definite=False, older=older)
        else:
            solver.update(keep=True)
        out = problem.out_of_balance(found.nominal_stress(z.stress - residual), z.u)
        du = solver.solve(-out, within=_CLOSE)
        strain = op.local(op.strain(z.u + du)).strain - found.strain
        change = strain, times(tangents, own, strain) - residual
    except ConvergenceError:  # on all ranks alike
        change, linear = (np.zeros_like(z.strain), -residual), False
    lengths = [
        op.weights @ metric.squares(*pair)
        for pair in (change, (z.strain + change[0], z.stress + change[1]), (np.zeros_like(residual), residual))
    ]
    squares = total(op.comm, lengths)
    moved, state, left = (float(length) for length in np.sqrt(squares))
    return Correction(moved, state, left, linear)
