"""One command, one folder of results."""
