"""The files of a structure that ParaView opens: its members as lines, with what they carry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsg_micro.cells.structure import Structure
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import atomic_path
from tsg_micro.data.series import write_pvd
from tsg_micro.equilibrium.load_path import Equilibrium
from tsg_micro.equilibrium.members import MemberState

__all__ = ["VtuSeries", "write_vtu"]

Array = NDArray[np.float64]


def write_vtu(path: str | Path, structure: Structure, displacement: Array, members: MemberState) -> None:
    """The deformed members as lines, for ParaView: file ``path`` with the suffix .vtu, whole or not at all.

    Cell data: ``kind`` (index into KINDS), ``force`` in N, ``strain`` l/l0 - 1, ``slack`` (0 or 1), ``cell`` and
    ``block`` (the first of a shared member's; -1 for none). Point data: ``displacement`` in m.
    Members that end at a periodic image are left out.

    Raises:
        InputError: another suffix, a displacement that does not fit, or a folder that cannot be written.
    """
    import meshio  # not when runs that draw nothing import this

    if Path(path).suffix != ".vtu":
        raise InputError(f"path: expected a file name that ends in .vtu, got {path}")
    if displacement.shape != structure.nodes.shape or not np.isfinite(displacement).all():
        expected = structure.nodes.shape
        raise InputError(
            f"displacement: expected finite numbers of shape {expected}, got shape {displacement.shape} or NaN"
        )
    inside = ~structure.shift.any(axis=1)
    cell = np.full(len(inside), -1)
    if len(structure.cells):
        cell = structure.member_cells[:, 0]
    block = np.append(structure.cell_block, -1)[cell]  # the last one stands for "no cell"
    data = {
        "kind": structure.kind,
        "force": members.force,
        "strain": members.length / structure.rest_length - 1.0,
        "slack": (members.stiffness == 0.0).astype(np.uint8),
        "cell": cell,
        "block": block,
    }
    mesh = meshio.Mesh(
        structure.nodes + displacement,
        [("line", structure.members[inside])],
        point_data={"displacement": displacement},
        cell_data={name: [values[inside]] for name, values in data.items()},
    )
    with atomic_path(path) as temporary:
        mesh.write(temporary, file_format="vtu")


class VtuSeries:
    """States of a ``structure`` along a path, each a file in the folder ``steps`` beside ``pvd``, the list of them.

    The list is whole after every state, so that ParaView can open a run, and open it anew, while it goes on.
    """

    def __init__(self, pvd: Path, structure: Structure, steps: str = "steps") -> None:
        self.pvd, self.structure, self.steps = pvd, structure, steps
        self.files: list[tuple[float, str | Path]] = []
        (pvd.parent / steps).mkdir(exist_ok=True)

    def add(self, number: int, state: Equilibrium, *, time: float | None = None) -> None:
        """Write the state of this ``number``, which is its time too where none is given."""
        write_vtu(self.pvd.parent / self._name(number), self.structure, state.displacement, state.members)
        self.files.append((float(number) if time is None else time, self._name(number)))
        write_pvd(self.pvd, self.files)

    def keep(self, last: int) -> None:
        """List the states from 1 to ``last`` that an earlier part of the run has written, as far as they are there."""
        known = [(float(n), self._name(n)) for n in range(1, last + 1)]
        self.files += [(time, name) for time, name in known if (self.pvd.parent / name).is_file()]

    def _name(self, number: int) -> str:
        return f"{self.steps}/{number:03d}.vtu"
