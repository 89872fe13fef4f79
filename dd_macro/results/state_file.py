"""The mechanical state of a problem as a file, from which a run goes on, on any number of ranks.

Layout: u (cells, nodes of a cell, 3) m, the displacement at the nodes of every cell; inner (cells, 9) m, the amplitudes
of enhanced elements; stress (cells, points, 6) Pa, that of the material; cells in the order of the mesh.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dolfinx
import numpy as np
from numpy.typing import NDArray

from dd_macro.methods.finite_projection import state_on
from dd_macro.methods.projection import MechanicalState
from dd_macro.parallel import together
from dd_macro.results.cell_file import rows_of, write_by_cell
from dd_macro.scene.facets import ghosted
from dd_macro.scene.problem import Problem
from tsg_micro.data.errors import InputError
from tsg_micro.data.hdf5 import open_hdf5, read_array, text

__all__ = ["read_state", "write_state"]

FORMAT = "tsgdd-state"
_UNITS = {"u": "m", "inner": "m", "stress": "Pa"}


def write_state(path: str | Path, problem: Problem, z: MechanicalState, run: str) -> None:
    """Write the state ``z`` of a run with the fingerprint ``run``, whole or not at all; collective.

    Raises:
        InputError: the folder cannot be written, or the disk is full; on all ranks.
    """
    operator, domain = problem.operator, problem.operator.domain
    cells, nodal = domain.owned_cells, 3 * operator.owned_nodes
    fields: dict[str, NDArray[Any]] = {
        "u": ghosted(operator, z.u)[operator.displacements.dofmap.list[:cells]],
        "inner": z.u[nodal:].reshape(cells, -1) if len(z.u) > nodal else np.zeros((cells, 0)),
        "stress": z.stress.reshape(cells, operator.points_per_cell, 6),
    }
    write_by_cell(path, domain, fields, units=_UNITS, attributes={"format": FORMAT, "run": run})


def read_state(path: str | Path, problem: Problem, run: str) -> MechanicalState:
    """The state in a file that :func:`write_state` wrote for the same run; collective.

    Raises:
        InputError: it is another run's, or damaged; on all ranks.
    """
    operator, domain = problem.operator, problem.operator.domain
    found = together(domain.comm, lambda: _read(path, rows_of(domain), run))
    function = dolfinx.fem.Function(operator.displacements)
    function.x.array.reshape(-1, 3)[operator.displacements.dofmap.list[: domain.owned_cells]] = found["u"]
    nodal = np.array(function.x.array[: 3 * operator.owned_nodes])
    u = np.concatenate([nodal, found["inner"].reshape(-1)])
    return state_on(u, operator.local(operator.strain(u)), found["stress"].reshape(-1, 6))


def _read(path: str | Path, rows: NDArray[np.int64], run: str) -> dict[str, NDArray[np.float64]]:
    with open_hdf5(path, "state", list(_UNITS)) as file:
        if text(file.attrs.get("format")) != FORMAT or text(file.attrs.get("run")) != run:
            raise InputError("expected the state of this run, got another's")
        arrays = {name: read_array(file, name, unit) for name, unit in _UNITS.items()}
    if len({len(array) for array in arrays.values()}) > 1 or rows.max(initial=-1) >= len(arrays["u"]):
        raise InputError(f"state {path}: expected the cells of this mesh, got others")
    return {name: array[rows] for name, array in arrays.items()}
