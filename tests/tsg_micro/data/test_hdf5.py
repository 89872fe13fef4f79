"""HDF5 files from strangers: of other programs, damaged, hostile, locked; and our own, sealed."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from pathlib import Path

import h5py
import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

from tsg_micro.data.dataset import Dataset
from tsg_micro.data.dataset_file import read_dataset, write_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.hdf5 import open_hdf5, read_array, text

CASES = Path(__file__).parents[2] / "data" / "cases" / "hdf5"


def small(n=5):
    strain = np.random.default_rng(1).normal(size=(n, 6)) * 1e-2
    count = np.arange(n)
    return Dataset(strain, 1e3 * strain, "cauchy", path=count, step=count, parameters={"bar_force": 1e-8}, seed=3)


def unsealed(path, change=lambda file: None):
    """A file as another program might have made it: the same content, changed in place, without the seal."""
    write_dataset(path, small())
    with h5py.File(path, "a") as file:
        file.attrs["note"] = "touched"
        change(file)
    return path


def remake(file, name, data, **options):
    unit = file[name].attrs["unit"]
    del file[name]
    file.create_dataset(name, data=data, **options).attrs["unit"] = unit


def assert_equal(a, b):
    assert a.arrays().keys() == b.arrays().keys()
    for name, array in a.arrays().items():
        np.testing.assert_array_equal(array, b.arrays()[name])
    assert (a.stress_measure, a.parameters, a.seed, a.silent) == (b.stress_measure, b.parameters, b.seed, b.silent)


def test_a_sealed_file_and_one_changed_since(tmp_path):
    write_dataset(tmp_path / "d.h5", small())
    assert b"\ntsgdd sha256 " in (tmp_path / "d.h5").read_bytes()[-90:]
    assert_equal(read_dataset(tmp_path / "d.h5"), small())
    assert b"\ntsgdd sha256 " not in unsealed(tmp_path / "e.h5").read_bytes()
    assert_equal(read_dataset(tmp_path / "e.h5"), small())


def test_every_flipped_bit_of_a_sealed_file_is_seen(tmp_path):
    write_dataset(tmp_path / "d.h5", small())
    content = (tmp_path / "d.h5").read_bytes()
    rng = np.random.default_rng(0)
    places = [*rng.integers(0, len(content), 300), *range(len(content) - 79, len(content))]
    for place in places:
        flipped = bytearray(content)
        flipped[place] ^= 1 << int(rng.integers(8))
        (tmp_path / "d.h5").write_bytes(bytes(flipped))
        with pytest.raises(InputError, match=r"damaged|expected an HDF5 file"):
            read_dataset(tmp_path / "d.h5")


def test_strings_of_other_programs(tmp_path):
    def fixed(file):
        for owner in (file, *file.values()):
            for name, value in list(owner.attrs.items()):
                if isinstance(value, str):
                    owner.attrs[name] = np.bytes_(value)
        file.attrs["schema"] = np.array([1.0])  # numbers as arrays of one
        file.attrs["stress_measure"] = np.array([b"cauchy   "], dtype="S9")  # padded, as Fortran has it
        for name in ("path", "step"):
            remake(file, name, file[name][()].astype(float))
        remake(file, "strain", file["strain"][()].astype(">f8"), chunks=(2, 6), compression="gzip", fletcher32=True)

    assert_equal(read_dataset(unsealed(tmp_path / "d.h5", fixed)), small())
    for value in ("cauchy", b"cauchy", np.bytes_("cauchy"), np.array(["cauchy"], dtype=object), b"cauchy\0\0 "):
        assert text(value) == "cauchy"
    assert (text(None), text(3)) == (None, 3)


def test_damaged_bytes_that_hdf5_reads_for_ever():
    begin = time.perf_counter()
    with pytest.raises(InputError, match=r"endless\.h5: damaged \(reading it does not end"):
        read_dataset(CASES / "endless.h5")
    assert time.perf_counter() - begin < 5  # 0.6 s on a machine that is not busy


def external_link(file):
    unit = h5py.ExternalLink("/etc/hostname", "/")
    del file["stress"]
    file["stress"] = unit


def soft_link(file):
    del file["stress"]
    file["stress"] = h5py.SoftLink("/strain")


def external_storage(file):
    del file["stress"]
    file.create_dataset("stress", (5, 6), "f8", external=[("/etc/passwd", 0, 240)]).attrs["unit"] = "Pa"


def virtual(file):
    layout = h5py.VirtualLayout((5, 6), "f8")
    layout[:] = h5py.VirtualSource("/tmp/other.h5", "stress", (5, 6))
    del file["stress"]
    file.create_virtual_dataset("stress", layout).attrs["unit"] = "Pa"


def huge(file):
    del file["stress"]
    file.create_dataset("stress", (300_000_000, 6), "f8").attrs["unit"] = "Pa"


def huge_compressed(file):
    del file["stress"]
    options = {"chunks": (1000, 6), "compression": "gzip", "fillvalue": 1.0}
    file.create_dataset("stress", (300_000_000, 6), "f8", **options).attrs["unit"] = "Pa"


def huge_chunk(file):
    del file["stress"]
    options = {"maxshape": (None, 6), "chunks": (2**25, 6), "compression": "gzip"}
    file.create_dataset("stress", (5, 6), "f8", **options).attrs["unit"] = "Pa"


def never_written(file):
    del file["stress"]
    file.create_dataset("stress", (5, 6), "f8", chunks=(1, 6)).attrs["unit"] = "Pa"
    file["stress"][:3] = 1.0


def words(file):
    remake(file, "stress", np.full((5, 6), b"stress"))


def compound(file):
    remake(file, "stress", np.zeros((5, 6), dtype=[("a", "f8"), ("b", "f8")]))


def ragged(file):
    del file["stress"]
    file.create_dataset("stress", (5, 6), h5py.vlen_dtype(np.dtype("f8"))).attrs["unit"] = "Pa"


def group(file):
    del file["stress"]
    deep = file.create_group("stress")
    for _ in range(300):
        deep = deep.create_group("g")
    deep["loop"] = file["/"]


def scalar(file):
    remake(file, "stress", 1.0)


def half_steps(file):
    remake(file, "step", np.arange(5) + 0.5)


def complex_numbers(file):
    remake(file, "stress", np.ones((5, 6), dtype=complex))


def bad_json(file):
    file.attrs["parameters"] = "{"


def deep_json(file):
    file.attrs["parameters"] = "[" * 60_000 + "]" * 60_000


def json_of_another_kind(file):
    file.attrs["parameters"] = 3.5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (external_link, "stress: expected an array in the file itself, got a link to elsewhere"),
        (soft_link, "stress: expected an array in the file itself, got a link to elsewhere"),
        (external_storage, "stress: expected an array in the file itself, got one that is stored in other files"),
        (virtual, "stress: expected an array in the file itself, got one that is stored in other files"),
        (huge, "stress: 14400000000 bytes are expected, 0 are stored"),
        (huge_compressed, "stress: 14400000000 bytes are expected, 0 are stored"),
        (huge_chunk, "stress: "),
        (never_written, "stress: .* are expected, .* stored|stress: 3 of 5 chunks are stored"),
        (words, "stress: expected an array of numbers"),
        (compound, "stress: expected an array of numbers"),
        (ragged, "stress: expected an array of numbers"),
        (group, "stress: expected an array of numbers"),
        (scalar, "stress: expected an array of numbers"),
        (half_steps, "step: expected whole numbers"),
        (complex_numbers, "stress: expected real numbers, got complex ones"),
        (bad_json, "damaged"),
        (deep_json, "damaged"),
        (json_of_another_kind, "damaged"),
    ],
)
def test_hostile_files_are_refused(tmp_path, change, message):
    begin = time.perf_counter()
    with pytest.raises(InputError, match=message):
        read_dataset(unsealed(tmp_path / "d.h5", change))
    assert time.perf_counter() - begin < 5


def test_a_file_that_another_program_holds_open(tmp_path):
    hold = "import h5py, sys; f = h5py.File(sys.argv[1], 'r+'); print('open', flush=True); sys.stdin.read()"
    for path in (tmp_path / "sealed.h5", unsealed(tmp_path / "other.h5")):
        if path.name == "sealed.h5":
            write_dataset(path, small())
        with subprocess.Popen([sys.executable, "-c", hold, path], stdin=-1, stdout=-1, text=True) as other:
            assert other.stdout is not None
            assert other.stdout.readline() == "open\n"
            with pytest.raises(InputError, match="is locked by another program"):
                read_dataset(path)
            other.communicate("")
        assert len(read_dataset(path)) == 5


def test_names_are_not_followed_beyond_the_block(tmp_path):
    path = unsealed(tmp_path / "d.h5")
    with open_hdf5(path, "thing", ["strain"]) as file:
        assert read_array(file, "strain", "1").shape == (5, 6)
        with pytest.raises(InputError, match="strain: expected the unit 'm', got '1'"):
            read_array(file, "strain", "m")
    with pytest.raises(InputError, match=r"thing .*d\.h5: damaged"), open_hdf5(path, "thing", []) as file:
        file["nothing"]


@hypothesis.settings(max_examples=40)
@hypothesis.given(
    flips=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8),
    head=st.booleans(),
    cut=st.one_of(st.just(1.0), st.floats(0.1, 1)),
)
def test_any_bytes_are_read_or_refused(tmp_path_factory, flips, head, cut):
    folder = tmp_path_factory.getbasetemp()
    if not (folder / "whole.h5").exists():
        unsealed(folder / "whole.h5")
    content = bytearray((folder / "whole.h5").read_bytes())
    content = content[: int(cut * len(content)) + 1]
    for place, value in flips:  # of the whole file, or of its first kB, where the structure is
        content[int(place * min(len(content), 1024 if head else len(content)))] = value
    (folder / "fuzz.h5").write_bytes(bytes(content))
    begin = time.perf_counter()
    with contextlib.suppress(InputError):
        assert np.isfinite(read_dataset(folder / "fuzz.h5").strain).all()
    assert time.perf_counter() - begin < 10
