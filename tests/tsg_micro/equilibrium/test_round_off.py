"""Stiff members under little force: a residual of round-off alone ends the iteration, and the answer is right.

Twisted prisms, with EA up to 1e10 times the member forces. The truth is the same equilibrium refined with residuals in
extended precision.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.linalg import null_space

import tsg_micro.equilibrium.newton as newton_module
from tsg_micro.cells.structure import equilibrium_matrix, from_arrays, member_vectors
from tsg_micro.equilibrium.load_path import EquilibriumSolver


def prism(ratio, *, size=1.0, corners=3):
    """A prestressed prism with mean member force 1 N and EA = ratio; held at its base, pushed at its top."""
    a, twist = 2 * np.pi / corners * np.arange(corners), np.pi / 2 - np.pi / corners
    rings = [np.column_stack([np.cos(a + t), np.sin(a + t), np.full(corners, z)]) for t, z in ((0, 0), (twist, 1))]
    i, j = np.arange(corners), (np.arange(corners) + 1) % corners
    members = np.vstack([np.c_[i, j], np.c_[i, j] + corners, np.c_[i, i + corners], np.c_[i, j + corners]])
    kind = np.r_[np.ones(3 * corners), np.full(corners, 2)]
    one = np.ones(len(members))
    structure = from_arrays(size * np.vstack(rings), members, kind=kind, EA=ratio * one, rest_length=one)
    length = np.linalg.norm(member_vectors(structure), axis=1)
    (q,) = null_space(equilibrium_matrix(structure).toarray(), rcond=1e-12).T
    force = q * np.sign(q[0]) * length
    force /= np.abs(force).mean()
    fixed = np.zeros((2 * corners, 3), dtype=bool)
    fixed[:corners] = True
    load = np.zeros(fixed.shape)
    load[corners:, 2], load[corners, 0] = -0.3, 0.1
    return dataclasses.replace(structure, rest_length=ratio * length / (ratio + force)), fixed, load


def refined(structure, fixed, load, displacement, tangent):
    """Displacements after corrections by residuals in extended precision."""
    x, EA, rest = (np.asarray(a, dtype=np.longdouble) for a in (structure.nodes, structure.EA, structure.rest_length))
    u = displacement.astype(np.longdouble)
    i, j = structure.members.T
    free = ~fixed.ravel()
    for _ in range(6):
        d = (x + u)[j] - (x + u)[i]
        length = np.sqrt((d**2).sum(axis=1))
        pull = (EA * (length - rest) / rest / length)[:, None] * d
        out = load.astype(np.longdouble)
        np.add.at(out, i, pull)
        np.add.at(out, j, -pull)
        step = np.zeros(u.size)
        step[free] = tangent.solve(out.ravel()[free].astype(float), np.zeros(0))[0]
        u = u + step.reshape(u.shape)
    return u.astype(float), (EA * (length - rest) / rest).astype(float)


@pytest.mark.parametrize("size", [1.0, 1e-5])
@pytest.mark.parametrize("ratio", [1e3, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10])
@pytest.mark.parametrize("corners", [3, 5])
def test_stiff_prisms_reach_their_equilibrium(ratio, size, corners):
    structure, fixed, load = prism(ratio, size=size, corners=corners)
    solver = EquilibriumSolver(structure, fixed=fixed)
    result = solver.solve(force=load)
    assert result.residual < max(1e-10, 4 * np.finfo(float).eps * ratio)
    truth, force = refined(structure, fixed, load, result.displacement, solver.tangent())
    assert np.abs(result.displacement - truth).max() < 1e-10 * size
    assert np.abs(result.members.force - force).max() < max(1e-10, 10 * np.finfo(float).eps * ratio)


@pytest.mark.parametrize("bar_force", [1e-11, 1e-12])
def test_a_cell_under_next_to_no_prestress(box, bar_force):
    from tsg_micro.cells.lattice import side_nodes

    structure = box(1, 1, 1, bar_force=bar_force)
    fixed = np.zeros(structure.nodes.shape, dtype=bool)
    fixed[side_nodes(structure, 2, end="low")] = True
    force = np.zeros(structure.nodes.shape)
    force[side_nodes(structure, 2, end="high"), 2] = -0.05 * bar_force
    solver = EquilibriumSolver(structure, fixed=fixed)
    result = solver.solve(force=force, stable=True)
    assert result.negative_pivots == 0
    truth, _ = refined(structure, fixed, force, result.displacement, solver.tangent())
    assert np.abs(result.displacement - truth).max() < 1e-8 * structure.size.max()


def test_where_the_tolerance_is_reached_nothing_changes(monkeypatch):
    """The rule takes over only where 25 iterates within round-off have not met the tolerance."""
    structure, fixed, load = prism(1e7)
    with_rule = EquilibriumSolver(structure, fixed=fixed).solve(force=load)
    monkeypatch.setattr(newton_module.NewtonSolver, "_round_off", lambda *_: 0.0)
    without = EquilibriumSolver(structure, fixed=fixed).solve(force=load)
    assert without.residual <= 1e-10
    np.testing.assert_array_equal(with_rule.displacement, without.displacement)
    assert with_rule.iterations == without.iterations
