"""Which RVE data are from: written, read back and built again; and what files say that are older than that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tsg_micro.cells.laws.linear import NoCompression
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve import build_rve
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES, join_paths, sample_paths
from tsg_micro.data.dataset import join_datasets
from tsg_micro.data.dataset_file import append_dataset, read_dataset, write_dataset
from tsg_micro.data.errors import InputError

CELL = CellParameters(half_diagonal=0.4, E_tendon=8e6, height=12e-6)
SPECS = {
    "default": RVESpec(),
    "bulk": RVESpec(Tissue(CELL, 3e-8), periodic=(True, True, True), free=()),
    "large": RVESpec(Tissue(bar_force=2e-9, law=NoCompression()), blocks=(2, 1, 1), images="duplicated", free=("zz",)),
}


def sampled(spec, parameters, load="inplane"):
    """Two states of the RVE, in a data set with these parameters."""
    rve = spec.build()
    done = sample_paths(rve, replace(BOXES[load], free=spec.free), paths=[0], steps=2, seed=0)
    return join_paths(done, seed=0, parameters=parameters, versions={})


@pytest.mark.parametrize("name", SPECS)
def test_a_data_set_makes_the_same_rve_again(name, tmp_path):
    spec, file = SPECS[name], tmp_path / "d.h5"
    dataset = sampled(spec, {"load": "inplane", **spec.parameters()})
    write_dataset(file, dataset)
    (again,) = RVESpec.of(read_dataset(file))
    assert again == spec
    state = again.build().solve_strain(dataset.strain[0])
    np.testing.assert_allclose(state.energy, dataset.energy[0], rtol=1e-12)


def test_build_rve_is_the_same_rve():
    spec = RVESpec(Tissue(CELL, 3e-8), blocks=(1, 2, 1), images="duplicated")
    one = spec.build().structure
    other = build_rve(CELL, bar_force=3e-8, blocks=(1, 2, 1), images="duplicated").structure
    for name in ("nodes", "members", "rest_length", "EA", "shift"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


CELL_OF_PAPER = {
    "half_diagonal": 0.5,
    "height": 1e-5,
    "E_bar": 1.2e9,
    "E_tendon": 1e7,
    "d_bar": 1e-7,
    "d_tendon": 1e-6,
}
OLD_SAMPLE = {"load": "stretch", "paths": 2, "steps": 2, "bar_force": 2e-8, "seed": 0, "blocks": [2, 1, 1]}
OLD_SAMPLE |= {"images": "duplicated", "cell": CELL_OF_PAPER}
TWICE = RVESpec(Tissue(bar_force=2e-8), blocks=(2, 1, 1), images="duplicated")
WEAK = RVESpec(Tissue(bar_force=5e-9), free=())
OLD_SAMPLE |= {"box": {"name": "stretch", "ranges": {"xx": [-0.04, 0.0]}, "free": ["zz", "yz", "xz"]}}


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        (OLD_SAMPLE, TWICE),
        (
            OLD_SAMPLE | {"box": {"name": "full", "free": []}},
            replace(TWICE, free=()),
        ),
        # an adaptive run, which prescribed all six strains
        (
            {"bar_force": 1e-8, "blocks": [1, 1, 1], "images": "merged", "cell": CELL_OF_PAPER, "adapted": {}},
            RVESpec(free=()),
        ),
        # random states of study data-error, which did not name the blocks or the cell
        (
            {"bar_force": 5e-9, "box": {"low": [], "high": [], "free": []}, "images": "merged"},
            WEAK,
        ),
        ({"file": "measured.csv"}, None),
        ({"bar_force": None}, None),
        ({}, None),
    ],
    ids=["sample", "full box", "adaptive", "random", "measured", "joined", "nothing"],
)
def test_older_files_are_read_as_what_they_were(written, expected, tmp_path):
    file = tmp_path / "old.h5"
    write_dataset(file, sampled(RVESpec(), written))
    assert RVESpec.of(read_dataset(file)) == (() if expected is None else (expected,))


def test_joined_data_name_every_rve_once(tmp_path):
    file = tmp_path / "d.h5"
    new, old = sampled(RVESpec(), RVESpec().parameters()), sampled(RVESpec(), {**OLD_SAMPLE, "blocks": [1, 1, 1]})
    write_dataset(file, join_datasets(new, new))
    append_dataset(file, old)
    specs = RVESpec.of(read_dataset(file))
    assert specs == (RVESpec(), RVESpec(Tissue(bar_force=2e-8), images="duplicated"))


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"tissue": {"bar_force": -1.0}}, "bar_force: expected positive forces"),
        ({"tissue": {"bar_forces": 1e-8}}, "tissue: expected some of cell, bar_force, law, unit, got bar_forces"),
        ({"tissue": {"bar_force": "1e-8"}}, "tissue, bar_force: expected a number, got '1e-8'"),
        ({"tissue": {"cell": {"hight": 1e-5}}}, "tissue, cell: expected some of half_diagonal, .*, got hight"),
        ({"tissue": {"cell": 3}}, "tissue, cell: expected some of .*, got 3"),
        ({"tissue": {}, "rve": {"blocks": [0, 1, 1]}}, "blocks: expected at least 1, got 0"),
        ({"tissue": {}, "rve": {"images": "tied"}}, "images: expected merged or duplicated, got 'tied'"),
        ({"tissue": {}, "rve": {"size": 3}}, "rve: expected some of blocks, periodic, images, free, held, got size"),
    ],
)
def test_bad_parameters(parameters, text):
    with pytest.raises(InputError, match=text):
        RVESpec.from_parameters(parameters)
