"""Draws; nothing else in the package imports it."""
