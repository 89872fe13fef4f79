"""What objects say of themselves: a few lines, on one rank alone, whatever a file has put into their names."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

import dd_macro as dd
import tsg_micro as tsg

pytestmark = pytest.mark.mpi

NAME = "<script>x</script>\x1b[2J"


@pytest.fixture
def dataset():
    strain = np.random.default_rng(0).uniform(-0.02, 0.02, (500, 6))
    strain[:, 3] = 0.0
    number = np.arange(500)
    stress = strain @ dd.isotropic(young=1e3, poisson=0.3).C
    return tsg.Dataset(strain, stress, "first_piola", path=number // 10, step=number % 10, parameters={"load": NAME})


def test_a_few_lines_at_a_prompt_and_in_a_notebook(comm, dataset):
    domain = dd.box(comm, elements=(3, 2, 1), size=(6e-5, 4e-5, 2e-5))
    domain.names[NAME] = 99
    problem = dd.Problem(
        dd.StrainOperator(domain), [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))]
    )
    solution = dd.PointMethod().prepare(problem, dd.Material(dataset)).solve()
    shown = [
        (dataset, ("Dataset: 500 points on 50 paths, first Piola stress", "xx -1.99 to 2", "load <script>")),
        (domain, (f"TaggedMesh: 6 hexahedra on {comm.size} rank", "bottom", "<script>")),
        (problem, ("Problem: 6 hexahedra, small strain", "bottom in x y z", "unknowns")),
        (solution, ("DataDrivenResult: converged", f"{solution.normalised_distance:.2%}", "500")),
        (problem.at(0.5), ("under 0.5 of the load", "72")),
    ]
    for thing, words in shown if comm.rank == 0 else ():  # the others have nothing to do with it
        text, html = repr(thing), thing._repr_html_()
        assert 2 <= text.count("\n") + 1 <= 7
        assert len(text) < 1000
        assert all(word in text for word in words), text
        assert "\x1b" not in text + html
        rows = [[cell.text or "" for cell in row] for row in ElementTree.fromstring(html).iter("tr")]  # well formed
        assert "<script>" not in html
        assert [" ".join(row).split() for row in rows] == [line.split() for line in text.splitlines()[1:]]
    assert "yz" not in repr(dataset).split("also")[0]  # zero everywhere
