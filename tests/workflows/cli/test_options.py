"""Groups of options: what a command gets from its line, which source wins, and what the commands do with a tissue."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Annotated

import h5py
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from tsg_micro.cells.laws.linear import NoCompression
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.tissue import Tissue
from tsg_micro.cells.tissue_file import read_tissue, write_tissue
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.data.dataset_file import read_dataset
from workflows.cli.studies import find_studies
from workflows.runs.option_groups import CellOptions, Group, TissueOptions, grouped
from workflows.runs.sample import sample
from workflows.studies import commands


@dataclass(frozen=True)
class Size(Group):
    """Two options."""

    width: Annotated[int, typer.Option(help="Along x.")] = 2
    height: Annotated[int, typer.Option(help="Along y.")] = 3


WIDE = Size(width=20)


def call(command, *arguments):
    """The command called as the only one of a program; its result and what it printed."""
    app = typer.Typer()
    app.command()(grouped(command))
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["x"], "x 2 3 []"),
        (["x", "--width", 2], "x 2 3 ['width']"),  # given is given, even if it says the default
        (["--height", 7, "x", "--width", 5], "x 5 7 ['height', 'width']"),
    ],
)
def test_a_group_is_spread_and_gathered(arguments, text):
    def command(*, name: Annotated[str, typer.Argument()], size: Size) -> None:
        print(name, size.width, size.height, sorted(size.given))

    assert call(command, *arguments).output.strip() == text


def test_help_names_every_option_in_its_place():
    def command(*, first: int = 1, size: Size = WIDE, last: int = 9) -> None:
        """What it does."""

    text = call(command, "--help").output
    assert "What it does." in text
    assert [text.index(f"--{name}") for name in ("first", "width", "height", "last")] == sorted(
        text.index(f"--{name}") for name in ("first", "width", "height", "last")
    )
    assert "Along x." in text
    assert "default: 20" in text


NEW_STUDY = """
from workflows.runs.printing import say
from workflows.studies.options import ChainOptions


def command(*, chain: ChainOptions) -> None:
    '''A study of one's own.'''
    say(f"{chain.make().blocks} {chain.strain}")
"""


def test_a_study_is_found_by_its_file(tmp_path, monkeypatch):
    """And nothing in the command line knows of it."""
    (tmp_path / "of_mine.py").write_text(NEW_STUDY)
    (tmp_path / "bench_of_mine.py").write_text(NEW_STUDY)
    monkeypatch.setattr(commands, "__path__", [*commands.__path__, str(tmp_path)])
    for app, there in zip(find_studies(), ("metric", "tsgfem"), strict=True):
        listed = CliRunner().invoke(app, ["--help"]).output
        assert there in listed
        assert "A study of one's own." in listed
        done = CliRunner().invoke(app, ["of-mine", "--blocks", "7", "5"])
        assert done.output.strip() == "(7, 5) 0.05"


def test_defaults_are_those_of_a_tissue():
    """Help shows them, and no option given means no change."""
    options = {one.name: one.default for one in fields(TissueOptions) if one.name not in ("given", "tissue")}
    cell = {name.replace("E_", "e_"): value for name, value in asdict(CellParameters()).items()}
    assert options == {**cell, "bar_force": Tissue().bar_force}
    assert TissueOptions().make() == CellOptions().make() == Tissue()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], Tissue()),
        (["--e-bar", 2e9, "--height", 8e-6], Tissue(CellParameters(E_bar=2e9, height=8e-6))),
        (["--bar-force", 3e-8, "--d-tendon", 9e-7], Tissue(CellParameters(d_tendon=9e-7), 3e-8)),
        (["--tissue", "T"], Tissue(CellParameters(half_diagonal=0.4, E_tendon=8e6), 2e-8, law=NoCompression())),
        (
            ["--bar-force", 1e-8, "--tissue", "T", "--e-tendon", 10e6],  # the defaults, but given: they win
            Tissue(CellParameters(half_diagonal=0.4), law=NoCompression()),
        ),
    ],
)
def test_what_is_given_wins_over_the_file(arguments, expected, tmp_path):
    write_tissue(tmp_path / "T", Tissue(CellParameters(half_diagonal=0.4, E_tendon=8e6), 2e-8, law=NoCompression()))
    got = []

    def command(*, cell: TissueOptions) -> None:
        got.append(cell.make())

    result = call(command, *(tmp_path / "T" if a == "T" else a for a in arguments))
    assert result.exception is None or result.exit_code == 0, result.output
    assert got == [expected]


def test_data_are_of_the_tissue_that_was_asked_for(tsgdd, read_summary, tmp_path):
    tissue = Tissue(CellParameters(half_diagonal=0.45, height=8e-6), 2e-8, law=NoCompression())
    write_tissue(tmp_path / "T.toml", tissue)
    few = ("sample", "--paths", 1, "--steps", 2, "--processes", 2, "--no-plots", "--tissue", tmp_path / "T.toml")
    done = tsgdd(*few, "--e-bar", 1e9, "--out", tmp_path / "d.h5")
    assert done.code == 0, done.err
    expected = Tissue(CellParameters(half_diagonal=0.45, height=8e-6, E_bar=1e9), 2e-8, law=NoCompression())
    dataset = read_dataset(tmp_path / "d.h5")
    assert RVESpec.of(dataset) == (RVESpec(expected),)
    assert read_summary(tmp_path / "d.h5")["parameters"]["cell"]["E_bar"] == 1e9
    again = RVESpec(expected).build().solve_strain(dataset.strain[0])
    assert dataset.energy is not None
    assert again.energy == pytest.approx(dataset.energy[0], rel=1e-10)


def test_stress_is_that_of_members_over_cells(tsgdd, read_summary, tmp_path):
    """Everything twice as large at four times the force is the same material: EA and f_b grow like h^2."""
    small = ("--blocks", 2, 2, "--steps", 1, "--no-plots")
    large = ("--height", 20e-6, "--d-bar", 0.2e-6, "--d-tendon", 2e-6, "--bar-force", 4e-8)
    assert tsgdd("dns", *small, "--out", tmp_path / "small").code == 0
    done = tsgdd("dns", *small, *large, "--out", tmp_path / "large")
    assert done.code == 0, done.err
    stress = [read_summary(tmp_path / name)["nominal_stress"] for name in ("small", "large")]
    assert stress[1] == pytest.approx(stress[0], rel=1e-6)


def test_a_fitted_tissue_is_what_other_commands_read(tsgdd, read_summary, tmp_path):
    curve = tmp_path / "curve.csv"
    curve.write_text("force_nN,displacement_um\n0.5,0.05\n1,0.11\n1.5,0.17\n2,0.22\n2.5,0.28\n3,0.33\n")
    fit = ("calibrate", "--data", curve, "--fit", "bar-force", "--half-diagonal", 0.45, "--no-plots")
    done = tsgdd(*fit, "--save-tissue", tmp_path / "new" / "T.toml", "--out", tmp_path / "fit")
    assert done.code == 0, done.err
    fitted = read_summary(tmp_path / "fit")["fitted"]["bar_force"]["value"]
    tissue = read_tissue(tmp_path / "new" / "T.toml")
    assert tissue == Tissue(CellParameters(half_diagonal=0.45), fitted)
    pressed = tsgdd(
        "cell", "--tissue", tmp_path / "new" / "T.toml", "--steps", 2, "--no-plots", "--out", tmp_path / "c"
    )
    assert pressed.code == 0, pressed.err
    band = read_summary(tmp_path / "c")["band"]
    assert [row["bar_force"] for row in band] == [fitted]
    refused = tsgdd(*fit, "--save-tissue", tmp_path, "--out", tmp_path / "other")
    assert refused.code == 2
    assert "save_tissue: expected a file, got the folder" in refused.err


COMMANDS = [("sample", "--out", "d.h5"), ("dns", "--out", "d"), ("structure", "--out", "d", "--cells", 1, 1, 1)]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_tissue_that_is_wrong_is_named_in_one_line(command, tsgdd, tmp_path):
    file = tmp_path / "T.toml"
    file.write_text("[cell]\nhight = 1e-5\n")
    done = tsgdd(*command, "--tissue", file)
    assert done.code == 2
    assert done.err.strip() == (
        f"tsgdd: {file}: tissue, cell: expected some of half_diagonal, height, E_bar, E_tendon, d_bar, d_tendon, "
        "got hight"
    )


SCENE = ("--elements", 3, 3, 1, "--no-plots")
LARGE = ("--height", 20e-6, "--d-bar", 0.2e-6, "--d-tendon", 2e-6, "--bar-force", 4e-8)
"""Twice as large, at four times the force: the same material, in blocks of twice the edge."""


def test_blocks_of_larger_cells_are_larger_elements(tsgdd, read_summary, tmp_path):
    """FE2 of the same stress on a sheet of twice the size: four times the force, to round-off of the solver."""
    force = []
    for name, options in (("small", ()), ("large", LARGE)):
        done = tsgdd("fe2", *SCENE, *options, "--out", tmp_path / name)
        assert done.code == 0, done.err
        force.append(read_summary(tmp_path / name)["top_force"])
    assert force[1] == pytest.approx(4.0 * force[0], rel=1e-6)


@pytest.fixture(scope="module")
def soft(tmp_path_factory):
    """A file of a softer tissue, of cells of another size; data, and adaptive data, of it."""
    folder = tmp_path_factory.mktemp("soft")
    tissue = Tissue(CellParameters(E_tendon=5e6, height=12e-6), 2e-8)
    write_tissue(folder / "T.toml", tissue)
    sample(folder / "data.h5", load="stretch", paths=10, steps=3, tissue=tissue, processes=1, plots=False)
    return folder


def test_adaptive_data_are_of_the_tissue(soft, tsgdd, read_summary, tmp_path):
    """Of the file, or of the data that are there; and so is the size of the elements."""
    adapt = ("solve", *SCENE, "--adapt", "--rve-budget", 4, "--adapt-tolerance", 0.3)
    for name, options in (("file", ("--tissue", soft / "T.toml")), ("data", ("--data", soft / "data.h5"))):
        done = tsgdd(*adapt, *options, "--out", tmp_path / name)
        assert done.code == 0, done.err
        specs = RVESpec.of(read_dataset(tmp_path / name / "data.h5"))
        assert {spec.tissue for spec in specs} == {read_tissue(soft / "T.toml")}
        assert read_summary(tmp_path / name)["parameters"]["cell"]["height"] == 12e-6
        with h5py.File(tmp_path / name / "quadrature.h5") as file:
            corners = file["corners"][()]
        assert np.ptp(corners[..., 0]) == pytest.approx(3 * 24e-6, rel=1e-12)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--adapt", "--e-bar", 2e9), "bar_force: expected a force in N, or --tissue, beside e_bar, got neither"),
        (("--adapt", "--data", "data.h5", "--bar-force", 1e-8), "bar_force: expected that of the data, 2e-08 N"),
        (("--adapt", "--data", "data.h5", "--bar-force", 2e-8, "--e-bar", 2e9), "tissue: expected that of the data"),
        (("--data", "data.h5", "--tissue", "T.toml"), "expected --adapt with them, got none"),
        (
            ("--data", "data.h5", "--height", 1e-5, "--d-bar", 1e-7),
            "d_bar, height: expected --adapt with them, got none",
        ),
        (
            ("--data", "data.h5", "--bar-force", 2e-8),
            "bar_force, rve_budget, adapt_tolerance: expected --adapt with them",
        ),
    ],
)
def test_a_tissue_that_the_data_are_not_of(options, text, soft, tsgdd, tmp_path):
    here = [soft / word if word in ("data.h5", "T.toml") else word for word in options]
    done = tsgdd("solve", *SCENE, *here, "--out", tmp_path)
    assert done.code == 2
    assert text in done.err
    assert len(done.err.strip().splitlines()) == 1


def test_runs_of_two_tissues_are_not_compared(soft, tsgdd, tmp_path):
    full = ("dns", "--blocks", 3, 3, "--steps", 1, "--no-plots", "--bar-force", 2e-8)
    assert tsgdd(*full, "--out", tmp_path / "dns").code == 0
    assert tsgdd("solve", *SCENE, "--data", soft / "data.h5", "--out", tmp_path / "dd").code == 0
    done = tsgdd("compare", "--dd", tmp_path / "dd", "--dns", tmp_path / "dns", "--no-plots", "--out", tmp_path / "c")
    assert done.code == 2
    assert "tissue, cell: expected the same in both runs" in done.err
    same = tsgdd(*full, "--tissue", soft / "T.toml", "--out", tmp_path / "dns")
    assert same.code == 0, same.err
    done = tsgdd("compare", "--dd", tmp_path / "dd", "--dns", tmp_path / "dns", "--no-plots", "--out", tmp_path / "c")
    assert done.code == 0, done.err
