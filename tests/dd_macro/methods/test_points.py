"""The data-driven solve: patch test, convergence with the number of data, monotone end, honest failures."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from dd_macro import (
    Displacement,
    Iteration,
    MaterialSearch,
    Metric,
    Projection,
    SolverOptions,
    StrainOperator,
    box,
    isotropic,
    solve,
)
from dd_macro.parallel import total
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import to_mandel

pytestmark = pytest.mark.mpi

LAW = isotropic(young=1e3, poisson=0.3)
H = np.array([[0.02, 0.01, 0.0], [-0.005, 0.03, 0.004], [0.0, 0.002, -0.01]])


@pytest.fixture(scope="module")
def operator():
    return StrainOperator(box(MPI.COMM_WORLD, elements=(4, 4, 1), size=(4e-5, 4e-5, 1e-5)))


def test_patch_exact_datum_is_found_from_a_wrong_start(operator, rng, make_dataset):
    """One datum is the exact state, the others surround it; the start and the metric know nothing of it."""
    metric = Metric(1.7 * LAW.C, "not the law")
    exact = to_mandel(H)
    strain = exact + 0.02 * rng.normal(size=(60, 6))
    strain[17] = exact
    stress = strain @ LAW.C
    sides = [Displacement(side, lambda x: x @ H.T) for side in operator.domain.names]
    result = solve(Projection(operator, metric, sides), MaterialSearch(make_dataset(strain, stress), metric))
    np.testing.assert_array_equal(result.index, 17)
    x = operator.node_coordinates()
    np.testing.assert_allclose(result.mechanical.u.reshape(-1, 3), x @ H.T, atol=1e-17)
    np.testing.assert_allclose(result.mechanical.stress, np.broadcast_to(stress[17], (len(result.index), 6)), atol=1e-9)
    assert result.normalised_distance < 1e-12
    assert result.converged
    assert result.outside_data == 0.0


def clamped_stretch(operator, metric):
    """Bottom and top clamped, top pulled, and plane strain in z: the strains fill a set of three dimensions."""
    flat = [Displacement("back", (0.0,), (2,)), Displacement("front", (0.0,), (2,))]
    return Projection(operator, metric, [*flat, Displacement("bottom"), Displacement("top", (0.0, 2e-6, 0.0))])


def test_error_falls_with_the_number_of_data_like_theory(operator, make_dataset):
    """Linear data random in a box of in-plane strains (d = 3): both the distance and the error go like N^(-1/3)."""
    metric = Metric(1.5 * LAW.C, "stiffer than the law, so that the start is not the solution")
    scene = clamped_stretch(operator, metric)
    reference = clamped_stretch(operator, LAW).elastic()

    def norm(strain, stress):
        return np.sqrt(total(operator.comm, operator.weights @ (metric.whiten(strain, stress) ** 2).sum(axis=1)))

    lower, upper = np.array([-0.03, -0.02, -0.03]), np.array([0.03, 0.08, 0.03])
    numbers = np.array([100, 800, 6400, 51200])
    errors = []
    for n in numbers:
        trials = []
        for seed in range(3):
            strain = np.zeros((n, 6))
            strain[:, [0, 1, 5]] = np.random.default_rng(seed).uniform(lower, upper, (n, 3))
            z = solve(scene, MaterialSearch(make_dataset(strain, strain @ LAW.C), metric)).mechanical
            trials.append(norm(z.strain - reference.strain, z.stress - reference.stress))
        errors.append(np.mean(trials) / norm(reference.strain, reference.stress))
    rate = -np.polyfit(np.log(numbers), np.log(errors), 1)[0]
    assert errors[-1] < 0.02
    assert 0.28 < rate < 0.40


@pytest.fixture
def hard(operator, make_dataset):
    """A metric stiffer than the law and few data: the iteration has some way to go."""
    metric = Metric(1.5 * LAW.C, "stiffer than the law")
    rng = np.random.default_rng(0)
    strain = np.zeros((3000, 6))
    strain[:, [0, 1, 5]] = rng.uniform([-0.03, -0.02, -0.03], [0.03, 0.08, 0.03], (3000, 3))
    return clamped_stretch(operator, metric), make_dataset(strain, strain @ LAW.C)


def test_end_of_the_iteration(hard):
    """The result is a fixed point, and its record is consistent; with omega = 1 the distance never grows."""
    scene, dataset = hard
    search = MaterialSearch(dataset, scene.metric)
    result = solve(scene, search)
    z = result.mechanical
    index, distance = MaterialSearch(dataset, scene.metric).nearest(scene.metric.whiten(z.strain, z.stress))
    np.testing.assert_array_equal(index, result.index)
    np.testing.assert_allclose(distance, result.local_distance, rtol=1e-9)
    w, comm = scene.operator.weights, scene.operator.comm
    assert result.distance == pytest.approx(np.sqrt(total(comm, w @ distance**2)), rel=1e-9)
    size = np.sqrt(total(comm, w @ (scene.metric.whiten(z.strain, z.stress) ** 2).sum(axis=1)))
    assert result.normalised_distance == pytest.approx(result.distance / size, rel=1e-9)
    assert scene.residual(z.stress) < 1e-11
    assert result.iterations == len(result.history) > 3
    plain = [h.distance for h in result.history if h.omega == 1]
    assert plain == sorted(plain, reverse=True)
    assert result.history[-1].changed == 0
    assert result.reason == "no datum changed"


def test_over_relaxation_ends_nearer_to_the_data(hard):
    scene, dataset = hard
    plain, relaxed = (
        solve(scene, MaterialSearch(dataset, scene.metric), options=SolverOptions(over_relaxation=w))
        for w in (1.0, 1.7)
    )
    assert {h.omega for h in plain.history} == {1.0}
    assert relaxed.distance < 0.9 * plain.distance


def test_over_relaxation_falls_to_one(hard):
    """It starts as asked, never grows, and is gone after ``annealing`` iterations, however fine the mesh."""
    scene, dataset = hard
    for annealing in (4, 12):
        options = SolverOptions(over_relaxation=1.9, annealing=annealing)
        omega = np.array(
            [h.omega for h in solve(scene, MaterialSearch(dataset, scene.metric), options=options).history]
        )
        assert omega[0] == 1.9
        assert (np.diff(omega) <= 0).all()
        assert (omega[:annealing] > 1).sum() == (omega > 1).sum() <= annealing
        assert len(set(omega)) > 3
        assert omega[-1] == 1


def test_too_few_iterations_are_an_error_with_history(hard):
    scene, dataset = hard
    with pytest.raises(ConvergenceError, match="expected convergence within 3 iterations") as caught:
        solve(scene, MaterialSearch(dataset, scene.metric), options=SolverOptions(max_iterations=3))
    assert len(caught.value.history) == 3
    assert all(isinstance(h, Iteration) and h.changed > 0 for h in caught.value.history)


def test_strain_outside_the_data_is_told(operator, make_dataset):
    metric = Metric(LAW.C, "the law")
    strain = np.random.default_rng(0).uniform(-0.001, 0.001, (50, 6))
    result = solve(clamped_stretch(operator, metric), MaterialSearch(make_dataset(strain, strain @ LAW.C), metric))
    assert result.outside_data > 0.9


def test_bad_options_and_metrics(hard, operator):
    scene, dataset = hard
    with pytest.raises(InputError, match=r"over_relaxation: expected a number in \[1, 2\), got 2.5"):
        SolverOptions(over_relaxation=2.5)
    with pytest.raises(InputError, match="max_iterations: expected at least 1"):
        SolverOptions(max_iterations=0)
    with pytest.raises(InputError, match="same C in the projection and in the search"):
        solve(scene, MaterialSearch(dataset, LAW))
