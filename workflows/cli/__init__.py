"""The command line: text to arguments, figures to text; computes nothing."""

from workflows.cli.commands import app, main

__all__ = ["app", "main"]
