"""The files of a solution."""

from __future__ import annotations

from pathlib import Path

from dd_macro.methods.finite_projection import in_space
from dd_macro.methods.solution import Solution
from dd_macro.results.quadrature_file import write_quadrature
from dd_macro.results.vtkhdf import write_cells

__all__ = ["write_solution"]


def write_solution(folder: Path, solution: Solution, *, stress_measure: str) -> None:
    """Write quadrature.h5 and fields.vtkhdf into ``folder``, each whole or not at all; the ranks take turns.

    A solution in finite strain is written as dd_macro.in_space shows it, with the stress ``stress_measure``.

    Raises:
        InputError: the folder cannot be written, or a rank fails to write its part; on all ranks.
    """
    shown = in_space(solution, stress_measure)
    write_quadrature(folder / "quadrature.h5", solution.problem.operator, shown, stress_measure=stress_measure)
    write_cells(folder / "fields.vtkhdf", shown)
