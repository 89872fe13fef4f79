"""Reading a scene file: TOML, checked key by key; what is wrong is one line with file, key, expected and got."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from tsg_micro.data.errors import InputError
from tsg_micro.data.files import check_regular
from workflows.scenes.model import SceneModel

__all__ = ["read_alone", "read_scene", "scene_of"]

_LARGEST = 1_000_000
_LONGEST = 80
_MODELS = {"str", "int", "float", "constrained-int", "Along", "Profile", "dict", "tuple", "bool"}


def read_scene(path: str | Path) -> SceneModel:
    """The scene in a TOML file; paths in it are relative to its folder.

    Raises:
        InputError: the file cannot be read, is no TOML, or a key or value is not valid.
    """
    try:
        check_regular(path)
        with Path(path).open("rb") as file:
            content = file.read(_LARGEST + 1)
        if len(content) > _LARGEST:
            raise ValueError(f"of at most {_LARGEST} bytes, got more")
        values = tomllib.loads(content.decode())
    except OSError as error:
        raise InputError(f"scene {path}: expected a TOML file, it cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"scene {path}: expected a TOML file, {error}") from None
    return scene_of(values, folder=Path(path).parent, name=str(path))


def read_alone(path: Path, given: Mapping[str, object], *, method: str | None = None) -> SceneModel:
    """The scene in a file, with another ``method`` if one is given; ``given`` are options that must not be: None.

    Raises:
        InputError: some of these are given, or as :func:`read_scene`.
    """
    beside = sorted(name for name, value in given.items() if value is not None)
    if beside:
        raise InputError(f"{', '.join(beside)}: expected in the scene file {path}, got it as an option")
    model = read_scene(path)
    if method is None:
        return model
    return model.model_copy(update={"solve": model.solve.model_copy(update={"method": method})})


def scene_of(values: dict[str, Any], *, folder: Path = Path(), name: str = "scene") -> SceneModel:
    """The scene of plain values, as a file has them.

    Raises:
        InputError: a key or value is not valid.
    """
    try:
        return SceneModel.model_validate(_resolved(values, folder))
    except ValidationError as error:
        raise InputError(f"{name}: {_first(error)}") from None


def _first(error: ValidationError) -> str:
    """The first thing that is wrong, as one line."""
    found = error.errors(include_url=False)
    # of what may be a number or a table, a table is not told that it is no number
    fitting = [e for e in found if e["type"] != "value_error" or not isinstance(e.get("input"), dict)]
    one = (fitting or found)[0]
    where = [str(part) for part in one["loc"] if not _of_union(str(part))]
    key = ".".join(where) or "scene"
    got, kind = one.get("input"), one["type"]
    if kind == "extra_forbidden":
        return f"{key}: expected no such key, got one"
    if kind == "missing":
        return f"{key}: expected a value, got none"
    text = " ".join(one["msg"].removeprefix("Value error, ").split())
    if "expected" in text and "got" in text:
        return f"{key}: {text}"
    return f"{key}: expected {_wanted(text)}, got {_shown(got)}"


def _of_union(part: str) -> bool:
    """Whether pydantic put it into a key to say which kind of a value it tried."""
    return part in _MODELS or "[" in part or part.startswith(("function-", "literal", "tagged"))


def _wanted(text: str) -> str:
    """What pydantic asks for, in our words."""
    for before in ("Input should be ", "Value should be ", "Input should "):
        text = text.removeprefix(before)
    return text


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def _resolved(values: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The values, their paths seen from where the command runs."""

    def there(table: object, *names: str) -> object:
        if not isinstance(table, dict):
            return table
        return {
            name: str(folder / value) if name in names and isinstance(value, str) else value
            for name, value in table.items()
        }

    found = dict(values)
    found["body"] = there(values.get("body"), "mesh")
    if values.get("body") is None:
        del found["body"]
    tissues = values.get("tissue")
    if isinstance(tissues, dict):
        found["tissue"] = {name: there(one, "file", "data") for name, one in tissues.items()}
        for one in found["tissue"].values():
            if isinstance(one, dict) and "bar_force" in one:
                one["bar_force"] = there(one["bar_force"], "file")
    return found
