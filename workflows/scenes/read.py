"""Reading a scene file: TOML, checked key by key; what is wrong is one line with file, key, expected and got."""

from __future__ import annotations

import contextlib
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from tsg_micro.data.errors import InputError, OutputError
from tsg_micro.data.files import check_regular
from workflows.scenes.model import SceneModel

__all__ = ["naming", "read_alone", "read_scene", "scene_of"]

_LARGEST = 1_000_000
_LONGEST = 80
_TYPES = {
    "bool_type": "true or false",
    "dict_type": "a table",
    "int_type": "a whole number",
    "model_type": "a table",
    "string_type": "a text",
    "tuple_type": "a list",
}
"""What pydantic says of a value of another type than it wants."""
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
    except OSError as error:
        raise InputError(f"{path}: expected a TOML file, got none that can be read ({error.strerror})") from None
    if len(content) > _LARGEST:
        raise InputError(f"{path}: expected a TOML file of at most {_LARGEST} bytes, got more")
    try:
        values = tomllib.loads(content.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected a TOML file, got another: {error}") from None
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


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """What is wrong with a scene while it is built or solved names its file too.

    Raises:
        InputError: one was raised within; one of output stays as it is.
    """
    try:
        yield
    except OutputError:
        raise
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


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
    """The first thing that is wrong, as one line; of what may be several things, the one that fits best."""
    found = error.errors(include_url=False)
    first = _key(found[0])
    same = [e for e in found if _key(e)[: len(first)] == first or first[: len(_key(e))] == _key(e)]
    best = max(same, key=_fit)
    key, got = ".".join(_key(best)) or "scene", best.get("input")
    if best["type"] == "extra_forbidden":
        return f"{key}: expected no such key, got one"
    if best["type"] == "missing":
        return f"{key}: expected a value, got none"
    text = " ".join(best["msg"].removeprefix("Value error, ").split())
    if "expected" in text and "got" in text:
        return f"{key}: {text}"
    others = [e for e in same if _key(e) == _key(best) and _fit(e)[0] == _fit(best)[0] and e["type"] != "value_error"]
    return f"{key}: expected {' or '.join(dict.fromkeys(_wanted(e) for e in others))}, got {_shown(got)}"


def _key(error: Mapping[str, Any]) -> list[str]:
    """The keys in the file that lead to what is wrong."""
    return [str(part) for part in error["loc"] if not _of_union(str(part))]


def _of_union(part: str) -> bool:
    """Whether pydantic put it into a key to say which kind of a value it tried."""
    return part in _MODELS or "[" in part or part.startswith(("function-", "literal", "tagged"))


def _fit(error: Mapping[str, Any]) -> tuple[int, bool]:
    """How far the value was understood before something was wrong: the depth, and whether its type was right."""
    plain = str(error["loc"][-1]).startswith("function-before") and isinstance(error.get("input"), dict | list)
    return len(error["loc"]), not (plain or error["type"] in _TYPES)


def _wanted(error: Mapping[str, Any]) -> str:
    """What pydantic asks for, in our words."""
    if error["type"] in _TYPES:
        return _TYPES[error["type"]]
    if error["type"] == "too_short":
        return f"at least {error['ctx']['min_length']} of them"
    text = " ".join(error["msg"].split())
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
