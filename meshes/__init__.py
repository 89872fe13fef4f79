"""Builders of hexahedral gmsh meshes with named sides, in m."""

from meshes.sheet import curved_sheet, flat_sheet, sheet_with_hole, tapered_sheet

__all__ = ["curved_sheet", "flat_sheet", "sheet_with_hole", "tapered_sheet"]
