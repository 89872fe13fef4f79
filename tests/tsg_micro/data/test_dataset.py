"""The data set on disk: round trips, atomic writing, and every way in which a file can be wrong."""

from __future__ import annotations

import dataclasses

import h5py
import numpy as np
import pytest

from tsg_micro.continuum.rve import build_rve
from tsg_micro.continuum.sampling import BOXES, join_paths, sample_paths
from tsg_micro.data.dataset import Dataset, convert_dataset, join_datasets, take
from tsg_micro.data.dataset_file import append_dataset, read_dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path, output_folder
from tsg_micro.data.stress import MEASURES


@pytest.fixture
def data(rng):
    n = 8
    return Dataset(
        strain=rng.normal(size=(n, 6)),
        stress=rng.normal(size=(n, 6)),
        stress_measure="kirchhoff",
        path=np.arange(n) // 2,
        step=np.arange(n) % 2,
        tangent=rng.normal(size=(n, 6, 6)),
        deformation_gradient=np.eye(3) + 0.1 * rng.normal(size=(n, 3, 3)),
        energy=rng.normal(size=n),
        midpoint=rng.normal(size=(n, 3)),
        parameters={"bar_force": 1e-8, "box": "stretch"},
        versions={"numpy": "2"},
        seed=5,
    )


def bare(data):
    return dataclasses.replace(data, tangent=None, deformation_gradient=None, energy=None, midpoint=None, seed=None)


def assert_same(a, b):
    assert a.arrays().keys() == b.arrays().keys()
    for name, array in a.arrays().items():
        np.testing.assert_array_equal(array, b.arrays()[name])
    for name in ("stress_measure", "parameters", "versions", "seed", "silent"):
        assert getattr(a, name) == getattr(b, name)


@pytest.mark.parametrize("optional", [True, False])
def test_round_trip(data, tmp_path, optional):
    data = data if optional else bare(data)
    write_dataset(tmp_path / "data.h5", data)
    assert_same(read_dataset(tmp_path / "data.h5"), data)
    assert [path.name for path in tmp_path.iterdir()] == ["data.h5"]
    assert len(data) == 8


def test_file_says_what_it_holds(data, tmp_path):
    write_dataset(tmp_path / "data.h5", data)
    with h5py.File(tmp_path / "data.h5") as file:
        assert file.attrs["format"] == "tsgdd-dataset"
        assert file.attrs["schema"] == 1
        assert file.attrs["stress_measure"] == "kirchhoff"
        assert {name: file[name].attrs["unit"] for name in file} == {
            "strain": "1", "stress": "Pa", "path": "1", "step": "1",
            "tangent": "Pa", "deformation_gradient": "1", "energy": "J/m^3", "midpoint": "m",
        }  # fmt: skip


def test_append(data, tmp_path):
    path = tmp_path / "data.h5"
    append_dataset(path, data)
    append_dataset(path, take(data, np.arange(3)))
    append_dataset(path, take(data, np.array([7])))
    both = read_dataset(path)
    assert len(both) == 12
    np.testing.assert_array_equal(both.stress[8:11], data.stress[:3])
    np.testing.assert_array_equal(both.path, [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 9])
    assert both.parameters == {"joined": [data.parameters] * 3}
    assert both.seed == 5


def test_join_drops_what_only_one_has(data):
    both = join_datasets(data, dataclasses.replace(bare(data), energy=data.energy, seed=6))
    assert both.tangent is None
    assert both.deformation_gradient is None
    np.testing.assert_array_equal(both.energy, np.tile(data.energy, 2))
    assert both.seed is None


def test_join_needs_one_measure(data, tmp_path):
    write_dataset(tmp_path / "data.h5", data)
    with pytest.raises(InputError, match="expected one stress measure, got kirchhoff and cauchy"):
        append_dataset(tmp_path / "data.h5", dataclasses.replace(data, stress_measure="cauchy"))
    assert_same(read_dataset(tmp_path / "data.h5"), data)


def test_take(data):
    index = np.array([5, 0, 5])
    np.testing.assert_array_equal(take(data, index).tangent, data.tangent[index])
    np.testing.assert_array_equal(take(data, data.path == 2).strain, data.strain[4:6])
    with pytest.raises(InputError, match="expected at least one point"):
        take(data, data.path == 99)


def interrupted(path):
    with atomic_path(path) as temporary:
        temporary.write_text("half a file")
        raise KeyboardInterrupt


def test_failing_write_keeps_the_old_file(data, tmp_path):
    path = tmp_path / "data.h5"
    write_dataset(path, data)
    with pytest.raises(TypeError):  # parameters that JSON cannot hold
        write_dataset(path, dataclasses.replace(data, parameters={"rve": object()}))
    assert_same(read_dataset(path), data)
    with pytest.raises(KeyboardInterrupt):
        interrupted(path)
    assert_same(read_dataset(path), data)
    assert [left.name for left in tmp_path.iterdir()] == ["data.h5"]


def test_folders_that_cannot_be_written(data, tmp_path):
    with pytest.raises(InputError, match="its folder cannot be written"):
        write_dataset(tmp_path / "missing" / "data.h5", data)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"output folder .*: cannot be written"):
        output_folder(tmp_path / "file")
    assert output_folder(tmp_path / "a" / "b").is_dir()


@pytest.fixture
def sheet(data):
    """Nothing in yz and xz but round-off, and F that knows nothing of it either."""
    strain, stress, F = data.strain.copy(), data.stress.copy(), data.deformation_gradient.copy()
    strain[:, 3:5], stress[:, 3:5] = 1e-13, 1e-11
    F[:, [0, 1, 2, 2], [2, 2, 0, 1]] = 1e-15
    return dataclasses.replace(data, strain=strain, stress=stress, deformation_gradient=F, silent=("xz", "yz"))


def test_silent_components_are_kept(sheet, tmp_path):
    """In the file, and by all that makes data from data; their round-off is zero, also after a change of measure."""
    assert sheet.silent == ("yz", "xz")
    np.testing.assert_array_equal(sheet.counted, [1, 1, 1, 0, 0, 1])
    write_dataset(tmp_path / "data.h5", sheet)
    read = read_dataset(tmp_path / "data.h5")
    assert_same(read, sheet)
    near_zero = dataclasses.replace(sheet, strain=1e-9 * sheet.strain, stress=1e-9 * sheet.stress)
    for made in (
        read,
        take(read, np.array([2])),
        take(near_zero, np.array([1])),
        convert_dataset(read, "cauchy"),
        append_dataset(tmp_path / "data.h5", read),
    ):
        assert made.silent == ("yz", "xz")
        assert not made.strain[:, 3:5].any()
        assert not made.stress[:, 3:5].any()
        assert made.stress[:, [0, 1, 2, 5]].all()


def test_joined_data_are_silent_where_both_are(sheet):
    other = dataclasses.replace(sheet, silent=("xz",))
    assert join_datasets(sheet, other).silent == join_datasets(other, sheet).silent == ("xz",)
    assert join_datasets(sheet, dataclasses.replace(sheet, silent=())).silent == ()


def test_data_without_a_declaration_are_not_silent(data, tmp_path):
    write_dataset(tmp_path / "data.h5", data)
    with h5py.File(tmp_path / "data.h5") as file:
        assert "silent" not in file.attrs
    assert read_dataset(tmp_path / "data.h5").silent == ()


@pytest.mark.parametrize(
    ("silent", "text"),
    [
        (("zx",), "silent: expected components among xx, yy, zz, yz, xz, xy, each once and not all of them, got zx"),
        (("yz", "yz"), "each once and not all of them, got yz, yz"),
        (("xx", "yy", "zz", "yz", "xz", "xy"), "each once and not all of them"),
        (("yz", "zz"), "silent: expected zero strain and stress in zz at every point, got up to 2.46 and 0 Pa"),
        (("xy",), "silent: expected zero strain and stress in xy at every point, got up to"),
    ],
)
def test_silent_components_that_are_not(sheet, silent, text):
    stress = sheet.stress.copy()
    stress[:, 2] = 0.0  # free of stress as the zz of a sheet, whose strain says something all the same
    strain = sheet.strain.copy()
    strain[3, 2] = -2.46
    with pytest.raises(InputError, match=text):
        dataclasses.replace(sheet, strain=np.clip(strain, -2.46, 2.46), stress=stress, silent=silent)


def change(name, value):
    def edit(file):
        del file[name]
        file[name] = value
        file[name].attrs["unit"] = "Pa" if name == "stress" else "1"

    return edit


def attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


@pytest.mark.parametrize(
    ("edit", "text"),
    [
        (lambda file: file.attrs.__delitem__("format"), "expected the HDF5 attribute format='tsgdd-dataset', got None"),
        (attribute("format", "other"), "got 'other'"),
        (attribute("schema", 2), "expected schema 1, got 2"),
        (attribute("stress_measure", "nominal"), "stress measure: expected one of cauchy, .*, got 'nominal'"),
        (lambda file: file.attrs.__delitem__("stress_measure"), "stress measure: expected one of"),
        (attribute("silent", '["zx"]'), "silent: expected components among xx, .*, got zx"),
        (attribute("silent", "3"), "damaged"),
        (lambda file: file.__delitem__("stress"), "expected the arrays strain, stress, path, step, stress is missing"),
        (lambda file: file["stress"].attrs.__setitem__("unit", "kPa"), "stress: expected the unit 'Pa', got 'kPa'"),
        (lambda file: file["strain"].attrs.__delitem__("unit"), "strain: expected the unit '1', got None"),
        (change("stress", np.zeros((8, 9))), r"stress: expected shape \(8, 6\), got \(8, 9\)"),
        (change("path", np.zeros(7, dtype=int)), r"path: expected shape \(8,\), got \(7,\)"),
        (change("strain", np.zeros((0, 6))), "expected at least one point, got none"),
        (change("stress", np.where(np.arange(48).reshape(8, 6) == 20, np.nan, 1)), r"at 1 points \(first at index 3\)"),
        (change("strain", np.full((8, 6), np.inf)), "strain: expected finite numbers, got NaN or infinity at 8 points"),
    ],
)  # fmt: skip
def test_wrong_files(data, tmp_path, edit, text):
    path = tmp_path / "data.h5"
    write_dataset(path, data)
    with h5py.File(path, "r+") as file:
        edit(file)
    with pytest.raises(InputError, match=text) as caught:
        read_dataset(path)
    assert str(path) in str(caught.value)


def test_files_that_are_no_data_sets(tmp_path):
    path = tmp_path / "data.h5"
    with pytest.raises(InputError, match="no such file"):
        read_dataset(path)
    for content in (b"", b"eps,sig\n1,2\n"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="expected an HDF5 file, but it cannot be read as one"):
            read_dataset(path)
    h5py.File(path, "w").close()
    with pytest.raises(InputError, match="got None"):
        read_dataset(path)


@pytest.fixture(scope="module")
def sampled():
    rve = build_rve(bar_force=1e-8)
    paths = sample_paths(rve, BOXES["inplane"], paths=range(3), steps=2, seed=0)
    return join_paths(paths, seed=0)


@pytest.mark.parametrize("measure", MEASURES)
def test_convert_and_back(sampled, measure):
    other = convert_dataset(sampled, measure)
    assert other.stress_measure == measure
    back = convert_dataset(other, "first_piola")
    np.testing.assert_allclose(back.stress, sampled.stress, atol=1e-11 * np.abs(sampled.stress).max())
    assert back.tangent is not None
    np.testing.assert_allclose(back.tangent, sampled.tangent, atol=1e-11 * np.abs(sampled.tangent).max())


def test_convert_needs_the_deformation_gradient(data):
    assert convert_dataset(bare(data), "kirchhoff").stress_measure == "kirchhoff"
    with pytest.raises(InputError, match="the data hold kirchhoff and no deformation gradient, so cauchy cannot"):
        convert_dataset(bare(data), "cauchy")
    with pytest.raises(InputError, match="stress measure: expected one of"):
        convert_dataset(data, "nominal")


@pytest.mark.parametrize(
    "damage",
    [
        lambda file: (file.__delitem__("strain"), file.create_group("strain")),
        lambda file: (file.__delitem__("strain"), file.create_dataset("strain", data=1.0)),
        lambda file: (file.__delitem__("strain"), file.create_dataset("strain", data=["a", "b"])),
        lambda file: file.attrs.__setitem__("parameters", "{broken"),
        lambda file: file.attrs.__setitem__("format", np.arange(3)),
        lambda file: file.attrs.__setitem__("seed", "none"),
        lambda file: file.attrs.__setitem__("parameters", "[1]"),
        lambda file: file["deformation_gradient"].__setitem__(0, 0.0),
    ],
    ids=["group", "scalar", "text", "json", "format", "seed", "list", "collapsed"],
)
def test_a_file_that_is_damaged_inside_is_refused(data, tmp_path, damage):
    path = tmp_path / "data.h5"
    write_dataset(path, data)
    with h5py.File(path, "a") as file:
        damage(file)
    with pytest.raises(InputError, match=r"data\.h5"):
        read_dataset(path)


@pytest.fixture
def clamped(data, rng):
    """Data of an edge, with what its clamps carry."""
    n = len(data)
    return dataclasses.replace(data, support=rng.normal(size=(n, 6)), support_tangent=rng.normal(size=(n, 6, 6)))


def test_what_clamps_carry_goes_with_the_data(data, clamped, tmp_path):
    """Written, read, taken, joined with data without clamps, in either order; the run of every point stays known."""
    write_dataset(tmp_path / "d.h5", clamped)
    assert_same(read_dataset(tmp_path / "d.h5"), clamped)
    part = take(clamped, np.array([3, 1]))
    np.testing.assert_array_equal(part.support, clamped.support[[3, 1]])
    np.testing.assert_array_equal(part.support_tangent, clamped.support_tangent[[3, 1]])
    for first, second, at in ((data, clamped, slice(8, None)), (clamped, data, slice(0, 8))):
        both = join_datasets(first, second)
        assert both.support is not None
        assert both.support_tangent is not None
        np.testing.assert_array_equal(both.support[at], clamped.support)
        np.testing.assert_array_equal(both.support_tangent[at], clamped.support_tangent)
        assert np.abs(both.support).sum() == np.abs(clamped.support).sum()
        np.testing.assert_array_equal(both.source, np.repeat([0, 1], 8))
    three = join_datasets(join_datasets(data, clamped), take(clamped, np.arange(2)))
    np.testing.assert_array_equal(three.source, [0] * 8 + [1] * 8 + [2] * 2)
    assert len(three.sources) == 3
    assert three.source is not None
    write_dataset(tmp_path / "three.h5", three)
    assert_same(read_dataset(tmp_path / "three.h5"), three)
    np.testing.assert_array_equal(take(three, three.source == 2).support, clamped.support[:2])


def test_what_clamps_carry_in_another_measure(clamped):
    """It turns as the stress does; its tangent, which would need that of F, is left out."""
    other = convert_dataset(clamped, "first_piola")
    alone = convert_dataset(dataclasses.replace(clamped, stress=clamped.support), "first_piola")
    assert other.support is not None
    np.testing.assert_allclose(other.support, alone.stress, rtol=1e-12)
    assert other.support_tangent is None
    assert convert_dataset(clamped, "kirchhoff").support_tangent is clamped.support_tangent
