"""A tissue as a value and as a file: what is written is read to the bit, what is wrong is named in one line."""

from __future__ import annotations

import tomllib
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsg_micro.cells.lattice import box_cells, lattice
from tsg_micro.cells.laws.linear import NoCompression
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import prestressed
from tsg_micro.cells.tissue import Tissue
from tsg_micro.cells.tissue_file import read_tissue, write_tissue
from tsg_micro.data.errors import InputError

POSITIVE = st.floats(1e-3, 1e3)


def test_box_is_the_prestressed_lattice():
    cell = CellParameters(half_diagonal=0.4, height=12e-6)
    tissue = Tissue(cell, 2e-8)
    expected = prestressed(lattice(box_cells(2, 4, 2), cell, periodic=(True, False, False)), cell, 2e-8)
    got = tissue.box((2, 4, 2), periodic=(True, False, False))
    for name in ("nodes", "members", "rest_length", "EA"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    assert tissue.block == 24e-6


@given(r=st.floats(0.01, 0.99), scale=st.tuples(*[POSITIVE] * 5), force=st.floats(1e-12, 1e-9))
def test_what_is_written_is_read_to_the_bit(r, scale, force, tmp_path_factory):
    values = {
        name: value * s for (name, value), s in zip(list(asdict(CellParameters()).items())[1:], scale, strict=True)
    }
    cell = CellParameters(half_diagonal=r, **values)
    tissue = Tissue(cell, force * cell.EA_bar, law=NoCompression())
    assert Tissue.from_dict(tissue.as_dict()) == tissue
    file = tmp_path_factory.mktemp("tissue") / "T.toml"
    write_tissue(file, tissue)
    assert read_tissue(file) == tissue
    assert tomllib.loads(file.read_text()) == tissue.as_dict()


def test_what_a_file_does_not_say_is_at_its_default(tmp_path):
    file = tmp_path / "T.toml"
    file.write_text("")
    assert read_tissue(file) == Tissue()
    file.write_text('[cell]\nheight = 8e-6\nE_bar = 1\n[law]\nname = "no-compression"\n')
    with pytest.raises(InputError, match="less than the bar stiffness"):
        read_tissue(file)  # a default beside what is given is checked too
    file.write_text('bar_force = 1e-15\n[cell]\nheight = 8e-6\nE_bar = 1\n[law]\nname = "no-compression"\n')
    assert read_tissue(file) == Tissue(CellParameters(height=8e-6, E_bar=1.0), 1e-15, law=NoCompression())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("bar_force 1e-8", "tissue .*T.toml: expected a TOML file, Expected '=' after a key"),
        ("bar_force = 1e-8\nbar_force = 2e-8", "expected a TOML file, Cannot overwrite a value"),
        ("\xff", "expected a TOML file, 'utf-8' codec"),
        ("x = " + "[" * 5000, "expected a TOML file"),
        ("#" * 200_000, "expected a TOML file, of at most 100000 bytes"),
        ("barforce = 1e-8", "T.toml: tissue: expected some of cell, bar_force, law, unit, got barforce"),
        ("[cell]\nhight = 1e-5", "tissue, cell: expected some of half_diagonal, height, .*, got hight"),
        ("cell = 1", "tissue, cell: expected some of .*, got 1"),
        ('[cell]\nheight = "10 um"', "tissue, cell, height: expected a number, got '10 um'"),
        ("[cell]\nheight = true", "tissue, cell, height: expected a number, got True"),
        ("[cell]\nheight = -1e-5", "T.toml: height: expected a positive number, got -1e-05"),
        ("[cell]\nheight = nan", "height: expected a positive number, got nan"),
        ("[cell]\nhalf_diagonal = 2", "half_diagonal r: expected a number in"),
        ("[cell]\nE_bar = 1" + "0" * 400, "tissue, cell, E_bar: expected a number below 1e300, got one of 401 digits"),
        ("bar_force = [1e-8, 2e-8]", r"tissue, bar_force: expected a number, got \[1e-08, 2e-08\]"),
        ("bar_force = 0", "T.toml: bar_force: expected positive forces"),
        ("bar_force = 1979-05-27", "tissue, bar_force: expected a number"),
        ('unit = "cube"', "tissue, unit: expected one of truncated-octahedron, got 'cube'"),
        ("unit = 3", "tissue, unit: expected one of truncated-octahedron, got 3"),
        ('law = "linear"', "tissue, law, name: expected one of .*linear.*, got 'linear'"),
        ('[law]\nname = "cubic"', "tissue, law, name: expected one of .*linear.*, got 'cubic'"),
        ('[law]\nname = "linear"\nk = 3', "tissue, law: expected some of name, got k"),
    ],
)
def test_files_that_are_refused(text, message, tmp_path):
    file = tmp_path / "T.toml"
    file.write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=message) as caught:
        read_tissue(file)
    assert "\n" not in str(caught.value)
    assert str(file) in str(caught.value)


def test_files_that_are_not_there(tmp_path):
    for path in (tmp_path, tmp_path / "none.toml"):
        with pytest.raises(InputError, match="expected a TOML file, it cannot be read"):
            read_tissue(path)
    with pytest.raises(InputError, match="cannot be written"):
        write_tissue(tmp_path / "none" / "T.toml", Tissue())
