"""Finite strain from the RVE to the sheet: the law is that of a turned RVE, and two routes lead to one solution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dd_macro as dd
from dd_macro.scene.kinematics import FiniteStrain
from tsg_micro.continuum.rve import build_rve
from tsg_micro.continuum.rve_law import RVELaw
from tsg_micro.data.mandel import from_mandel

F_B = 1e-8
U = np.eye(3) + from_mandel(np.array([-0.015, 0.05, -0.01, 0.004, -0.006, 0.02]))


@pytest.fixture(scope="module")
def rve():
    return build_rve(bar_force=F_B, free=())


def first_piola(rve, F):
    rve.reset()
    return rve.solve_gradient(F - np.eye(3)).first_piola


def test_stress_and_tangent_of_a_turned_rve(rve):
    """P(F) of the RVE under F itself, and its differences, against Biot stress and tangent found at U and turned."""
    F = Rotation.from_rotvec([0.05, -0.1, 0.3]).as_matrix() @ U
    found = FiniteStrain((F - np.eye(3)).reshape(1, 9))
    stress, tangent = RVELaw(rve).stress_and_tangent(found.strain)
    expected = first_piola(rve, F)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found.nominal_stress(stress).reshape(3, 3), expected, atol=1e-8 * scale)
    A, h = found.nominal_tangent(stress, tangent)[0], 1e-5
    for j in (0, 1, 5, 8):
        dF = h * np.eye(9)[j].reshape(3, 3)
        slope = (first_piola(rve, F + dF) - first_piola(rve, F - dF)) / (2 * h)
        np.testing.assert_allclose(A[:, j], slope.reshape(9), atol=1e-5 * np.abs(A).max())


@pytest.mark.parametrize(("load", "element"), [("stretch", "trilinear"), ("shear", "trilinear"), ("shear", "enhanced")])
def test_adapted_data_and_fe2_meet(load, element, tsgdd, tmp_path, read_summary):
    """Two routes to the solution in finite strain: data where the scene needs them, an RVE at every point."""
    scene = ("--elements", 5, 4, 1, "--load", load, "--kinematics", "finite", "--clamp", "inplane", "--bar-force", F_B)
    of = ("--element", element)
    adapted = ("solve", "--adapt", *scene, *of, "--rve-budget", 100, "--adapt-tolerance", 0, "--out", tmp_path / "dd")
    assert tsgdd("fe2", *scene, *of, "--no-plots", "--out", tmp_path / "fe2").code == 0
    assert tsgdd(*adapted, "--no-plots").code == 0
    exact, found = (dd.read_quadrature(tmp_path / name / "quadrature.h5") for name in ("fe2", "dd"))
    for name in ("mechanical_stress", "material_stress", "mechanical_strain"):
        a, b = getattr(found, name), getattr(exact, name)
        assert np.linalg.norm(a - b) < 0.02 * np.linalg.norm(b)
    forces = [read_summary(tmp_path / name)["top_force"] for name in ("fe2", "dd")]
    np.testing.assert_allclose(forces[1], forces[0], rtol=0.005)
    parameters = read_summary(tmp_path / "fe2")["parameters"]
    assert (parameters["kinematics"], parameters["clamp"], parameters["degree"]) == ("finite", "inplane", 1)


def test_any_measure_is_written(chain, tsgdd, tmp_path):
    """The solve is in Biot stress; Cauchy and first Piola stress of its states differ by F."""
    solve = ("solve", "--data", chain.data, "--elements", 4, 4, 1, "--kinematics", "finite", "--no-plots")
    fields = {}
    for measure in ("cauchy", "kirchhoff"):
        assert tsgdd(*solve, "--stress-measure", measure, "--out", tmp_path / measure).code == 0
        fields[measure] = dd.read_quadrature(tmp_path / measure / "quadrature.h5")
        assert fields[measure].stress_measure == measure
    np.testing.assert_array_equal(fields["cauchy"].datum, fields["kirchhoff"].datum)
    ratio = fields["kirchhoff"].mechanical_stress[..., 1] / fields["cauchy"].mechanical_stress[..., 1]
    assert np.ptp(ratio) > 1e-4  # det F
    np.testing.assert_allclose(ratio, 1 + fields["cauchy"].mechanical_strain[..., :3].sum(axis=-1), atol=0.01)


def test_wrong_kinematics(chain, tsgdd, tmp_path):
    done = tsgdd("solve", "--data", chain.data, "--elements", 4, 4, 1, "--kinematics", "big", "--out", tmp_path)
    assert done.code == 2
    assert "kinematics" in done.err
