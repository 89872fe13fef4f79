"""Stages of a chain of runs: each has a folder, and is not run again while what decided it has not changed."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tsg_micro.data.files import atomic_path, check_regular, output_folder
from workflows.store.checkpoint import fingerprint

__all__ = ["Stages"]

_MARK = "stage.json"
_UNFINISHED = ("checkpoint.h5", "solves.csv")
"""Files from which a run that was cut short goes on."""


class Stages:
    """The stages in one folder, by name.

    A stage that is done leaves stage.json: the hash of its parameters and of the stages it read, and the size of every
    file that it made. It is valid while the hash is the same and the files are there.
    """

    def __init__(self, folder: Path, say: Callable[[str], None] = lambda text: None) -> None:
        """Raises InputError: the folder cannot be made."""
        self.folder, self.say = output_folder(folder), say
        self.ran: list[str] = []
        self.skipped: list[str] = []
        self._hash: dict[str, str] = {}

    def run(
        self, name: str, parameters: Mapping[str, Any], action: Callable[[Path], Any], reads: tuple[str, ...] = ()
    ) -> Path:
        """The folder of stage ``name``, made by ``action(folder)`` unless it is there and valid.

        ``reads`` names the stages whose results it uses; they come first.
        """
        folder = self.folder / name
        run = fingerprint({"stage": name, "parameters": dict(parameters), "reads": [self._hash[r] for r in reads]})
        self._hash[name] = run
        mark = folder / _MARK
        if _valid(mark, run):
            self.skipped.append(name)
            self.say(f"== {name}: there already")
            return folder
        self.say(f"== {name}")
        output_folder(folder)
        mark.unlink(missing_ok=True)
        for path in _files(folder):  # of another run, or left by a kill in the middle of a write
            if path.name not in _UNFINISHED:
                path.unlink()
        action(folder)
        files = {str(path.relative_to(folder)): path.stat().st_size for path in _files(folder)}
        with atomic_path(mark) as temporary:
            temporary.write_text(json.dumps({"hash": run, "files": files}, indent=2) + "\n")
        self.ran.append(name)
        return folder


def _files(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.rglob("*")) if path.is_file()]


def _valid(mark: Path, run: str) -> bool:
    """Whether the stage with this stage.json was made by the same run, and its files are as it left them."""
    try:
        check_regular(mark)
        stored = json.loads(mark.read_text())
        return stored["hash"] == run and all(
            (mark.parent / name).stat().st_size == size for name, size in stored["files"].items()
        )
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return False
