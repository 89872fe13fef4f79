"""The solution per cell as a VTKHDF file, which ParaView (5.12 or newer) and PyVista open.

An UnstructuredGrid with one part per rank (VTKHDF 2.2): every part is complete in itself, so that the ranks write
in turn and nothing is gathered. Fields of a cell are volume means; p and q are those of the mean stress.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dd_macro.compat import geometry_nodes
from dd_macro.methods.finite_projection import in_space
from dd_macro.methods.projection import Projection
from dd_macro.methods.solution import Solution
from dd_macro.parallel import atomic_path_of_all, in_turn
from dd_macro.results.quadrature_file import VTK_CORNERS
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import COMPONENTS, pressure, von_mises

__all__ = ["cell_fields", "write_cells", "write_vtkhdf"]

Array = NDArray[np.float64]
_HEXAHEDRON = 12  # VTK's number of this cell


def cell_fields(result: Solution) -> dict[str, Array]:
    """Cell means of this rank: strain and stress as Mandel vectors (cells, 6) and by component, p, q, local distance.

    ``relative_distance`` is |y - z| / |z| of the cell, the paper's normalised distance taken cell by cell; zero where
    the material is a law.
    """
    operator, z = result.problem.operator, result.mechanical
    states = {
        "mechanical": (z.strain, z.stress),
        "material": (result.material_strain, result.material_stress),
    }
    scale = np.array([1.0, 1.0, 1.0, *[1 / np.sqrt(2.0)] * 3])  # tensor components of a Mandel vector
    fields: dict[str, Array] = {}
    for state, (strain, stress) in states.items():
        for quantity, values in (("strain", strain), ("stress", stress)):
            mean = operator.cell_mean(values)
            fields[f"{state}_{quantity}"] = mean
            for i, component in enumerate(COMPONENTS):
                fields[f"{state}_{quantity}_{component}"] = mean[:, i] * scale[i]
        mean_stress = fields[f"{state}_stress"]
        fields[f"{state}_p"], fields[f"{state}_q"] = pressure(mean_stress), von_mises(mean_stress)
    squares = operator.cell_mean(result.local_distance**2)
    fields["local_distance"], fields["relative_distance"] = np.sqrt(squares), np.zeros_like(squares)
    if result.metric is not None:
        size = operator.cell_mean((result.metric.whiten(z.strain, z.stress) ** 2).sum(axis=1))
        fields["relative_distance"] = np.sqrt(np.divide(squares, size, out=np.zeros_like(squares), where=size > 0))
    return fields


def write_vtkhdf(path: str | Path, projection: Projection, result: Solution) -> None:
    """Write ``result`` for ParaView to the file ``path`` (suffix .vtkhdf); the ``projection`` is that of the result.

    Raises:
        InputError: another suffix, the folder cannot be written, or a rank fails to write; on all ranks.
    """
    write_cells(path, result)


def write_cells(path: str | Path, result: Solution) -> None:
    """Write ``result`` to the file ``path`` (suffix .vtkhdf), whole or not at all; the ranks take turns.

    A result in finite strain is written as dd_macro.in_space shows it, with the first Piola stress.

    Raises:
        InputError: another suffix, the folder cannot be written, or a rank fails to write; on all ranks.
    """
    if Path(path).suffix != ".vtkhdf":
        raise InputError(f"output {path}: expected a name that ends in .vtkhdf, by which ParaView knows its reader")
    operator = result.problem.operator
    comm = operator.comm
    fields = cell_fields(in_space(result))
    nodes, connectivity = np.unique(geometry_nodes(operator.domain.mesh)[:, VTK_CORNERS], return_inverse=True)
    points = operator.domain.mesh.geometry.x[nodes]
    u = np.empty_like(points)
    u[connectivity.reshape(-1)] = operator.corner_displacement(result.mechanical.u)[:, VTK_CORNERS].reshape(-1, 3)
    cells = operator.domain.owned_cells
    parts = np.array(comm.allgather((len(points), cells)))  # two numbers per rank
    before, all_of_them = parts[: comm.rank].sum(axis=0), parts.sum(axis=0)

    def put(group: h5py.Group, name: str, values: NDArray[Any], offset: int, count: int) -> None:
        if name not in group:
            group.create_dataset(name, (count, *values.shape[1:]), values.dtype)
        group[name][offset : offset + len(values)] = values

    def write_part() -> None:
        with h5py.File(temporary, "a") as file:
            root = file.require_group("VTKHDF")
            if "Type" not in root.attrs:
                root.attrs["Version"] = np.array([2, 2], dtype=np.int64)
                root.attrs.create("Type", b"UnstructuredGrid", dtype="S16")
                root["NumberOfPoints"] = parts[:, 0]
                root["NumberOfCells"] = parts[:, 1]
                root["NumberOfConnectivityIds"] = 8 * parts[:, 1]
            put(root, "Points", points, before[0], all_of_them[0])
            put(root, "Connectivity", connectivity.reshape(-1).astype(np.int64), 8 * before[1], 8 * all_of_them[1])
            offsets = 8 * np.arange(cells + 1, dtype=np.int64)
            put(root, "Offsets", offsets, before[1] + comm.rank, all_of_them[1] + comm.size)
            put(root, "Types", np.full(cells, _HEXAHEDRON, dtype=np.uint8), before[1], all_of_them[1])
            put(root.require_group("PointData"), "u", u, before[0], all_of_them[0])
            for name, values in fields.items():
                put(root.require_group("CellData"), name, values, before[1], all_of_them[1])

    size = comm.allreduce(sum(values.nbytes for values in (points, u, *fields.values())) + 8 * 10 * cells)
    with atomic_path_of_all(comm, path, size=size + 2**17) as temporary:
        in_turn(comm, write_part)
