"""Self-stress states and mechanisms of structures that are too large for an SVD, counted by the inertia of a matrix."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from tsg_micro.cells.prestress import self_stress
from tsg_micro.cells.structure import Structure, equilibrium_matrix, member_vectors
from tsg_micro.equilibrium.linear_solvers import choose_backend, make_solver

__all__ = ["self_stress_counts"]

_SVD_MEMBERS = 1000


def self_stress_counts(structure: Structure) -> tuple[int, int, str]:
    """Number of self-stress states, of internal mechanisms, and how they were found.

    Small structures by SVD; large ones by the inertia of A_eq^T A_eq - d 1, whose negative pivots are the singular
    values of A_eq below sqrt(d), here 1e-4 of the longest member; the spheroid has none between round-off and 1e-3.
    """
    m = len(structure.members)
    if m <= _SVD_MEMBERS:
        svd = self_stress(structure)
        return svd.states.shape[1], svd.mechanisms, "singular value decomposition"
    A = equilibrium_matrix(structure)
    gram = sp.triu(A.T @ A, format="csr")
    gram.sort_indices()
    length = np.linalg.norm(member_vectors(structure), axis=1).max()
    gram.setdiag(gram.diagonal() - (1e-4 * length) ** 2)
    choice = choose_backend(m)
    solver = make_solver(gram.indptr.astype(np.int32), gram.indices.astype(np.int32), choice.backend)
    states = solver.factorise(gram.data).negative_pivots
    rigid = 3 if any(structure.periodic) else 6
    return states, structure.nodes.size - (m - states) - rigid, f"inertia of A^T A, by {choice.backend}"
