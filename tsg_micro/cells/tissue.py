"""What the cells of a body are made of, as one value that is checked once, written into data sets and read back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from numpy.typing import ArrayLike

from tsg_micro.cells.lattice import Images, box_cells, lattice
from tsg_micro.cells.laws.linear import LINEAR
from tsg_micro.cells.member_law import MemberLaw, law_as_dict, law_from_dict
from tsg_micro.cells.parameters import TABLE_1, CellParameters, check_bar_force
from tsg_micro.cells.plain_values import check_names, numbers
from tsg_micro.cells.prestress import prestressed
from tsg_micro.cells.structure import Structure
from tsg_micro.cells.truncated_octahedron import unit_cell
from tsg_micro.cells.unit_cell import UnitCell
from tsg_micro.data.errors import InputError

__all__ = ["UNIT_CELLS", "Tissue"]

UNIT_CELLS: dict[str, Callable[[float], UnitCell]] = {"truncated-octahedron": unit_cell}
"""Cells by name, each made from the half-diagonal r of its faces."""


@dataclass(frozen=True)
class Tissue:
    """Cells of one kind: their shape, size and members, what these answer, and the bars' compression f_b (N) at rest.

    Raises:
        InputError: on construction, where the bar force is not one positive number that the bars can carry.

    Example:
        >>> tissue = tsg.Tissue(bar_force=20e-9, cell=tsg.CellParameters(E_tendon=5e6))
        >>> round(1e6 * tissue.block, 3)
        20.0
        >>> tissue.box((2, 2, 2)).nodes.shape
        (144, 3)
    """

    cell: CellParameters = TABLE_1
    bar_force: float = 1e-8
    """f_b, N."""
    law: MemberLaw = LINEAR
    """What bars and tendons answer to their lengths."""
    unit: str = "truncated-octahedron"
    """The cell's name among UNIT_CELLS."""

    def __post_init__(self) -> None:
        check_bar_force(self.bar_force, cells=1, EA_bar=self.cell.EA_bar)
        if not isinstance(self.unit, str) or self.unit not in UNIT_CELLS:
            raise InputError(f"tissue, unit: expected one of {', '.join(sorted(UNIT_CELLS))}, got {self.unit!r}")

    @property
    def unit_cell(self) -> UnitCell:
        """The cell in units of half its height."""
        return UNIT_CELLS[self.unit](self.cell.half_diagonal)

    @property
    def block(self) -> float:
        """Edge of a block of 2x2x2 cells, m: the period of the tissue."""
        return 2.0 * self.cell.height

    def lattice(
        self, cells: ArrayLike, *, periodic: tuple[bool, bool, bool] = (False, False, False), images: Images = "merged"
    ) -> Structure:
        """The structure of ``cells`` (c, 3), lattice indices, without prestress; see :func:`lattice`.

        Raises:
            InputError: as :func:`lattice`.
        """
        return replace(lattice(cells, self.cell, periodic=periodic, images=images, unit=self.unit_cell), law=self.law)

    def box(
        self,
        cells: tuple[int, int, int],
        *,
        periodic: tuple[bool, bool, bool] = (False, False, False),
        images: Images = "merged",
    ) -> Structure:
        """The prestressed lattice of a box of ``cells`` along x, y, z.

        Raises:
            InputError: a count below 1, or an odd one along a periodic axis.
        """
        structure = self.lattice(box_cells(*cells), periodic=periodic, images=images)
        return prestressed(structure, self.cell, self.bar_force)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as they are written into data sets and files; :meth:`from_dict` reads them."""
        cell, law = asdict(self.cell), law_as_dict(self.law)
        return {"bar_force": float(self.bar_force), "unit": self.unit, "cell": cell, "law": law}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Tissue:
        """The tissue that :meth:`as_dict` wrote; what is not said is at its default.

        Raises:
            InputError: an unknown name, or a value that is not valid.
        """
        check_names("tissue", values, [one.name for one in fields(cls)])
        cell = values.get("cell", {})
        check_names("tissue, cell", cell, [one.name for one in fields(CellParameters)])
        given: dict[str, Any] = numbers("tissue", {"bar_force": values["bar_force"]} if "bar_force" in values else {})
        given |= {"unit": values["unit"]} if "unit" in values else {}
        given |= {"law": law_from_dict(values["law"])} if "law" in values else {}
        return cls(CellParameters(**numbers("tissue, cell", cell)), **given)
