"""Builders of hexahedral gmsh meshes with named sides and regions, in m."""

from meshes.sheet import (
    box_with_inclusion,
    curved_sheet,
    flat_sheet,
    quarter_with_hole,
    sheet_with_hole,
    tapered_sheet,
)

__all__ = ["box_with_inclusion", "curved_sheet", "flat_sheet", "quarter_with_hole", "sheet_with_hole", "tapered_sheet"]
