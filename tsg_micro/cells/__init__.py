"""Cells at rest: unit cell, parameters, lattice, prestress; no displacement appears here."""
