"""The solution at every quadrature point, in one HDF5 file whose order does not depend on the number of ranks.

Layout (schema 1). Root attributes: ``format`` = "tsgdd-quadrature", ``schema``, ``stress_measure``,
``normalised_distance``. Cells in the order of the mesh's input; the points of a cell follow one another. Arrays
as :class:`QuadratureFields` has them, each with an attribute ``unit``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dd_macro.methods.finite_projection import in_space
from dd_macro.methods.solution import Solution
from dd_macro.results.cell_file import write_by_cell
from dd_macro.scene.spaces import StrainOperator
from tsg_micro.data.errors import InputError
from tsg_micro.data.hdf5 import open_hdf5, read_array, text
from tsg_micro.data.mandel import pressure, von_mises

__all__ = ["VTK_CORNERS", "QuadratureFields", "read_quadrature", "write_quadrature"]

Array = NDArray[np.float64]
FORMAT, SCHEMA = "tsgdd-quadrature", 1

VTK_CORNERS = np.array([0, 1, 3, 2, 4, 5, 7, 6])
"""DOLFINx's tensor-product corners of a hexahedron in the order of VTK."""

UNITS = {
    "corners": "m",
    "midpoint": "m",
    "coordinates": "m",
    "weight": "m^3",
    "mechanical_strain": "1",
    "mechanical_stress": "Pa",
    "mechanical_p": "Pa",
    "mechanical_q": "Pa",
    "material_strain": "1",
    "material_stress": "Pa",
    "material_p": "Pa",
    "material_q": "Pa",
    "local_distance": "J^(1/2)/m^(3/2)",
    "datum": "1",
}
_NEWER = {"corner_displacement": "m"}
_VECTORS = ("mechanical_strain", "mechanical_stress", "material_strain", "material_stress")
_SHAPES: dict[str, tuple[int, ...]] = dict.fromkeys(UNITS, ()) | dict.fromkeys(_VECTORS, (6,))
_SHAPES |= {"corners": (8, 3), "corner_displacement": (8, 3), "midpoint": (3,), "coordinates": (3,)}
_OF_CELLS = ("corners", "corner_displacement", "midpoint")


@dataclass(frozen=True)
class QuadratureFields:
    """What :func:`write_quadrature` wrote, all cells.

    Arrays are (cells, points per cell, ...) unless said otherwise; vectors of 6 are Mandel::

        corners (cells, 8, 3) m, VTK order        midpoint (cells, 3) m      coordinates (..., 3) m     weight m^3
        corner_displacement (cells, 8, 3) m, not in files of older versions
        mechanical_strain (..., 6) 1              mechanical_stress (..., 6) Pa    mechanical_p, mechanical_q Pa
        material_strain (..., 6) 1                material_stress (..., 6) Pa      material_p, material_q Pa
        local_distance sqrt(J/m^3)                datum: index into the data set, 1
    """

    corners: Array
    midpoint: Array
    coordinates: Array
    weight: Array
    mechanical_strain: Array
    mechanical_stress: Array
    mechanical_p: Array
    mechanical_q: Array
    material_strain: Array
    material_stress: Array
    material_p: Array
    material_q: Array
    local_distance: Array
    datum: NDArray[np.int64]
    stress_measure: str
    normalised_distance: float
    corner_displacement: Array | None = None

    @property
    def deformed_corners(self) -> Array:
        """Where the corners (cells, 8, 3) are now, m; at rest where the file does not say."""
        return self.corners if self.corner_displacement is None else self.corners + self.corner_displacement

    def cell_mean(self, values: Array) -> Array:
        """Volume means (cells, ...) of values (cells, points per cell, ...)."""
        w = self.weight / self.weight.sum(axis=1, keepdims=True)
        return np.einsum("cq,cq...->c...", w, values)


def write_quadrature(path: str | Path, operator: StrainOperator, result: Solution, *, stress_measure: str) -> None:
    """Write ``result`` to the HDF5 file ``path``, whole or not at all; the ranks take turns.

    A result in finite strain is written as dd_macro.in_space shows it, with the stress ``stress_measure``.

    Raises:
        InputError: the folder cannot be written, the disk is full, or a rank fails to write its part; on all ranks.
    """
    attributes = {"format": FORMAT, "schema": SCHEMA, "stress_measure": stress_measure}
    attributes |= {"normalised_distance": result.normalised_distance}
    fields = _fields(operator, in_space(result, stress_measure))
    write_by_cell(path, operator.domain, fields, units=UNITS | _NEWER, attributes=attributes)


def read_quadrature(path: str | Path) -> QuadratureFields:
    """Read what :func:`write_quadrature` wrote.

    Raises:
        InputError: no such file, not HDF5, locked, damaged, or of another format or schema.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> problem = dd.Problem(operator, [dd.Displacement("bottom"), dd.Displacement("top", (0.0, 1e-6, 0.0))])
        >>> law = dd.LinearLaw(dd.isotropic(young=1e3, poisson=0.3).C)
        >>> solution = dd.LawMethod().prepare(problem, dd.Material(law=law)).solve()
        >>> dd.write_quadrature("quadrature.h5", operator, solution, stress_measure="cauchy")
        >>> dd.read_quadrature("quadrature.h5").mechanical_stress.shape
        (4, 8, 6)
    """
    with open_hdf5(path, "quadrature file", [*UNITS, *_NEWER]) as file:
        found = tuple(text(file.attrs.get(name)) for name in ("format", "schema"))
        if found != (FORMAT, SCHEMA):
            raise InputError(f"expected {FORMAT}, schema {SCHEMA}, got {found[0]}, {found[1]}")
        missing = [name for name in UNITS if name not in file]
        if missing:
            raise InputError(f"expected the array {missing[0]}, it is missing")
        there = UNITS | {name: unit for name, unit in _NEWER.items() if name in file}
        arrays = {name: read_array(file, name, unit) for name, unit in there.items()}
        cells, points = arrays["weight"].shape[:2]
        for name, array in arrays.items():
            expected = (cells, *_SHAPES[name]) if name in _OF_CELLS else (cells, points, *_SHAPES[name])
            if array.shape != expected:
                raise InputError(f"{name}: expected shape {expected}, got {array.shape}")
            if not np.isfinite(array).all():
                raise InputError(f"{name}: expected finite numbers, got NaN or infinity")
        return QuadratureFields(
            **arrays,
            stress_measure=str(text(file.attrs["stress_measure"])),
            normalised_distance=float(file.attrs["normalised_distance"]),
        )


def _fields(operator: StrainOperator, result: Solution) -> dict[str, NDArray[Any]]:
    """The arrays of the file, this rank's cells in their local order."""
    z = result.mechanical
    at_points = {
        "coordinates": operator.points,
        "weight": operator.weights,
        "mechanical_strain": z.strain,
        "mechanical_stress": z.stress,
        "mechanical_p": pressure(z.stress),
        "mechanical_q": von_mises(z.stress),
        "material_strain": result.material_strain,
        "material_stress": result.material_stress,
        "material_p": pressure(result.material_stress),
        "material_q": von_mises(result.material_stress),
        "local_distance": result.local_distance,
        "datum": result.index,
    }
    corners = operator.cell_corners[:, VTK_CORNERS]
    cells, nq = len(corners), operator.points_per_cell
    shaped = {name: a.reshape(cells, nq, *a.shape[1:]) for name, a in at_points.items()}
    moved = operator.corner_displacement(z.u)[:, VTK_CORNERS]
    return {"corners": corners, "corner_displacement": moved, "midpoint": corners.mean(axis=1), **shaped}
