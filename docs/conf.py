"""How Sphinx builds these pages: ``make docs``, without a network; warnings are errors."""

from __future__ import annotations

import os
import re
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

import typer.main
from sphinx.application import Sphinx
from sphinx_gallery.scrapers import figure_rst
from typer.cli import get_docs_for_click

from workflows.cli import app as tsgdd

os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("OMP_NUM_THREADS", "1")

project = "tsgdd"
author = copyright = "The tsgdd developers"
version = release = version_of("tsgdd")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "templates", "tutorials"]
templates_path = ["templates"]
suppress_warnings = ["config.cache"]

html_theme = "pydata_sphinx_theme"
html_title = "tsgdd"
html_show_sourcelink = False
html_theme_options = {"show_toc_level": 2, "secondary_sidebar_items": ["page-toc"]}

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

autodoc_default_options = {"members": True, "member-order": "bysource"}
nitpicky = True
nitpick_ignore_regex = [("py:class", ".*")]  # types of other packages, and of the rooms inside
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 100


def _the_figure(block: Any, variables: dict[str, Any], gallery: dict[str, Any]) -> str:
    """The picture of a block of a tutorial is its ``figure``, which needs no pyplot."""
    figure = variables["example_globals"].pop("figure", None)
    if figure is None:
        return ""
    path = next(variables["image_path_iterator"])
    figure.savefig(path, dpi=110)
    return str(figure_rst([path], gallery["src_dir"]))


sphinx_gallery_conf = {
    "examples_dirs": "tutorials",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": (_the_figure,),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
}

_CODE = re.compile(r"(``.*?``|:\w+:`.*?`|`.*?`)")


def _plain(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Norms |y - z| and stars eps* of docstrings are no markup; examples and what is between back quotes stay."""
    for i, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...")):
            parts = _CODE.split(line)
            parts[::2] = [re.sub(r"[|*]", r"\\\g<0>", part) for part in parts[::2]]
            lines[i] = "".join(parts)


def _short(app: Sphinx, what: str, name: str, obj: object, options: object, given: str | None, back: str | None) -> Any:
    """Types by their own names, without those of the modules that they are from."""
    return tuple(text and re.sub(r"~?(?:[A-Za-z_]\w*\.)+(?=[A-Za-z_])", "", text) for text in (given, back))


def _command_line(app: Sphinx) -> None:
    """Write the page of all commands from their own help."""
    command = typer.main.get_command(tsgdd)
    context = typer.Context(command, info_name="tsgdd")
    text = get_docs_for_click(obj=command, ctx=context, name="tsgdd", title="Command line")
    page = Path(app.srcdir) / "generated" / "command_line.md"
    page.parent.mkdir(exist_ok=True)
    page.write_text(text.strip() + "\n", encoding="utf-8")


def setup(app: Sphinx) -> None:
    """What is done before the pages are read."""
    app.connect("builder-inited", _command_line, priority=100)
    app.connect("autodoc-process-docstring", _plain, priority=100)
    app.connect("autodoc-process-signature", _short)
