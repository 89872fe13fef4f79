"""The command line: text to arguments, figures to text; computes nothing."""

from workflows.cli.commands import app
from workflows.cli.entry import main

__all__ = ["app", "main"]
