"""Mesh files of gmsh, read as data: formats 2.2 and 4.1, text or binary.

gmsh itself takes a file that it does not know for a script and runs the commands in it, so no file is handed to it.
Every count is held against what is left of the file before anything is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError

__all__ = ["Block", "MshFile", "read_msh_file"]

_KINDS = {1: (1, 2), 2: (2, 3), 3: (2, 4), 4: (3, 4), 5: (3, 8), 6: (3, 6), 7: (3, 5), 8: (1, 3), 9: (2, 6), 10: (2, 9)}
_KINDS |= {11: (3, 10), 12: (3, 27), 13: (3, 18), 14: (3, 14), 15: (0, 1), 16: (2, 8), 17: (3, 20), 18: (3, 15)}
_KINDS |= {19: (3, 13), 20: (2, 9), 21: (2, 10), 22: (2, 12), 23: (2, 15), 24: (2, 15), 25: (2, 21), 26: (1, 4)}
_KINDS |= {27: (1, 5), 28: (1, 6), 29: (3, 20), 30: (3, 35), 31: (3, 56), 92: (3, 64), 93: (3, 125)}
"""gmsh's numbers of element types: dimension, and nodes of each."""


@dataclass(frozen=True)
class Block:
    """Elements of one type and the same physical groups."""

    kind: int
    dimension: int
    groups: tuple[int, ...]
    nodes: NDArray[np.int64]
    """Numbers of the nodes (elements, nodes of each), as the file has them."""


@dataclass(frozen=True)
class MshFile:
    """What a mesh file says: numbers of the nodes (n,), their coordinates (n, 3) in the file's unit, and elements."""

    numbers: NDArray[np.int64]
    points: NDArray[np.float64]
    blocks: list[Block]
    names: dict[tuple[int, int], str]
    """Of the physical groups, by dimension and number."""


def read_msh_file(path: str | Path) -> MshFile:
    """Read the file ``path``; nothing in it is run.

    Raises:
        InputError: no such file, its first line is not $MeshFormat, another version of the format, or damaged.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"mesh {path}: no such file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"mesh {path}: cannot be read ({error.strerror})") from None
    first = content[:200].split(b"\n", 1)[0].strip()
    if first != b"$MeshFormat":
        shown = first[:40].decode("ascii", "replace")
        raise InputError(f"mesh {path}: expected a mesh of gmsh, with $MeshFormat in its first line, got {shown!r}")
    try:
        return _parse(content)
    except InputError as error:
        raise InputError(f"mesh {path}: {error}") from None
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise InputError(f"mesh {path}: damaged ({' '.join(str(error).split())[:200]})") from None


class _Reader:
    """Numbers of the section that begins at ``at``, one after another."""

    def __init__(self, content: bytes, at: int) -> None:
        self.content, self.at = content, at

    def line(self) -> str:
        """The rest of this line."""
        end = self.content.find(b"\n", self.at)
        end = len(self.content) if end < 0 else end
        text = self.content[self.at : end].decode("utf-8", "replace").strip()
        self.at = end + 1
        return text

    def take(self, count: int, kind: str) -> NDArray[np.generic]:
        """The next ``count`` numbers: i an int, n a count or number of a node, d a coordinate."""
        raise NotImplementedError

    def ints(self, count: int, kind: str = "i") -> NDArray[np.int64]:
        """Whole numbers."""
        return self.take(count, kind).astype(np.int64)

    def doubles(self, count: int) -> NDArray[np.float64]:
        """Coordinates."""
        return self.take(count, "d").astype(float)

    def skip(self, name: str) -> None:
        """To the line after $EndNAME."""
        at = self.content.find(b"$End" + name.encode(), self.at)
        if at < 0:
            raise InputError(f"expected $End{name} at the end of ${name}, the file ends before")
        self.at = at
        self.line()


class _Text(_Reader):
    def __init__(self, content: bytes, at: int, name: str) -> None:
        super().__init__(content, at)
        end = content.find(b"$End" + name.encode(), at)
        if end < 0:
            raise InputError(f"expected $End{name} at the end of ${name}, the file ends before")
        self.words = np.array(content[at:end].split(), dtype=float)
        self.word = 0

    def take(self, count: int, kind: str) -> NDArray[np.generic]:
        if not 0 <= count <= len(self.words) - self.word:
            raise InputError(f"damaged (a section ends before {count} more numbers)")
        values = self.words[self.word : self.word + count]
        self.word += count
        if kind != "d" and not (np.abs(values) < 2**53).all():
            raise InputError("damaged (expected whole numbers)")
        if kind != "d" and (values != np.floor(values)).any():
            raise InputError(f"damaged (expected whole numbers, got {values[values != np.floor(values)][0]})")
        return values


class _Binary(_Reader):
    def __init__(self, content: bytes, at: int, order: str) -> None:
        super().__init__(content, at)
        self.types = {"i": np.dtype(f"{order}i4"), "n": np.dtype(f"{order}u8"), "d": np.dtype(f"{order}f8")}

    def take(self, count: int, kind: str) -> NDArray[np.generic]:
        kind_of = self.types[kind]
        if not 0 <= count * kind_of.itemsize <= len(self.content) - self.at:
            raise InputError(f"damaged (the file ends before {count} more numbers)")
        values = np.frombuffer(self.content, kind_of, count, self.at)
        self.at += values.nbytes
        if kind == "n" and count and values.max() >= 2**53:
            raise InputError("damaged (a number beyond 2^53)")
        return values


def _parse(content: bytes) -> MshFile:
    reader = _Reader(content, 0)
    reader.line()
    version, binary, size = [*reader.line().split(), "", "", ""][:3]
    if version not in ("2", "2.1", "2.2", "4.1") or binary not in ("0", "1") or size != "8":
        raise InputError(
            f"expected MSH format 2.2 or 4.1, got {version!r} (gmsh FILE -save -format msh41 -o OTHER writes it anew)"
        )
    order = "<"
    if binary == "1":
        order = "<" if content[reader.at : reader.at + 4] == b"\x01\0\0\0" else ">"
    reader.skip("MeshFormat")
    names: dict[tuple[int, int], str] = {}
    entities: dict[tuple[int, int], tuple[int, ...]] = {}
    nodes: tuple[NDArray[np.int64], NDArray[np.float64]] | None = None
    blocks: list[Block] | None = None
    while reader.at < len(content):
        name = reader.line()
        if not name.startswith("$"):
            if name:
                raise InputError(f"damaged (expected a section $NAME, got {name[:40]!r})")
            continue
        name = name[1:]
        if name == "PartitionedEntities":
            raise InputError("expected a mesh in one part, got a partitioned one")
        if name == "PhysicalNames":
            names = _physical_names(_Reader(content, reader.at))
        elif name in ("Entities", "Nodes", "Elements"):
            part = _Binary(content, reader.at, order) if binary == "1" else _Text(content, reader.at, name)
            if name == "Entities":
                entities = _entities(part)
            elif name == "Nodes":
                nodes = _nodes_4(part) if version == "4.1" else _nodes_2(part)
            else:
                blocks = _elements_4(part, entities) if version == "4.1" else _elements_2(part)
            if binary == "1":
                reader.at = part.at
        reader.skip(name)
    if nodes is None or blocks is None:
        raise InputError("damaged (expected the sections $Nodes and $Elements)")
    return MshFile(*nodes, blocks, names)


def _physical_names(reader: _Reader) -> dict[tuple[int, int], str]:
    names = {}
    count = int(reader.line())
    for _ in range(count):
        if reader.at >= len(reader.content):
            raise InputError("damaged (a section ends before all physical names)")
        dimension, tag, name = reader.line().split(maxsplit=2)
        names[int(dimension), int(tag)] = name.strip().strip('"')
    return names


def _entities(reader: _Reader) -> dict[tuple[int, int], tuple[int, ...]]:
    """Physical groups of every entity, by dimension and number (format 4.1)."""
    groups = {}
    for dimension, count in enumerate(reader.ints(4, "n")):
        for _ in range(count):
            (tag,) = reader.ints(1)
            reader.doubles(6 if dimension else 3)
            # a number below zero says that the surface is seen from behind
            groups[dimension, int(tag)] = tuple(abs(int(g)) for g in reader.ints(int(reader.ints(1, "n")[0])))
            if dimension:
                reader.ints(int(reader.ints(1, "n")[0]))
    return groups


def _nodes_4(reader: _Reader) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    numbers, points = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for _ in range(reader.ints(4, "n")[0]):
        dimension, _, parametric = reader.ints(3)
        (count,) = reader.ints(1, "n")
        width = 3 + (int(dimension) if parametric else 0)
        numbers.append(reader.ints(int(count), "n"))
        points.append(reader.doubles(int(count) * width).reshape(-1, width)[:, :3])
    return np.concatenate(numbers), np.concatenate(points)


def _elements_4(reader: _Reader, entities: dict[tuple[int, int], tuple[int, ...]]) -> list[Block]:
    blocks = []
    for _ in range(reader.ints(4, "n")[0]):
        _, entity, kind = (int(n) for n in reader.ints(3))
        dimension, width = _kind(kind)
        (count,) = reader.ints(1, "n")
        rows = reader.ints(int(count) * (1 + width), "n").reshape(-1, 1 + width)
        blocks.append(Block(kind, dimension, entities.get((dimension, entity), ()), rows[:, 1:]))
    return blocks


def _nodes_2(reader: _Reader) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    if isinstance(reader, _Text):
        rows = reader.doubles(4 * int(reader.ints(1)[0])).reshape(-1, 4)
        if not (np.abs(rows[:, 0]) < 2**53).all():
            raise InputError("damaged (expected whole numbers of nodes)")
        return rows[:, 0].astype(np.int64), rows[:, 1:]
    assert isinstance(reader, _Binary)
    count = int(reader.line())
    kind: np.dtype[np.void] = np.dtype([("number", reader.types["i"]), ("x", reader.types["d"], (3,))])
    if not 0 <= count * kind.itemsize <= len(reader.content) - reader.at:
        raise InputError(f"damaged (the file ends before {count} more nodes)")
    table = np.frombuffer(reader.content, kind, count, reader.at)
    reader.at += table.nbytes
    return table["number"].astype(np.int64), table["x"].astype(float)


def _elements_2(reader: _Reader) -> list[Block]:
    """Elements by type and physical group, each in the order of the file; one in two groups stands there twice."""
    found: dict[tuple[int, int], list[NDArray[np.int64]]] = {}
    text = reader if isinstance(reader, _Text) else None
    left = int(reader.line()) if text is None else int(reader.ints(1)[0])
    while left > 0:
        if text is None:
            kind, count, tags = (int(n) for n in reader.ints(3))
            width = _kind(kind)[1]
            row = 1 + tags + width
        else:  # number, type, number of tags, tags, nodes
            kind, tags = (int(n) for n in text.words[text.word + 1 : text.word + 3])
            width = _kind(kind)[1]
            row = 3 + tags + width
            count = _equal_rows(text.words[text.word :], row, left)
        if tags < 0 or not 0 < count <= left:
            raise InputError(f"damaged (a block of {count} elements with {tags} tags)")
        rows = reader.ints(count * row).reshape(count, row)
        left -= count
        groups = rows[:, row - width - tags] if tags else np.zeros(count, dtype=np.int64)
        for group in np.unique(groups):
            found.setdefault((kind, abs(int(group))), []).append(rows[groups == group, row - width :])
    return [
        Block(kind, _kind(kind)[0], (group,) if group else (), np.concatenate(rows))
        for (kind, group), rows in found.items()
    ]


def _equal_rows(words: NDArray[np.float64], row: int, most: int) -> int:
    """How many rows of ``row`` words from the first on have its type and number of tags; 1 to ``most``."""
    count, size = 1, 64
    while row > 0 and count < most:
        rows = words[: min(size, most) * row]
        rows = rows[: len(rows) // row * row].reshape(-1, row)[count:, 1:3]
        same = (rows == words[1:3]).all(axis=1)
        if not len(same) or not same.all():
            return count + (int(np.argmin(same)) if len(same) else 0)
        count, size = count + len(same), 8 * size
    return count


def _kind(kind: int) -> tuple[int, int]:
    if kind not in _KINDS:
        raise InputError(f"expected 8-node hexahedra only, got elements of gmsh type {kind}")
    return _KINDS[kind]
