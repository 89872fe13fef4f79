"""States of an RVE in batches: what each gives alone, on the same branch, and what is left out of a batch and why."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve import build_rve
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES, strain_path
from tsg_micro.continuum.warm_rve import WarmRVE
from tsg_micro.continuum.warm_states import WarmStates
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import to_mandel
from tsg_micro.equilibrium.linear_solvers import BACKENDS, choose_backend
from tsg_micro.equilibrium.newton import NewtonOptions
from tsg_micro.equilibrium.newton_many import settle, solve_each

SHEET, BULK = (RVESpec.of_kind(kind, Tissue()) for kind in ("sheet", "bulk"))
KINDS = {
    "sheet": SHEET,
    "all six strains": RVESpec(Tissue(), free=()),
    "bulk": BULK,
    "free": SHEET.with_axes("free periodic free"),
    "held": SHEET.with_axes("periodic held free"),
    "corner": SHEET.with_axes("free held free"),
}


def random_strains(count):
    """At 6 % in any direction of the box of all six strains."""
    return np.array([strain_path(BOXES["full"], steps=1, seed=3, path=path)[0] for path in range(count)])


@pytest.fixture
def alone(monkeypatch):
    """Strains that were solved for one by one."""
    strains, solve = [], WarmRVE.solve

    def noted(self, strain, states, k):
        strains.append(strain)
        return solve(self, strain, states, k)

    monkeypatch.setattr(WarmRVE, "solve", noted)
    return strains


@pytest.mark.parametrize("kind", KINDS)
def test_a_batch_gives_what_each_state_gives_alone(kind, alone):
    """Two routes to stress, tangent and support stress, along paths that no batch has a part in: to 1e-9."""
    rve, goal = KINDS[kind].build(), 0.5 * random_strains(4)
    warm = WarmRVE(rve)
    states = warm.reference.take([0] * 4)
    for part in (0.5, 1.0):
        states, reached, failures = warm.solve_many(part * goal, states)
        assert (list(reached), failures) == ([0, 1, 2, 3], {})
    assert not alone or kind == "bulk"
    for k in (0, 3):
        rve.reset()
        for part in (0.5, 1.0):
            state = rve.solve_strain(part * goal[k])
        one = WarmStates.of(state, rve)
        scale, modulus = np.abs(one.stress).max(), np.abs(one.tangent).max()
        for name, size in (("stress", scale), ("support", scale), ("tangent", modulus), ("support_tangent", modulus)):
            np.testing.assert_allclose(getattr(states, name)[k], getattr(one, name)[0], atol=1e-9 * size)
        for name in ("F", "rate"):
            np.testing.assert_allclose(getattr(states, name)[k], getattr(one, name)[0], rtol=1e-5, atol=1e-9)
        assert states.energy[k] == pytest.approx(one.energy[0], rel=1e-10)


def test_a_stretch_to_15_percent_stays_on_its_branch(alone):
    """Five states far along a stretch against one RVE that goes there in sixty steps."""
    warm = WarmRVE(build_rve(bar_force=1e-8))
    direction = to_mandel(np.diag([-0.06, 0.15, 0.0]))
    goal = np.linspace(0.8, 1.0, 5)
    states = warm.reference.take([0] * 5)
    for part in np.linspace(0.1, 1.0, 10):
        states, reached, _ = warm.solve_many(np.outer(part * goal, direction), states)
        assert len(reached) == 5
    assert not alone
    rve = build_rve(bar_force=1e-8)
    for part in np.linspace(0.0, 1.0, 61)[1:]:
        state = rve.solve_strain(part * direction, tangent=part == 1.0)
    one = WarmStates.of(state, rve)
    np.testing.assert_allclose(states.stress[-1], one.stress[0], atol=1e-9 * np.abs(one.stress).max())
    np.testing.assert_allclose(states.tangent[-1], one.tangent[0], atol=1e-9 * np.abs(one.tangent).max())


def test_states_do_not_depend_on_those_beside_them():
    """To the last bit: so neither do data on how the work is shared."""
    warm, goal = WarmRVE(SHEET.build()), 0.3 * random_strains(3)
    together, apart = warm.reference.take([0] * 3), [warm.reference] * 3
    for part in (0.5, 1.0):
        together, _, _ = warm.solve_many(part * goal, together)
        apart = [warm.solve_many(part * one[None], state)[0] for one, state in zip(goal, apart, strict=True)]
    for field in fields(WarmStates):
        np.testing.assert_array_equal(
            getattr(together, field.name), np.concatenate([getattr(state, field.name) for state in apart])
        )


def test_states_that_need_more_are_left_to_the_single_solver(alone):
    """In one jump from rest some bulk RVEs are indefinite on the way; one strain is inside out."""
    warm = WarmRVE(BULK.build())
    strain = 0.2 * random_strains(6)
    strain[2] = [-1.5, 0, 0, 0, 0, 0]
    found, reached, failures = warm.solve_many(strain, warm.reference.take([0] * 6))
    assert list(reached) == [0, 1, 3, 4, 5]
    assert list(failures) == [2]
    assert "inside out" in failures[2]
    assert 1 < len(alone) < 6
    rve = BULK.build()
    for k, one in zip(reached, found.stress, strict=True):
        rve.reset()
        stress = to_mandel(rve.solve_strain(strain[k]).first_piola)
        np.testing.assert_allclose(one, stress, atol=1e-9 * np.abs(stress).max())


def test_no_state_at_all():
    warm = WarmRVE(SHEET.build())
    found, reached, failures = warm.solve_many(np.zeros((0, 6)), warm.reference.take([]))
    assert (len(found), len(reached), failures) == (0, 0, {})


def test_an_indefinite_tangent_is_not_plain():
    newton = BULK.build().solver.newton
    y = np.zeros((newton.system.size, 2))
    y[-9:, 0] = -0.05 * np.eye(3).ravel()
    y[-9:, 1] = 1e-4 * np.eye(3).ravel()
    assert newton.tangent(newton.system.state(y[:, 0])).negative_pivots > 0
    assert list(settle(newton, y).number) == [1]


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_batch_between_leaves_no_older_factor(monkeypatch, backend):
    """Backends factorise in place: what an older tangent says of its inertia is not that of the factor any more."""
    monkeypatch.setattr("tsg_micro.equilibrium.newton._LARGE", 0)
    try:
        choose_backend(1, backend)
    except InputError:
        pytest.skip(f"{backend} is not installed")
    rve = build_rve(bar_force=1e-8, options=NewtonOptions(linear_solver=backend))
    newton, system = rve.solver.newton, rve.solver.system
    y = np.zeros((system.size, 1))
    rve.solve_strain(np.zeros(6))  # a stable tangent, kept
    y[-9:, 0] = -0.05 * np.eye(3).ravel()
    _, _, (negative,) = solve_each(newton, system.state(y), np.ones((1, newton.pattern.size, 1)))
    assert newton._last_tangent(system.state(y[:, 0])).factor.negative_pivots == negative > 0
