"""Measured data: every number keeps its meaning from the CSV file to the data set, or the import is refused."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsg_micro.data.dataset_file import read_dataset
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import COMPONENTS, from_mandel, to_mandel
from tsg_micro.data.measured import STRAIN_UNITS, STRESS_UNITS, Column, parse_columns, read_csv
from workflows.runs.import_csv import import_csv

PLANE = {
    "eps_xx": Column("exx", "%"),
    "eps_yy": Column("eyy", "1"),
    "gamma_xy": Column("gxy", "%"),
    "sigma_yy": Column("syy", "kPa"),
    "sigma_xy": Column("sxy", "nN/um^2"),
}
ZERO = ["eps_zz", "eps_yz", "gamma_xz", "sigma_xx", "sigma_zz", "sigma_yz", "sigma_xz"]
HEADERS = "exx,eyy,gxy,syy,sxy"


@pytest.fixture
def plane(tmp_path):
    """Read lines of a test in plane stress."""

    def read(*lines, columns=PLANE, zero=ZERO, measure="first_piola"):
        path = tmp_path / "plane.csv"
        path.write_text("\n".join(lines), encoding="utf-8")
        return read_csv(path, columns=columns, zero=zero, stress_measure=measure)

    return read


def test_units_and_shears_by_hand(plane):
    data = plane(HEADERS, "1,0.02,3,4,5", "", "-1,0,0,0,0.5")
    strain = np.array([[0.01, 0.015, 0.0], [0.015, 0.02, 0.0], [0.0, 0.0, 0.0]])
    stress = np.array([[0.0, 5e3, 0.0], [5e3, 4e3, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(from_mandel(data.strain[0]), strain, rtol=1e-14)
    np.testing.assert_allclose(from_mandel(data.stress[0]), stress, rtol=1e-14)
    np.testing.assert_allclose(data.stress[1], [0, 0, 0, 0, 0, np.sqrt(2) * 500], rtol=1e-14)
    assert data.path.tolist() == [0, 0]
    assert data.step.tolist() == [0, 1]
    assert data.stress_measure == "first_piola"
    assert data.parameters["measured"] == "plane.csv"
    assert data.parameters["columns"]["gamma_xy"] == {"header": "gxy", "unit": "%"}
    assert data.parameters["zero"] == sorted(ZERO)


numbers = st.floats(-0.9, 0.9, allow_subnormal=False)


@given(
    strain=st.lists(numbers, min_size=6, max_size=6),
    stress=st.lists(st.floats(-1e6, 1e6, allow_subnormal=False), min_size=6, max_size=6),
    strain_units=st.lists(st.sampled_from(list(STRAIN_UNITS)), min_size=6, max_size=6),
    stress_units=st.lists(st.sampled_from(list(STRESS_UNITS)), min_size=6, max_size=6),
    engineering=st.booleans(),
    delimiter=st.sampled_from(",;\t"),
)
def test_round_trip_in_any_units(tmp_path_factory, strain, stress, strain_units, stress_units, engineering, delimiter):
    columns, cells = {}, []
    for i, ij in enumerate(COMPONENTS):
        gamma = engineering and i > 2
        columns[("gamma_" if gamma else "eps_") + ij] = Column(f"strain {ij}", strain_units[i])
        cells.append(strain[i] * (2 if gamma else 1) / STRAIN_UNITS[strain_units[i]])
    for i, ij in enumerate(COMPONENTS):
        columns[f"sigma_{ij}"] = Column(f"stress, {ij}", stress_units[i])
        cells.append(stress[i] / STRESS_UNITS[stress_units[i]])
    path = tmp_path_factory.getbasetemp() / "round_trip.csv"
    with path.open("w", encoding="utf-8-sig", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        # headers that hold the other delimiters are not taken apart
        writer.writerow(
            [column.header if delimiter == "," else column.header.replace(",", "") for column in columns.values()]
        )
        writer.writerow(cells)
    if delimiter != ",":
        columns = {name: Column(column.header.replace(",", ""), column.unit) for name, column in columns.items()}
    data = read_csv(path, columns=columns, stress_measure="cauchy")
    for vector, entries in ((data.strain[0], strain), (data.stress[0], stress)):
        xx, yy, zz, yz, xz, xy = entries
        np.testing.assert_allclose(
            vector, to_mandel([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), rtol=1e-13, atol=1e-300
        )


def test_factors_of_the_force_per_area_units():
    nano, micro, pico = 1e-9, 1e-6, 1e-12
    assert STRESS_UNITS["nN/um^2"] == pytest.approx(nano / micro**2)
    assert STRESS_UNITS["pN/um^2"] == pytest.approx(pico / micro**2)
    assert STRESS_UNITS["uN/mm^2"] == pytest.approx(micro / 1e-3**2)
    assert STRESS_UNITS["dyn/cm^2"] == pytest.approx(1e-5 / 1e-2**2)


def test_path_and_step_columns(plane):
    counters = {"path": Column("sample", "1"), "step": Column("frame", "1")}
    data = plane(f"{HEADERS},sample,frame", "0,0,0,0,0,2,7", "1,0,0,0,0,3,9", columns=PLANE | counters)
    assert data.path.tolist() == [2, 3]
    assert data.step.tolist() == [7, 9]
    with pytest.raises(InputError, match=r"line 2, column 'frame': expected a whole number from 0, got '0.5'"):
        plane(f"{HEADERS},sample,frame", "0,0,0,0,0,2,0.5", columns=PLANE | counters)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], r"plane.csv: expected column headers in line 1"),
        (["", "1,2"], r"expected column headers in line 1"),
        ([HEADERS], r"expected lines of numbers below the headers, got none"),
        (
            ["exx,eyy,gxy,syy,tau", "0,0,0,0,0"],
            r"expected a column 'sxy', got no such column among exx, eyy, gxy, syy, tau",
        ),
        (["exx,eyy,gxy,syy,sxy,sxy", "0,0,0,0,0,0"], r"expected a column 'sxy', got 2 of them"),
        (
            [HEADERS, "0,0,0,0,0", "", "0,0,0,zero,0"],
            r"plane.csv, line 4, column 'syy': expected a finite number, got 'zero'",
        ),
        ([HEADERS, "0,0,0,,0"], r"line 2, column 'syy': expected a finite number, got ''"),
        ([HEADERS, "0,nan,0,0,0"], r"line 2, column 'eyy': expected a finite number, got 'nan'"),
        ([HEADERS, "0,0,0,-inf,0"], r"line 2, column 'syy': expected a finite number, got '-inf'"),
        ([HEADERS, "0,0,0,0"], r"line 2: expected 5 cells, got 4"),
        (
            [HEADERS, "0,0,0,0,0", "0,2.5,0,0,0"],
            r"line 3, column 'eyy': .*got 2.5 in the unit '1'; the unit is probably '%'",
        ),
        ([HEADERS, "250,0,0,0,0"], r"column 'exx': expected strains within -1 and 1, got 250 in the unit '%'$"),
    ],
)
def test_bad_files_are_refused(plane, lines, message):
    with pytest.raises(InputError, match=message):
        plane(*lines)


def test_missing_and_binary_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"none.csv: no such file"):
        read_csv(tmp_path / "none.csv", columns=PLANE, zero=ZERO, stress_measure="cauchy")
    (tmp_path / "binary.csv").write_bytes(b"\x89HDF\r\n\xff\xfe")
    with pytest.raises(InputError, match=r"binary.csv: expected a text file in UTF-8"):
        read_csv(tmp_path / "binary.csv", columns=PLANE, zero=ZERO, stress_measure="cauchy")


@pytest.mark.parametrize(
    ("columns", "zero", "message"),
    [
        ({"eps_yx": Column("exx", "1")}, [], r"columns: expected names among .*, got 'eps_yx'"),
        ({}, ["gamma_xx"], r"zero: expected names among .*, got 'gamma_xx'"),
        ({}, ["step"], r"zero: expected names among .*, got 'step'"),
        ({"eps_xx": Column("exx", "kPa")}, [], r"unit of eps_xx: expected one of 1, %.*, got 'kPa'"),
        ({"sigma_yy": Column("syy", "psi")}, [], r"unit of sigma_yy: expected one of Pa, .*, got 'psi'"),
        ({"path": Column("exx", "s")}, [], r"unit of path: expected one of 1, got 's'"),
        ({"eps_xy": Column("exx", "1")}, [], r"component eps_xy: expected one declaration, got gamma_xy and eps_xy"),
        ({}, ["sigma_yy"], r"component sigma_yy: expected one declaration, got sigma_yy and sigma_yy"),
    ],
)
def test_bad_declarations_are_refused(plane, columns, zero, message):
    with pytest.raises(InputError, match=message):
        plane(HEADERS, "0,0,0,0,0", columns=PLANE | columns, zero=ZERO + zero)


def test_nothing_is_zero_unless_declared(plane):
    with pytest.raises(InputError, match=r"components eps_xz, sigma_zz: expected a column, or a declaration as zero"):
        plane(HEADERS, "0,0,0,0,0", zero=[name for name in ZERO if name not in ("gamma_xz", "sigma_zz")])


def test_unknown_measure_is_refused(plane):
    with pytest.raises(InputError, match="stress measure: expected one of"):
        plane(HEADERS, "0,0,0,0,0", measure="nominal")


def test_import_writes_a_valid_data_set(tmp_path, capsys):
    (tmp_path / "pull.csv").write_text("time: s=0,strain,stress\n0,0,0\n1,2.5,0.03\n", encoding="utf-8")
    zero = [
        ",".join(f"eps_{ij}" for ij in COMPONENTS if ij != "yy"),
        *[f"sigma_{ij}" for ij in COMPONENTS if ij != "yy"],
    ]
    out = tmp_path / "data.h5"
    import_csv(
        tmp_path / "pull.csv",
        column=["eps_yy=strain:%", "sigma_yy=stress:kPa"],
        zero=zero,
        silent=["yz,xz", "xy"],
        stress_measure="cauchy",
        out=out,
    )
    data = read_dataset(out)
    assert data.silent == ("yz", "xz", "xy")
    along_y = np.eye(6)[1]
    np.testing.assert_allclose(data.strain, np.outer([0.0, 0.025], along_y), rtol=1e-14)
    np.testing.assert_allclose(data.stress, np.outer([0.0, 30.0], along_y), rtol=1e-14)
    assert data.versions["numpy"] == np.__version__
    assert "2 points from" in capsys.readouterr().out
    for bad, text in (
        ("pull.csv/data.h5", "cannot be written"),
        ("pull.csv", r"ends in \.h5"),
        ("folder.h5", "folder"),
    ):
        (tmp_path / "folder.h5").mkdir(exist_ok=True)
        with pytest.raises(InputError, match=text):
            import_csv(
                tmp_path / "pull.csv",
                column=["eps_yy=strain:%", "sigma_yy=stress:kPa"],
                zero=zero,
                stress_measure="cauchy",
                out=tmp_path / bad,
            )


def test_silent_columns_must_be_zero(tmp_path):
    (tmp_path / "plane.csv").write_text(f"{HEADERS}\n1,0.02,3,4,5\n")
    with pytest.raises(InputError, match=r"silent: expected zero strain and stress in xy .* 0\.0212 and 7\.07e\+03 Pa"):
        read_csv(tmp_path / "plane.csv", columns=PLANE, zero=ZERO, silent=["xy"], stress_measure="cauchy")


def test_silent_components_are_zero_without_a_word(tmp_path):
    (tmp_path / "pull.csv").write_text("strain,stress\n1,3\n")
    columns = {"eps_yy": Column("strain", "%"), "sigma_yy": Column("stress", "Pa")}
    others = [ij for ij in COMPONENTS if ij != "yy"]
    data = read_csv(tmp_path / "pull.csv", columns=columns, silent=others, stress_measure="cauchy")
    np.testing.assert_array_equal(data.stress, [[0, 3, 0, 0, 0, 0]])
    with pytest.raises(InputError, match=r"silent: expected names among xx, .*, got 'xq'"):
        read_csv(tmp_path / "pull.csv", columns=columns, silent=[*others, "xq"], stress_measure="cauchy")


def test_column_texts():
    assert parse_columns(["eps_xx=a: b=c:%"]) == {"eps_xx": Column("a: b=c", "%")}
    for text in ("eps_xx", "eps_xx=strain", "eps_xx=:%", "=strain:%", "eps_xx=strain:"):
        with pytest.raises(InputError, match=r"column: expected NAME=HEADER:UNIT"):
            parse_columns([text])
    with pytest.raises(InputError, match="eps_xx twice"):
        parse_columns(["eps_xx=a:1", "eps_xx=b:1"])
