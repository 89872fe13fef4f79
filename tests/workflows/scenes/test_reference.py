"""docs/scenes.md: every key of the models is in a table of it, with its default; its code runs."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

import workflows.scenes.model as model

ROOT = Path(__file__).parents[3]
TEXT = (ROOT / "docs" / "scenes.md").read_text()
MODELS = [
    one for one in vars(model).values() if isinstance(one, type) and issubclass(one, BaseModel) and one.model_fields
]
SECTIONS = {
    "Body": "## `[body]`",
    "TissueModel": "## `[tissue.NAME]`",
    "Profile": "A bar force that varies",
    "CellModel": "`cell = {",
    "Support": "## `[[support]]`",
    "Load": "## `[[load]]`",
    "Along": "A traction that varies",
    "Solve": "## `[solve]`",
}


def rows(section):
    """Cells of the table's rows below a line, by their key."""
    below = TEXT[TEXT.index(section) :]
    table = re.search(r"\n\| key .*\n\|[-|]+\n((?:\|.*\n)+)", below)
    assert table is not None
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table.group(1).splitlines()]
    return {row[0].strip("`"): row for row in cells}


def test_every_model_has_a_section():
    assert {one.__name__ for one in MODELS} == {*SECTIONS, "SceneModel"}
    for name in model.SceneModel.model_fields:
        assert f"`[{name}" in TEXT or f"`[[{name}" in TEXT


@pytest.mark.parametrize("one", [one for one in MODELS if one.__name__ in SECTIONS], ids=lambda one: one.__name__)
def test_every_key_is_in_its_table_with_its_default(one):
    found = rows(SECTIONS[one.__name__])
    assert list(found) == list(one.model_fields)
    for name, field in one.model_fields.items():
        if isinstance(field.default, BaseModel) or field.default in (None, PydanticUndefined, (), {}, ("x", "y", "z")):
            continue
        shown = f'`"{field.default}"`' if isinstance(field.default, str) else f"{field.default:g}".lower()
        shown = str(field.default).lower() if isinstance(field.default, bool) else shown
        assert found[name][2] == shown


def test_the_code_runs(tmp_path, monkeypatch):
    blocks = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    assert len(blocks) == 2
    monkeypatch.chdir(tmp_path)
    os.symlink(ROOT / "docs", tmp_path / "docs")
    first: dict[str, object] = {}
    exec(blocks[0], first)
    assert isinstance(first["summary"], dict)
    assert first["summary"]["displacements"]["right"][0] > 1e-6
    second: dict[str, object] = {}
    exec(blocks[1], second)
    assert len(second["free"].motions) == 6  # type: ignore[attr-defined]
    assert second["solution"].converged  # type: ignore[attr-defined]
