"""Tables as instruments and spreadsheets write them: the same numbers, or an error with line and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tsg_micro.data.errors import InputError
from tsg_micro.data.measured import read_csv
from tsg_micro.data.table import Column, Layout, read_numbers

CASES = Path(__file__).parents[2] / "data" / "cases" / "csv"
COLUMNS = {"e": Column("strain", "1"), "s": Column("stress", "1")}
WANTED = [(0.0, 0.0), (0.5, -0.41), (1.25, 8.5e3)]


@pytest.fixture
def table(tmp_path):
    def read(text, **layout):
        (tmp_path / "t.csv").write_text(text, encoding="utf-8", newline="")
        found = read_numbers(tmp_path / "t.csv", COLUMNS, Layout(**layout))
        return list(zip(found["e"].tolist(), found["s"].tolist(), strict=True)), found["line"].tolist()

    return read


@pytest.mark.parametrize(
    ("text", "layout", "lines"),
    [
        ("strain,stress\n0,0\n0.5,-0.41\n1.25,8.5e3\n", {}, [2, 3, 4]),
        ("strain;stress\r\n0;0\r\n0.5;-0.41\r\n1.25;8.5e3\r\n", {}, [2, 3, 4]),
        ("strain\tstress\n0\t0\n\n0.5\t-.41\n1.25\t+8500.\n", {}, [2, 4, 5]),
        ("sep=;\r\nstrain;stress\r\n0;0\r\n0.5;-0.41\r\n1.25;8.5e3", {}, [3, 4, 5]),
        ('"sep=|"\nstrain|stress\n0|0\n0.5|-0.41\n1.25|8.5e3\n', {}, [3, 4, 5]),
        ("\ufeffsep=,\nstrain,stress\n0,0\n0.5,-0.41\n1.25,8.5e3\n", {}, [3, 4, 5]),
        ("strain stress\n0 0\n0.5 -0.41\n1.25   8.5e3\n", {}, [2, 3, 4]),
        ("  strain \t stress \n 0  0 \n 0.5\t-0.41\n1.25 8.5e3\n", {"delimiter": "blank"}, [2, 3, 4]),
        ("strain;stress\n0;0\n0,5;-0,41\n1,25;8,5e3\n", {"decimal": ","}, [2, 3, 4]),
        ("strain\tstress\n0\t0\n0,5\t-0,41\n1,25\t8500\n", {"decimal": ","}, [2, 3, 4]),
        ("strain stress\n0 0\n0,5 -0,41\n1,25 8,5E3\n", {"decimal": ","}, [2, 3, 4]),
        ("sep=;\nstrain;stress\n0;0\n0,5;-0,41\n1,25;8500\n", {"decimal": ","}, [3, 4, 5]),
        ("# machine 7\n# 2026\nstrain,stress\n0,0\n# pause\n0.5,-0.41\n1.25,8.5e3\n", {}, [4, 6, 7]),
        ("# made by numpy\n# strain stress\n0 0\n5e-1 -4.1e-1\n1.25e+00 8.5e+03\n", {}, [3, 4, 5]),
        ("% matlab\n%\nstrain,stress\n0,0\n0.5,-0.41\n1.25,8.5e3\n", {"comment": "%"}, [4, 5, 6]),
        ("Instrument\nA,B,C,D\n\nstrain,stress\n0,0\n0.5,-0.41\n1.25,8.5e3\n", {"skip": 3}, [5, 6, 7]),
        ("Instrument\nsep=;\nstrain;stress\n0;0\n0.5;-0.41\n1.25;8.5e3\n", {"skip": 1}, [4, 5, 6]),
        ('strain,note,stress\n0,"a, b\nc",0\n0.5,x,-0.41\n1.25,,8.5e3\n', {}, [3, 4, 5]),
        ("strain,stress\n(%),(kPa)\n0,0\n0.5,-0.41\n1.25,8.5e3\n", {"comment": "("}, [3, 4, 5]),
    ],
)
def test_the_same_numbers(table, text, layout, lines):
    assert table(text, **layout) == (WANTED, lines)


@pytest.mark.parametrize(
    ("text", "layout", "message"),
    [
        ("strain;stress\n0;0\n0,5;1\n", {}, r"line 3, column 'strain': .* got '0,5'; is its decimal sign a comma\?"),
        ("strain;stress\n1.234,5;0\n", {"decimal": ","}, "line 2, column 'strain': expected a finite number"),
        ("strain;stress\n0.5;0\n", {"decimal": ","}, "line 2, column 'strain': expected a finite number, got '0.5'"),
        ("strain,stress\n0,5,0,1\n", {}, "line 2: expected 2 cells, got 4"),
        ("strain,stress\n0,9.9e37\n", {}, "line 2, column 'stress': .* got 9.9e37: is it an instrument's mark"),
        ("strain,stress\n0,1\n-3.4028235E+38,1\n", {}, "line 3, column 'strain': .* an instrument's mark"),
        ("strain,stress\n0,1e999\n", {}, "line 2, column 'stress': .* an instrument's mark"),
        ("strain,stress\n0,1_000\n", {}, "line 2, column 'stress': expected a finite number, got '1_000'"),
        ("strain,stress\n0,٣\n", {}, "line 2, column 'stress': expected a finite number"),
        ("strain,stress\n0,inf\n", {}, "line 2, column 'stress': expected a finite number, got 'inf'"),
        ("strain,stress\n0,OVER\n", {}, "line 2, column 'stress': expected a finite number, got 'OVER'"),
        ("strain,stress\n0,#NUM!\n", {}, "line 2, column 'stress': expected a finite number, got '#NUM!'"),
        ("strain,stress\n0,0\n0,\n", {}, "line 3, column 'stress': expected a finite number, got ''"),
        ("strain,stress\n", {}, "expected lines of numbers below the headers, got none"),
        ("# strain,stress\n", {}, "expected column headers in line 2|expected lines of numbers"),
        ("sep=;\n", {}, "expected column headers in line 2, got an empty line"),
        ("", {}, "expected column headers in line 1, got an empty line"),
        ("strain,stress\n0,0\n", {"skip": 9}, "expected column headers in line 10, got an empty line"),
        ("x,y\n0,0\n", {}, "expected a column 'strain', got no such column among x, y"),
        ("strain,stress\n0,0\n", {"delimiter": ","}, "delimiter: expected comma, semicolon, tab, blank, got ','"),
        ("strain,stress\n0,0\n", {"decimal": "·"}, "decimal: expected"),
        ("strain,stress\n0,0\n", {"delimiter": "comma", "decimal": ","}, "expected different characters"),
        ("strain,stress\n0,0\n", {"skip": -1}, "skip: expected a number of lines from 0, got -1"),
    ],
)
def test_what_cannot_be_read_is_named(table, text, layout, message):
    with pytest.raises(InputError, match=message):
        table(text, **layout)


PLANE = {"eps_yy": Column("strain", "%"), "sigma_yy": Column("stress", "kPa")}
ZERO = [f"{q}_{ij}" for q in ("eps", "sigma") for ij in ("xx", "zz", "yz", "xz", "xy")]


def test_excel_line_of_the_cases():
    data = read_csv(CASES / "excel_sep_line.csv", columns=PLANE, zero=ZERO, stress_measure="cauchy")
    np.testing.assert_allclose(data.strain[:, 1], [0, 0.005, 0.01, 0.02, 0.03, 0.05])
    np.testing.assert_allclose(data.stress[:, 1], [0, 410, 850, 1620, 2700, 4900])


@pytest.mark.parametrize(
    ("name", "shown"),
    [("overflow_9.9e37.csv", r"9\.9e\+37: is it an instrument's mark"), ("stress_1e160.csv", r"1e\+160: is it")],
)
def test_overflow_marks_of_the_cases(name, shown):
    with pytest.raises(InputError, match=rf"{name}, line 7, column 'stress': .* got {shown}"):
        read_csv(CASES / name, columns=PLANE, zero=ZERO, stress_measure="cauchy")


def test_stresses_that_no_material_bears(tmp_path):
    (tmp_path / "t.csv").write_text("strain,stress\n0,0\n1,2e13\n")
    with pytest.raises(InputError, match=r"line 3, column 'stress': expected a stress below 1e\+13 Pa, got 2e\+13 in"):
        read_csv(tmp_path / "t.csv", columns=PLANE, zero=ZERO, stress_measure="cauchy")


def test_counters_beyond_what_is_counted(tmp_path):
    (tmp_path / "t.csv").write_text("strain,stress,p\n0,0,0\n1,2,1e300\n")
    columns = {**PLANE, "path": Column("p", "1")}
    with pytest.raises(InputError, match="line 3, column 'p': expected a whole number from 0, got '1e300'"):
        read_csv(tmp_path / "t.csv", columns=columns, zero=ZERO, stress_measure="cauchy")
