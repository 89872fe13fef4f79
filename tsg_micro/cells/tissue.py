"""What the cells of a body are made of, as one value that is checked once, written into data sets and read back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from tsg_micro.cells.lattice import Images, box_cells, lattice
from tsg_micro.cells.parameters import CellParameters, check_bar_force
from tsg_micro.cells.prestress import prestressed
from tsg_micro.cells.structure import Structure
from tsg_micro.data.errors import InputError

__all__ = ["Tissue"]


@dataclass(frozen=True)
class Tissue:
    """Cells of one kind: their shape, size and members, and the compression f_b (N) of their bars at rest.

    Raises:
        InputError: on construction, where the bar force is not one positive number that the bars can carry.
    """

    cell: CellParameters = field(default_factory=CellParameters)
    bar_force: float = 1e-8
    """f_b, N."""

    def __post_init__(self) -> None:
        check_bar_force(self.bar_force, cells=1, EA_bar=self.cell.EA_bar)

    @property
    def block(self) -> float:
        """Edge of a block of 2x2x2 cells, m: the period of the tissue."""
        return 2.0 * self.cell.height

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
        return prestressed(
            lattice(box_cells(*cells), self.cell, periodic=periodic, images=images), self.cell, self.bar_force
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as they are written into data sets and files; :meth:`from_dict` reads them."""
        return {"bar_force": float(self.bar_force), "cell": asdict(self.cell)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Tissue:
        """The tissue that :meth:`as_dict` wrote; what is not said is at its default.

        Raises:
            InputError: an unknown name, or a value that is not valid.
        """
        cell = values.get("cell", {})
        known = {"bar_force", "cell"}, {one.name for one in fields(CellParameters)}
        for given, names, where in ((values, known[0], "tissue"), (cell, known[1], "tissue, cell")):
            if not isinstance(given, Mapping) or not set(given) <= names:
                got = ", ".join(sorted(set(given) - names)) if isinstance(given, Mapping) else repr(given)
                raise InputError(f"{where}: expected some of {', '.join(sorted(names))}, got {got}")
        numbers = {**cell, **({"bar_force": values["bar_force"]} if "bar_force" in values else {})}
        for name, value in numbers.items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"tissue, {name}: expected a number, got {value!r}")
        bar_force = {"bar_force": float(values["bar_force"])} if "bar_force" in values else {}
        return cls(CellParameters(**{name: float(value) for name, value in cell.items()}), **bar_force)
