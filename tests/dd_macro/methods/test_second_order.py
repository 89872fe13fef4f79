"""Second-order data: exact for linear laws, twice the classical rate for others, and two solvers that agree."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from dd_macro import (
    Displacement,
    Iteration,
    MaterialSearch,
    Metric,
    Projection,
    SecondOrderOptions,
    StrainOperator,
    TangentSearch,
    box,
    estimate_tangents,
    isotropic,
    read_quadrature,
    solve,
    solve_law,
    solve_second_order,
)
from dd_macro.material.tangent_spaces import SpaceProjection
from dd_macro.methods.second_order import StepName
from dd_macro.parallel import total
from tsg_micro.data.errors import ConvergenceError, InputError

pytestmark = pytest.mark.mpi
ROOT = Path(__file__).parents[3]

LINEAR = isotropic(young=1e3, poisson=0.3)
METHODS: list[StepName] = ["local-tangent", "alternating"]
LOWER, UPPER = np.array([-0.03, -0.02, -0.03]), np.array([0.03, 0.08, 0.03])


class Stiffening:
    """sigma = (1 + a e.C.e) C e, from an energy; it doubles its stiffness within the data."""

    a = 0.25

    def stress_and_tangent(self, strain):
        linear = strain @ LINEAR.C
        growth = 1 + self.a * np.einsum("ni,ni->n", strain, linear)
        tangent = growth[:, None, None] * LINEAR.C + 2 * self.a * linear[:, :, None] * linear[:, None, :]
        return growth[:, None] * linear, tangent


@pytest.fixture(scope="module")
def operator():
    return StrainOperator(box(MPI.COMM_WORLD, elements=(4, 4, 1), size=(4e-5, 4e-5, 1e-5)))


@pytest.fixture(scope="module")
def conditions():
    """Bottom and top clamped, top pulled, and plane strain in z: the strains fill a set of three dimensions."""
    flat = [Displacement("back", (0.0,), (2,)), Displacement("front", (0.0,), (2,))]
    return [*flat, Displacement("bottom"), Displacement("top", (0.0, 2e-6, 0.0))]


@pytest.fixture(scope="module")
def reference(operator, conditions):
    return solve_law(operator, Stiffening(), conditions).mechanical


@pytest.fixture
def sample(make_dataset):
    """Data of the stiffening law at random plane strains."""

    def sample(n, seed=0):
        strain = np.zeros((n, 6))
        strain[:, [0, 1, 5]] = np.random.default_rng(seed).uniform(LOWER, UPPER, (n, 3))
        stress, tangent = Stiffening().stress_and_tangent(strain)
        return make_dataset(strain, stress, tangent=tangent)

    return sample


def length(operator, metric, strain, stress):
    return np.sqrt(total(operator.comm, operator.weights @ (metric.whiten(strain, stress) ** 2).sum(axis=1)))


def error(operator, z, exact, metric=LINEAR):
    return length(operator, metric, z.strain - exact.strain, z.stress - exact.stress) / length(
        operator, metric, exact.strain, exact.stress
    )


def test_closest_point_of_a_tangent_space(rng, sample):
    """It lies in the space, what is left is normal to it in the metric, and no other point is nearer."""
    metric = Metric(1.7 * LINEAR.C, "any")
    dataset = sample(5)
    skew = rng.normal(size=(5, 6, 6))
    dataset = replace(dataset, tangent=dataset.tangent + 100 * (skew - skew.swapaxes(1, 2)))
    search = TangentSearch(dataset, metric)
    onto = SpaceProjection(search.of(np.arange(5)), metric)
    strain, stress = 0.03 * rng.normal(size=(5, 6)), 30 * rng.normal(size=(5, 6))
    e, s = onto.closest(strain, stress)
    d = e - dataset.strain
    np.testing.assert_allclose(s, dataset.stress + np.einsum("nij,nj->ni", dataset.tangent, d), rtol=1e-9, atol=1e-9)
    M = metric.C + dataset.tangent.swapaxes(1, 2) @ np.linalg.solve(metric.C, dataset.tangent)
    right = (strain - dataset.strain) @ metric.C
    right += np.einsum("nji,nj->ni", dataset.tangent, (stress - dataset.stress) @ np.linalg.inv(metric.C))
    np.testing.assert_allclose(d, np.linalg.solve(M, right[..., None])[..., 0], rtol=1e-9, atol=1e-12)
    nearest = np.linalg.norm(metric.whiten(strain - e, stress - s), axis=1)
    for _ in range(20):
        other = d + 0.01 * rng.normal(size=(5, 6))
        at = dataset.strain + other, dataset.stress + np.einsum("nij,nj->ni", dataset.tangent, other)
        assert (np.linalg.norm(metric.whiten(strain - at[0], stress - at[1]), axis=1) > nearest).all()
    np.testing.assert_allclose(np.concatenate(onto.closest(e, s)), np.concatenate([e, s]), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("skew", [0.0, 60.0])
def test_one_datum_is_enough_for_a_linear_law(operator, conditions, make_dataset, method, skew, rng):
    """The metric is another one; with skew tangents the answer is checked by equilibrium and by the law itself."""
    metric = Metric(1.7 * LINEAR.C, "not the law")
    S = rng.normal(size=(6, 6))
    D = LINEAR.C + skew * (S - S.T)
    strain = rng.normal(size=(1, 6)) * 0.02
    data = make_dataset(strain, strain @ D.T, tangent=D[None])
    scene = Projection(operator, metric, conditions)
    options = SecondOrderOptions(tolerance=1e-10)
    result = solve_second_order(scene, TangentSearch(data, metric), method=method, options=options)
    z = result.mechanical
    np.testing.assert_allclose(z.stress, z.strain @ D.T, atol=1e-6 * np.abs(z.stress).max())
    assert scene.residual(z.stress) < 1e-9
    if skew == 0:
        exact = Projection(operator, LINEAR, conditions).elastic()
        assert error(operator, z, exact) < 1e-7
    assert result.normalised_distance < 1e-7
    assert result.extrapolated == 0


def test_error_falls_at_twice_the_classical_rate(operator, conditions, reference, sample):
    """Data in three dimensions: N^(-1/3) for the nearest datum, N^(-2/3) for its tangent space."""
    metric = Metric(2 * LINEAR.C, "about the tangent that the scene sees, which the classical solver needs")
    scene = Projection(operator, metric, conditions)
    numbers = np.array([100, 800, 6400])
    errors = np.zeros((2, len(numbers)))
    for i, n in enumerate(numbers):
        for seed in range(4):
            data = sample(n, seed)
            first = solve(scene, MaterialSearch(data, metric)).mechanical
            second = solve_second_order(scene, TangentSearch(data, metric)).mechanical
            errors[:, i] += [error(operator, first, reference) / 4, error(operator, second, reference) / 4]
    classical, tangent = -np.polyfit(np.log(numbers), np.log(errors.T), 1)[0]
    assert 0.25 < classical < 0.42
    assert 0.57 < tangent < 0.85
    assert tangent > 1.8 * classical
    assert errors[1, -1] < 0.002 < 0.05 < errors[0, -1]


def test_both_methods_agree(operator, conditions, sample):
    metric = Metric(1.5 * LINEAR.C, "a guess")
    scene, data = Projection(operator, metric, conditions), sample(400)
    one, two = (
        solve_second_order(
            scene, TangentSearch(data, metric), method=method, options=SecondOrderOptions(tolerance=1e-9)
        )
        for method in METHODS
    )
    agree = total(operator.comm, [(one.index == two.index).sum(), len(one.index)])
    assert agree[0] >= 0.98 * agree[1]  # a point between two data may have either
    assert error(operator, one.mechanical, two.mechanical) < 1e-3
    assert one.iterations < two.iterations
    assert one.lookups == one.iterations + 1
    for result in (one, two):
        assert scene.residual(result.mechanical.stress) < 1e-9
        assert result.normalised_distance < 1e-7
        held = f", {result.held} points held between data" if result.held else ""
        assert result.reason == "no datum changed" + held


def test_alternating_projections_lower_the_distance_in_every_step(operator, conditions, sample):
    """As long as the data are the same; and they end where the local tangents do, so few iterations are no luck."""
    metric = Metric(6 * LINEAR.C, "far too stiff")
    scene = Projection(operator, metric, conditions)
    result = solve_second_order(scene, TangentSearch(sample(1), metric), method="alternating")
    distances = np.array([h.distance for h in result.history if h.changed == 0])
    assert len(distances) > 5
    # a new call begins with the distance where the last one stopped, a little lower
    assert (np.diff(distances) < 0).all()
    assert result.iterations < 100


def test_metric_hardly_matters(operator, conditions, reference, sample):
    data = sample(400)
    errors = []
    for factor in (0.1, 1.0, 10.0):
        metric = Metric(factor * LINEAR.C, "scaled")
        result = solve_second_order(Projection(operator, metric, conditions), TangentSearch(data, metric))
        errors.append(error(operator, result.mechanical, reference))
    assert max(errors) < 0.01


def test_silent_directions_of_the_data_are_covered_by_their_tangents(operator, conditions, reference, sample):
    """Data without any shear: the scene has it, the classical solver locks, the tangents know the stiffness."""
    strain = sample(2000).strain.copy()
    strain[:, 5] = 0.0
    stress, tangent = Stiffening().stress_and_tangent(strain)
    data = replace(sample(2000), strain=strain, stress=stress, tangent=tangent)
    scene = Projection(operator, LINEAR, conditions)
    second = solve_second_order(scene, TangentSearch(data, LINEAR))
    first = solve(scene, MaterialSearch(data, LINEAR))
    assert error(operator, second.mechanical, reference) < 0.03
    assert error(operator, second.mechanical, reference) < 0.3 * error(operator, first.mechanical, reference)


def test_estimated_tangents_of_a_linear_law_are_exact(rng, make_dataset):
    """In spanned directions, whatever the metric; what is not spanned gets the C of the metric on top."""
    D = LINEAR.C + 100 * np.diag([1, 2, 3, 4, 5, 6.0])
    strain = 0.02 * rng.normal(size=(60, 6))
    full = estimate_tangents(make_dataset(strain, strain @ D + 3.0), neighbours=40)
    assert full.tangent is not None
    np.testing.assert_allclose(full.tangent, np.broadcast_to(D, (60, 6, 6)), rtol=1e-7, atol=1e-4)
    strain[:, [2, 5]] = 0.0
    part = estimate_tangents(make_dataset(strain, strain @ D), neighbours=40, metric=LINEAR).tangent
    assert part is not None
    sampled = [0, 1, 3, 4]
    np.testing.assert_allclose(part[:, sampled], np.broadcast_to(D[sampled], (60, 4, 6)), rtol=1e-7, atol=1e-4)
    coupling = D[np.ix_([2], sampled)] @ np.linalg.solve(D[np.ix_(sampled, sampled)], D[np.ix_(sampled, [2])])
    own = LINEAR.C - LINEAR.C[:, sampled] @ np.linalg.solve(LINEAR.C[np.ix_(sampled, sampled)], LINEAR.C[sampled])
    np.testing.assert_allclose(part[:, 2, 2] - coupling[0, 0], own[2, 2], rtol=1e-6)
    np.testing.assert_allclose(part[:, 5, 5], own[5, 5], rtol=1e-6)
    assert (np.linalg.eigvalsh(part) > 0).all()


def test_estimated_tangents_are_nearly_as_good_as_exact_ones(operator, conditions, reference, sample):
    metric = Metric(1.5 * LINEAR.C, "a guess")
    scene, data = Projection(operator, metric, conditions), sample(1500)
    estimated = estimate_tangents(replace(data, tangent=None), metric=metric)
    classical = error(operator, solve(scene, MaterialSearch(data, metric)).mechanical, reference)
    exact, near = (
        error(operator, solve_second_order(scene, TangentSearch(d, metric)).mechanical, reference)
        for d in (data, estimated)
    )
    assert exact < near < 0.02
    assert near < 0.3 * classical


def test_more_neighbours_take_out_noise(operator, conditions, make_dataset):
    """A linear law measured with 5 % scatter: the error falls with the number of data that are averaged."""
    scene = Projection(operator, LINEAR, conditions)
    exact = scene.elastic()
    errors: dict[int, list[float]] = {1: [], 8: [], 40: []}
    for seed in range(3):
        rng = np.random.default_rng(seed)
        strain = np.zeros((2000, 6))
        strain[:, [0, 1, 5]] = rng.uniform(LOWER, UPPER, (2000, 3))
        stress = strain @ LINEAR.C
        data = make_dataset(strain, stress + 0.05 * stress.std(axis=0).max() * rng.normal(size=stress.shape))
        data = estimate_tangents(data, neighbours=100, metric=LINEAR)
        for neighbours, list_of in errors.items():
            search = TangentSearch(data, LINEAR, neighbours=neighbours)
            list_of.append(error(operator, solve_second_order(scene, search).mechanical, exact))
    one, eight, forty = (np.mean(e) for e in errors.values())
    assert eight < 0.8 * one
    assert forty < 0.8 * eight
    assert forty < 0.03


def test_average_of_tangent_spaces_is_exact_for_linear_data_and_continuous(rng, make_dataset):
    strain = rng.normal(size=(50, 6)) * 0.02
    data = make_dataset(strain, strain @ LINEAR.C, tangent=np.broadcast_to(LINEAR.C, (50, 6, 6)).copy())
    search = TangentSearch(data, LINEAR, neighbours=5)
    line = np.linspace(0, 1, 4001)[:, None] * strain[7] + np.linspace(1, 0, 4001)[:, None] * strain[8]
    spaces = search.spaces(line, line @ LINEAR.C)
    np.testing.assert_allclose(spaces.stress, spaces.strain @ LINEAR.C, rtol=1e-9, atol=1e-9)
    assert len(np.unique(spaces.index)) > 1
    assert np.abs(np.diff(spaces.strain, axis=0)).max() < 0.02 * np.abs(strain).max()


def test_extrapolation_is_told_and_cut_off(operator, conditions, sample):
    data = sample(300)
    near = replace(data, strain=0.01 * data.strain)
    stress, tangent = Stiffening().stress_and_tangent(near.strain)
    near = replace(near, stress=stress, tangent=tangent)
    scene = Projection(operator, LINEAR, conditions)
    inside, outside = (solve_second_order(scene, TangentSearch(d, LINEAR)) for d in (data, near))
    assert inside.extrapolated < 0.02
    assert outside.extrapolated > 0.9
    assert outside.normalised_distance > 0.5
    assert inside.normalised_distance < 0.05


def test_no_convergence_is_an_error_with_history(operator, conditions, sample):
    scene = Projection(operator, LINEAR, conditions)
    for method in METHODS:
        with pytest.raises(ConvergenceError, match="within 2 iterations") as caught:
            solve_second_order(
                scene,
                TangentSearch(sample(2000), LINEAR),
                method=method,
                options=SecondOrderOptions(max_iterations=2),
            )
        assert [isinstance(h, Iteration) for h in caught.value.history] == [True, True]


@pytest.mark.parametrize("neighbours", [1, 4])
def test_points_between_noisy_data_are_held_and_told(operator, conditions, sample, neighbours, rng):
    """Tangents from few data with scatter: the picks never settle by themselves, the end comes all the same."""
    data = sample(1000)
    data = replace(data, stress=data.stress + 0.3 * data.stress.std(axis=0) * rng.normal(size=data.stress.shape))
    data = estimate_tangents(data, neighbours=8, metric=LINEAR)
    scene = Projection(operator, LINEAR, conditions)
    options = SecondOrderOptions(hold_after=4)
    result = solve_second_order(scene, TangentSearch(data, LINEAR, neighbours=neighbours), options=options)
    assert result.held > 0
    assert f"{result.held} points held between data" in result.reason
    assert scene.residual(result.mechanical.stress) < 1e-9
    if neighbours == 1:
        assert result.lookups <= 5


def test_bad_arguments(operator, conditions, sample, make_dataset):
    scene, data = Projection(operator, LINEAR, conditions), sample(10)
    with pytest.raises(InputError, match="expected tangents, got none"):
        TangentSearch(replace(data, tangent=None), LINEAR)
    with pytest.raises(InputError, match="neighbours: expected 1 to 10"):
        TangentSearch(data, LINEAR, neighbours=11)
    with pytest.raises(InputError, match="trust: expected a positive number"):
        TangentSearch(data, LINEAR, trust=0.0)
    with pytest.raises(InputError, match="method: expected alternating or local-tangent, got 'newton'"):
        solve_second_order(scene, TangentSearch(data, LINEAR), method="newton")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="same C in the projection"):
        solve_second_order(scene, TangentSearch(data, Metric(2 * LINEAR.C, "other")))
    with pytest.raises(InputError, match="hold_after: expected at least 1"):
        SecondOrderOptions(hold_after=0)
    with pytest.raises(InputError, match="tolerance: expected a number between 0 and 1"):
        SecondOrderOptions(tolerance=0.0)
    with pytest.raises(InputError, match="neighbours: expected 3 to 9"):
        estimate_tangents(data, neighbours=10)
    same = make_dataset(np.ones((20, 6)), np.arange(120.0).reshape(20, 6))
    with pytest.raises(InputError, match="expected different strains"):
        estimate_tangents(same, metric=LINEAR)


SOLVE = """
import sys
import dd_macro
import numpy as np
from mpi4py import MPI
from tsg_micro.data.dataset import Dataset

comm = MPI.COMM_WORLD
C = dd_macro.isotropic(young=1e3, poisson=0.3).C
metric = dd_macro.Metric(1.5 * C, "a guess")
strain = np.zeros((500, 6))
strain[:, [0, 1, 5]] = np.random.default_rng(0).uniform([-0.03, -0.02, -0.03], [0.03, 0.08, 0.03], (500, 3))
linear = strain @ C
growth = 1 + 0.25 * np.einsum("ni,ni->n", strain, linear)
data = Dataset(
    strain=strain,
    stress=growth[:, None] * linear,
    tangent=growth[:, None, None] * C + 0.5 * linear[:, :, None] * linear[:, None, :],
    stress_measure="first_piola",
    path=np.zeros(500, dtype=int),
    step=np.arange(500),
)
operator = dd_macro.StrainOperator(dd_macro.box(comm, elements=(6, 5, 1), size=(6e-5, 5e-5, 1e-5)))
clamps = [dd_macro.Displacement("bottom"), dd_macro.Displacement("top", (1e-6, 2e-6, 0.0))]
scene = dd_macro.Projection(operator, metric, clamps, [dd_macro.Traction("right", (5.0, 0.0, 0.0))])
search = dd_macro.TangentSearch(data, metric, neighbours=int(sys.argv[3]))
result = dd_macro.solve_second_order(scene, search, method=sys.argv[2])
dd_macro.write_quadrature(sys.argv[1], operator, result, stress_measure="first_piola")
pull = scene.reaction(result.mechanical, "top")
if comm.rank == 0:
    print(result.iterations, result.lookups, result.extrapolated, *pull)
"""


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts mpirun itself")
@pytest.mark.parametrize(("method", "neighbours"), [("local-tangent", 4), ("alternating", 1)])
def test_same_answer_on_1_and_2_ranks(mpirun, tmp_path, method, neighbours):
    env = {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    numbers, fields = [], []
    for ranks in (1, 2):
        file = tmp_path / f"{ranks}.h5"
        done = mpirun(ranks, sys.executable, "-c", SOLVE, file, method, neighbours, env=env)
        assert done.returncode == 0, done.stderr
        numbers.append(np.array(done.stdout.split()[-6:], dtype=float))
        fields.append(read_quadrature(file))
    assert numbers[0][0] > 3
    np.testing.assert_allclose(numbers[1], numbers[0], rtol=1e-7, atol=1e-7 * np.abs(numbers[0][3:]).max())
    np.testing.assert_array_equal(fields[1].datum, fields[0].datum)
    scale = np.abs(fields[0].mechanical_stress).max()
    np.testing.assert_allclose(fields[1].mechanical_stress, fields[0].mechanical_stress, atol=1e-6 * scale)
    np.testing.assert_allclose(fields[1].material_stress, fields[0].material_stress, atol=1e-6 * scale)
