"""Bulk tissue is stiff in shear and soft in stretch: what its elements must do (docs/elements.md)."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro as dd
import tsg_micro as tsg

EDGE = 6 * 20e-6


@pytest.fixture(scope="module")
def tissue():
    """The tangent at rest of bulk tissue, as a metric."""
    rve = tsg.build_rve(bar_force=1e-8, periodic=(True, True, True), free=())
    C = rve.solve_strain(np.zeros(6)).tangent
    assert C is not None
    return dd.Metric(0.5 * (C + C.T), "bulk tissue at rest")


@pytest.mark.parametrize(
    ("motion", "component", "trilinear_error", "enhanced_error"),
    [((0.0, -0.01, 0.0), 1, 0.14, 0.025), ((0.01, 0.0, 0.0), 0, 0.80, 0.06)],
    ids=["compression", "shear"],
)
def test_cube_of_bulk_tissue(tissue, motion, component, trilinear_error, enhanced_error):
    """6 x 6 x 6 elements between plates against a finer mesh: the reaction is right, the trilinear one is not."""
    pulls = []
    for kind, n in ((dd.StrainOperator, 6), (dd.EnhancedStrainOperator, 6), (dd.EnhancedStrainOperator, 10)):
        operator = kind(dd.box(MPI.COMM_SELF, elements=(n, n, n), size=(EDGE, EDGE, EDGE)))
        top = dd.Displacement("top", tuple(EDGE * np.array(motion)))
        scene = dd.Projection(operator, tissue, [dd.Displacement("bottom"), top])
        pulls.append(scene.reaction(scene.elastic(), "top")[component])
    trilinear, enhanced = np.array(pulls[:2]) / pulls[2] - 1
    assert trilinear > trilinear_error
    assert 0 < enhanced < enhanced_error
