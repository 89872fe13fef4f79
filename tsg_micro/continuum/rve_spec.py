"""Which RVE data are from, in a form that makes the same one again: tissue, blocks, what holds at its faces.

A data set holds it among its parameters as ``tissue`` (bar force and cell) and ``rve`` (all else). Older ones say the
same in other words, or leave out what was at its default then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, get_args

from tsg_micro.cells.lattice import Images
from tsg_micro.cells.plain_values import check_names
from tsg_micro.cells.tissue import Tissue
from tsg_micro.continuum.rve import RVE
from tsg_micro.data.dataset import Dataset
from tsg_micro.data.errors import InputError

__all__ = ["KINDS", "RVESpec"]

SHEET = ("zz", "yz", "xz")
"""Strain components without stress in a sheet whose faces across z are free."""
KINDS: dict[str, tuple[bool, bool, bool]] = {"sheet": (True, True, False), "bulk": (True, True, True)}
"""The kinds of tissue, and the axes along which their inside is periodic."""
_WORDS = ("periodic", "free", "held", "free-twice", "held-twice")


@dataclass(frozen=True)
class RVESpec:
    """A piece of tissue: 2x2x2-cell ``blocks`` along x, y, z; its axes are ``periodic``, ``held`` or neither, free.

    ``free`` names the strain components that are found by the condition that their stress vanishes.

    Raises:
        InputError: on construction, where blocks or images are not valid; :meth:`build` checks the others.

    Example:
        >>> spec = tsg.RVESpec.of_kind("bulk", tsg.Tissue(bar_force=1e-8))
        >>> spec.build().solve_strain(np.zeros(6)).tangent.round()[0, :3]
        array([1646.,  859.,  859.])
    """

    tissue: Tissue = field(default_factory=Tissue)
    blocks: tuple[int, int, int] = (1, 1, 1)
    periodic: tuple[bool, bool, bool] = (True, True, False)
    images: Images = "merged"
    free: tuple[str, ...] = SHEET
    held: tuple[bool, bool, bool] = (False, False, False)

    def __post_init__(self) -> None:
        if len(self.blocks) != 3 or min(self.blocks) < 1:
            raise InputError(f"blocks: expected at least 1, got {min(self.blocks)}")
        if self.images not in get_args(Images):
            raise InputError(f"images: expected {' or '.join(get_args(Images))}, got {self.images!r}")

    @classmethod
    def of_kind(cls, kind: str, tissue: Tissue, **more: Any) -> RVESpec:
        """One block inside a tissue of this kind, or as ``more`` says, no strain component free if that says none.

        Raises:
            InputError: there is no such kind, or as on construction.
        """
        if kind not in KINDS:
            raise InputError(f"kind: expected {' or '.join(KINDS)}, got {kind!r}")
        return cls(tissue, periodic=KINDS[kind], **{"free": (), **more})

    def build(self) -> RVE:
        """The RVE in its reference state.

        Raises:
            InputError: axes or free components that are not valid.
        """
        nx, ny, nz = (2 * n for n in self.blocks)
        structure = self.tissue.box((nx, ny, nz), periodic=self.periodic, images=self.images)
        return RVE(structure, free=self.free, held=self.held)

    def at(self, place: Sequence[str]) -> RVESpec:
        """The RVE of a place at the sides of a body of this tissue, by what each axis meets there (x, y, z).

        "" is the inside; "free" and "held" a side in one direction, so that two blocks across are both outer ones;
        "free twice" and "held twice" sides in both. Axes that are not periodic stay as they are.
        """
        blocks, periodic, held = list(self.blocks), list(self.periodic), list(self.held)
        for axis, met in enumerate(place):
            if met and self.periodic[axis]:
                periodic[axis], held[axis] = False, met.startswith("held")
                blocks[axis] = 1 if met.endswith("twice") else 2
        changed: dict[str, Any] = {"blocks": tuple(blocks), "periodic": tuple(periodic), "held": tuple(held)}
        return replace(self, **changed)

    def with_axes(self, axes: str) -> RVESpec:
        """The RVE whose axes are as the words say: periodic, or an edge as :meth:`at` makes it, free or held.

        "free" and "held" are edges in one direction, "free-twice" and "held-twice" in both. An axis that is free in
        this RVE is "free" and stays as it is.

        Raises:
            InputError: not three such words, or an axis that is free is to be something else.
        """
        words = axes.split()
        if len(words) != 3 or not set(words) <= set(_WORDS):
            raise InputError(f"axes: expected three words of {', '.join(_WORDS)}, got {axes!r}")
        for name, word, periodic in zip("xyz", words, self.periodic, strict=True):
            if not periodic and word != "free":
                raise InputError(f"axes: expected free along {name}, as the tissue is there, got {word!r}")
        return self.at([word.replace("periodic", "").replace("-", " ") for word in words])

    def with_bar_force(self, bar_force: float) -> RVESpec:
        """The same of a tissue with another bar force f_b (N).

        Raises:
            InputError: it is not valid.
        """
        return replace(self, tissue=replace(self.tissue, bar_force=float(bar_force)))

    @property
    def faces(self) -> tuple[tuple[str, int], ...]:
        """What is across x, y, z, in how many blocks: RVEs of a tissue with the same faces are of one place."""
        each = zip(self.periodic, self.held, self.blocks, strict=True)
        return tuple(("periodic", 0) if periodic else ("held" if held else "free", n) for periodic, held, n in each)

    def is_edge_of(self, inside: RVESpec) -> bool:
        """Whether it is periodic and held where an edge of ``inside`` can be; ``inside`` itself is one."""
        each = zip(self.faces, inside.faces, strict=True)
        return all(there[0] in (here[0], "periodic") for here, there in each)

    def parameters(self) -> dict[str, Any]:
        """What a data set says of it, ready for JSON; :meth:`RVESpec.of` reads it."""
        rve: dict[str, Any] = {
            "blocks": self.blocks,
            "periodic": self.periodic,
            "images": self.images,
            "free": self.free,
        }
        if any(self.held):
            rve["held"] = self.held
        return {"tissue": self.tissue.as_dict(), "rve": {name: _plain(value) for name, value in rve.items()}}

    @classmethod
    def from_parameters(cls, source: Mapping[str, Any]) -> RVESpec | None:
        """The RVE of a run with these parameters; None where they name no bar force, as those of measured data.

        Raises:
            InputError: what is there is not valid.
        """
        if "tissue" in source:
            tissue, rve = Tissue.from_dict(source["tissue"]), source.get("rve", {})
        elif source.get("bar_force") is not None:  # a file from before data sets knew their tissue
            tissue = Tissue.from_dict({name: source[name] for name in ("bar_force", "cell") if name in source})
            rve = {name: source[name] for name in ("blocks", "images") if name in source}
            rve["free"] = source["box"].get("free", SHEET) if "box" in source else ()
        else:
            return None
        check_names("rve", rve, ["blocks", "periodic", "images", "free", "held"])
        shape: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in rve.items()}
        return cls(tissue, **shape)

    @classmethod
    def of(cls, dataset: Dataset) -> tuple[RVESpec, ...]:
        """The different RVEs that the data are from, in the order of their runs; none of measured data.

        Raises:
            InputError: a run's parameters are not valid.
        """
        specs = (cls.from_parameters(source) for source in dataset.sources)
        return tuple(dict.fromkeys(spec for spec in specs if spec is not None))


def _plain(value: str | tuple[Any, ...]) -> str | list[Any]:
    return value if isinstance(value, str) else list(value)
