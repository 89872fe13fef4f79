"""Loading paths: inside the box and uniform in it, the same for any sharing of the work, and honest about failure."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tsg_micro.continuum.rve import build_rve
from tsg_micro.continuum.sampling import BOXES, StrainBox, join_paths, sample_paths, strain_path
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import COMPONENTS, from_mandel, to_mandel
from tsg_micro.data.silent import zero_components
from tsg_micro.equilibrium.newton import NewtonOptions

SEED = 20


def components(box, strain):
    """The sampled tensor components (..., d) of Mandel strains."""
    tensor = from_mandel(strain)
    return np.stack([tensor[..., "xyz".index(a), "xyz".index(b)] for a, b in box.ranges], axis=-1)


@given(name=st.sampled_from(sorted(BOXES)), path=st.integers(0, 10**5), steps=st.integers(1, 12))
def test_paths_are_rays_inside_their_box(name, path, steps):
    box = BOXES[name]
    strain = strain_path(box, steps=steps, seed=SEED, path=path)
    assert strain.shape == (steps, 6)
    low, high = np.array(list(box.ranges.values())).T
    inside = components(box, strain)
    assert (inside >= low * (1.0 + 1e-12)).all()
    assert (inside <= high * (1.0 + 1e-12)).all()
    size = np.linalg.norm(strain, axis=1)
    assert (np.diff(size) >= 0.0).all()
    np.testing.assert_allclose(strain / size[:, None], strain[-1] / size[-1] * np.ones((steps, 1)), atol=1e-12)
    unsampled = [k for k, component in enumerate(COMPONENTS) if component not in box.ranges]
    assert (strain[:, unsampled] == 0.0).all()


def test_named_boxes_are_those_of_the_paper():
    assert BOXES["stretch"].ranges == {"xx": (-0.04, 0.0), "yy": (0.0, 0.08)}
    assert BOXES["shear"].ranges == {"yy": (-0.1, 0.1), "xy": (0.0, 0.04)}
    assert set(BOXES) == {"stretch", "shear", "inplane", "full"}
    assert set(BOXES["full"].ranges) == set(COMPONENTS)
    assert BOXES["full"].free == ()


@pytest.mark.parametrize(("name", "bins"), [("stretch", 6), ("shear", 6), ("inplane", 4), ("full", 2)])
def test_uniform_density(name, bins):
    """One point a path makes independent draws: chi-square over equal cells of the box."""
    box = BOXES[name]
    points = components(box, np.array([strain_path(box, steps=1, seed=SEED, path=p)[0] for p in range(4000)]))
    counts, _ = np.histogramdd(points, bins=bins, range=list(box.ranges.values()))
    assert stats.chisquare(counts.ravel()).pvalue > 1e-3


def test_uniform_density_with_several_steps():
    """Stratified along the path: every marginal is still uniform, its mean and variance those of the box."""
    box = BOXES["inplane"]
    points = components(box, np.concatenate([strain_path(box, steps=5, seed=SEED, path=p) for p in range(3000)]))
    low, high = np.array(list(box.ranges.values())).T
    unit = (points - low) / (high - low)
    np.testing.assert_allclose(unit.mean(axis=0), 0.5, atol=0.01)
    np.testing.assert_allclose(unit.var(axis=0), 1.0 / 12.0, rtol=0.03)
    np.testing.assert_allclose(np.corrcoef(unit.T), np.eye(3), atol=0.03)


def test_paths_depend_on_seed_and_number_alone():
    box = BOXES["inplane"]
    draw = {key: strain_path(box, steps=4, seed=key[0], path=key[1]) for key in ((0, 0), (0, 1), (1, 0), (1, 1))}
    values = list(draw.values())
    assert all(not np.array_equal(a, b) for i, a in enumerate(values) for b in values[:i])
    np.testing.assert_array_equal(strain_path(box, steps=4, seed=1, path=1), draw[1, 1])


def joined(paths):
    return join_paths(paths, seed=SEED, parameters={"box": "inplane"}, versions={})


@pytest.fixture(scope="module")
def serial():
    return sample_paths(build_rve(bar_force=1e-8), BOXES["inplane"], paths=range(5), steps=3, seed=SEED)


@pytest.mark.parametrize("parts", [[[3, 1], [4, 0, 2]], [[0], [1], [2], [3], [4]], [[4, 3, 2, 1, 0], []]])
def test_data_do_not_depend_on_who_does_which_path(serial, parts):
    shares = [
        data
        for part in parts
        for data in sample_paths(build_rve(bar_force=1e-8), BOXES["inplane"], paths=part, steps=3, seed=SEED)
    ]
    expected, found = joined(serial), joined(shares)
    for name, array in expected.arrays().items():
        np.testing.assert_array_equal(found.arrays()[name], array)


def test_data_hold_the_states(serial):
    data = joined(serial)
    assert len(data) == 15
    assert data.stress_measure == "first_piola"
    np.testing.assert_array_equal(data.path, np.repeat(np.arange(5), 3))
    np.testing.assert_array_equal(data.step, np.tile(np.arange(3), 5))
    prescribed = np.concatenate([strain_path(BOXES["inplane"], steps=3, seed=SEED, path=p) for p in range(5)])
    np.testing.assert_allclose(data.strain[:, [0, 1, 5]], prescribed[:, [0, 1, 5]], atol=1e-14)
    np.testing.assert_allclose(data.strain, to_mandel(data.deformation_gradient - np.eye(3)), atol=1e-15)
    assert np.abs(data.stress[:, 2:5]).max() < 1e-8 * np.abs(data.stress).max()  # free faces
    assert np.linalg.eigvalsh(data.tangent).min() < data.tangent.max()
    assert all(path.negative_pivots == 0 and path.failure is None for path in serial)
    assert (data.seed, data.parameters) == (SEED, {"box": "inplane"})
    assert data.silent == ("yz", "xz")  # free of stress, and not strained: unlike zz


def test_what_is_held_at_zero_is_not_silent():
    """The in-plane shear of this box has neither strain nor stress, but because it is held: that is a fact."""
    data = joined(sample_paths(build_rve(bar_force=1e-8), BOXES["stretch"], paths=[0], steps=2, seed=SEED))
    assert "xy" in zero_components(data.strain, data.stress)
    assert data.silent == ("yz", "xz")


def test_full_box_prescribes_all_six():
    box = BOXES["full"]
    rve = build_rve(bar_force=1e-8, free=box.free)
    done = []
    paths = sample_paths(rve, box, paths=[0, 7], steps=2, seed=SEED, progress=lambda: done.append(1))
    assert len(done) == 2
    prescribed = np.concatenate([strain_path(box, steps=2, seed=SEED, path=p) for p in (0, 7)])
    np.testing.assert_allclose(joined(paths).strain, prescribed, atol=1e-14)
    assert joined(paths).silent == ()
    assert np.abs(prescribed).min() > 0.0


def test_path_without_equilibrium_is_cut_and_says_why():
    box = StrainBox("far", {"yy": (0.0, 0.6)})
    rve = build_rve(bar_force=1e-8, options=NewtonOptions(max_iterations=2))
    (whole,) = sample_paths(build_rve(bar_force=1e-8), box, paths=[0], steps=4, seed=SEED)
    (cut,) = sample_paths(rve, box, paths=[0], steps=4, seed=SEED)
    assert whole.failure is None
    reached = len(cut.F)
    assert 0 < reached < len(whole.F) == 4
    assert cut.failure is not None
    assert "after 2 iterations" in cut.failure
    scale = np.abs(whole.first_piola).max()
    np.testing.assert_allclose(cut.first_piola, whole.first_piola[:reached], atol=1e-7 * scale)
    both = joined([dataclasses.replace(whole, path=1), cut])
    np.testing.assert_array_equal(both.path, [0] * reached + [1] * 4)


def test_nothing_to_join():
    rve = build_rve(bar_force=1e-8, options=NewtonOptions(max_iterations=1, max_elongation=1e-12))
    (lost,) = sample_paths(rve, BOXES["stretch"], paths=[0], steps=1, seed=SEED)
    assert len(lost.F) == 0
    assert lost.first_piola.shape == (0, 3, 3)
    with pytest.raises(InputError, match=r"expected at least one state in equilibrium, got none .*after 1 iterations"):
        joined([lost, dataclasses.replace(lost, path=1)])
    with pytest.raises(InputError, match="paths: expected at least one state"):
        joined([])


@pytest.mark.parametrize(
    ("ranges", "text"),
    [
        ({"zz": (-0.1, 0.1)}, "expected a component that is not free, got 'zz'"),
        ({"yx": (-0.1, 0.1)}, "expected a component that is not free, got 'yx'"),
        ({"xx": (0.01, 0.1)}, r"xx: expected a range around zero, got \[0.01, 0.1\]"),
        ({"xx": (0.1, -0.1)}, "expected a range around zero"),
        ({"xx": (0.0, 0.0)}, "expected a range around zero"),
        ({"xx": (0.0, np.inf)}, "expected a range around zero"),
        ({"xx": (np.nan, 0.1)}, "expected a range around zero"),
    ],
)
def test_bad_boxes(ranges, text):
    with pytest.raises(InputError, match=f"box mine.*{text}"):
        StrainBox("mine", ranges)
