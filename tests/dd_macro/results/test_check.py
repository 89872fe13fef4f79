"""The estimated error against the true one, of a material that is known, in every method and theory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import dd_macro as dd
from dd_macro.methods.projection import relative_distance
from dd_macro.results.check import check_by_data, check_by_source
from tsg_micro.data.dataset import Dataset, take
from tsg_micro.data.errors import InputError

pytestmark = pytest.mark.mpi

C = dd.isotropic(young=1e3, poisson=0.3).C


@dataclass
class Stiffening:
    """sigma = (1 + k e : e) C e, as a source of data and as a law; ``lost`` strains beyond it have no answer."""

    k: float = 400.0
    lost: float = np.inf
    asked: int = 0

    def stress_and_tangent(self, strain):
        size = 1.0 + self.k * (strain**2).sum(axis=1)
        stress = strain @ C
        tangent = size[:, None, None] * C + 2 * self.k * np.einsum("ni,nj->nij", stress, strain)
        return size[:, None] * stress, 0.5 * (tangent + tangent.swapaxes(1, 2))

    def states(self, strains, origins):
        self.asked += len(strains)
        strain = strains[np.linalg.norm(strains, axis=1) <= self.lost]
        if not len(strain):
            return None
        return data_of(self, strain)


def data_of(material, strain):
    stress, tangent = material.stress_and_tangent(strain)
    n = np.arange(len(strain))
    return Dataset(strain, stress, "first_piola", path=0 * n, step=n, tangent=tangent)


def problem_of(comm, theory="small"):
    operator = dd.THEORIES[theory].operator(dd.box(comm, elements=(3, 4, 2), size=(3e-5, 4e-5, 2e-5)), enhanced=True)
    return dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (1e-6, 2e-6, 0.0))])


def solved(problem, method, data):
    return dd.METHODS[method].prepare(problem, dd.Material(data)).solve()


def true_error(solution, material):
    exact = dd.equilibrium(solution.problem, material).mechanical
    metric = dd.Metric(C, "at rest")
    return relative_distance(solution.problem.operator, metric, solution.mechanical, exact)


@pytest.mark.parametrize("theory", ["small", "finite"])
@pytest.mark.parametrize(("method", "count"), [("classical", 60), ("classical", 2000), ("second order", 20)])
def test_the_estimate_is_near_the_true_error(comm, theory, method, count):
    material = Stiffening()
    data = data_of(material, np.random.default_rng(count).uniform(-0.06, 0.06, (count, 6)))
    solution = solved(problem_of(comm, theory), method, data)
    true, found = true_error(solution, material), check_by_source(solution, [material])
    assert true > 0.02
    assert true / 1.5 < found.error < 1.5 * true
    assert (found.kind, found.checks, found.failed, material.asked) == ("check RVEs", 12, 0, 12)


def test_the_estimate_goes_down_with_the_error(comm):
    """Tangent spaces at the strains that the solution visits: an error far below that of the check points' own."""
    material, problem = Stiffening(), problem_of(comm)
    exact = dd.equilibrium(problem, material).mechanical.strain
    every = np.concatenate(comm.allgather(exact))
    every = every[np.argsort(every @ [1.0, 0.3, 0.1, 0.7, 0.5, 0.9])]
    errors = []
    for step in (47, 23, 5):
        solution = solved(problem, "second order", data_of(material, every[::step]))
        true, found = true_error(solution, material), check_by_source(solution, [material]).error
        assert true / 2 < found < 2 * true
        errors.append(found)
    assert errors[2] < 0.4 * errors[0]


def test_the_answer_of_exact_data_has_no_error(comm):
    material, problem = Stiffening(0.0), problem_of(comm)
    data = data_of(material, np.random.default_rng(0).uniform(-0.06, 0.06, (20, 6)))
    assert check_by_source(solved(problem, "second order", data), [material]).error < 1e-9


def test_strains_without_an_answer(comm):
    """All of the stress there is residual; where there is no answer at all, there is no estimate."""
    material, problem = Stiffening(0.0), problem_of(comm)
    data = data_of(material, np.random.default_rng(0).uniform(-0.06, 0.06, (20, 6)))
    solution = solved(problem, "second order", data)
    sizes = np.concatenate(comm.allgather(np.linalg.norm(solution.mechanical.strain, axis=1)))
    some = check_by_source(solution, [Stiffening(0.0, lost=np.median(sizes))])
    assert 0 < some.failed < some.checks
    assert some.error > 0.3
    none = check_by_source(solution, [Stiffening(lost=0.0)])
    assert (none.error, none.failed) == (None, none.checks)
    assert none.figures()["estimated_error"] == (None, "1")


@pytest.mark.parametrize(("method", "count"), [("classical", 300), ("classical", 3000), ("second order", 100)])
def test_data_answer_each_other(comm, method, count):
    material = Stiffening()
    data = data_of(material, np.random.default_rng(count).uniform(-0.06, 0.06, (count, 6)))
    measured = Dataset(data.strain, data.stress, "first_piola", path=data.path, step=data.step)
    solution = solved(problem_of(comm), method, measured if method == "classical" else data)
    true, found = true_error(solution, material), check_by_data(solution)
    assert true / 2 < found.error < 4 * true
    assert found.kind in ("tangents of the data", "data without their own")


def test_too_few_data_to_answer_each_other(comm):
    material = Stiffening()
    data = data_of(material, np.random.default_rng(0).uniform(-0.06, 0.06, (6, 6)))
    solution = solved(problem_of(comm), "classical", take(data, np.arange(3)))
    assert check_by_data(solution).error is None


def test_a_measure_that_cannot_be_had(comm):
    class Other(Stiffening):
        def states(self, strains, origins):
            found = super().states(strains, origins)
            return Dataset(found.strain, found.stress, "cauchy", found.path, found.step, tangent=found.tangent)

    data = data_of(Stiffening(), np.random.default_rng(0).uniform(-0.06, 0.06, (20, 6)))
    with pytest.raises(InputError, match="stress measure"):
        check_by_source(solved(problem_of(comm), "second order", data), [Other()])
