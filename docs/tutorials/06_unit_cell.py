"""
A unit cell of your own
=======================

A cell is nodes in the cube [-1, 1]³, members, and the kinds of these; neighbours are mirror images of it, so that any
cell tiles. This one is the truncated octahedron with two more tendons across each of its six square faces, as a
cortex that is cross-linked. At rest they carry nothing. :doc:`/CONTRIBUTING` has a cell that is written from nothing,
and where its file goes so that scenes and commands know it.
"""

from dataclasses import replace

import numpy as np

import tsg_micro as tsg
from tsg_micro.cells.unit_cell import SQUARE_TENDON
from tsg_micro.figures.space import plot_structure


def braced(half_diagonal: float) -> tsg.UnitCell:
    """The truncated octahedron with braces along the diagonals of its faces."""
    unit = tsg.unit_cell(half_diagonal)
    pairs = [(i, j) for sides in unit.faces for face in sides for i in face for j in face if i < j]
    apart = np.array([np.linalg.norm(unit.nodes[i] - unit.nodes[j]) for i, j in pairs])
    braces = np.array(pairs)[np.isclose(apart, apart.max())]
    more = len(braces)
    return replace(
        unit,
        members=np.concatenate([unit.members, braces]),
        kind=np.append(unit.kind, np.full(more, SQUARE_TENDON, dtype=np.uint8)),
        force_density=np.append(unit.force_density, np.zeros(more)),
    )


tsg.UNIT_CELLS["braced"] = braced

# %%
# A tissue of such cells is like any other: as one cell, a lattice, an RVE.

plain, own = tsg.Tissue(bar_force=10e-9), tsg.Tissue(bar_force=10e-9, unit="braced")
cell = own.box((1, 1, 1))
print(f"{len(cell.nodes)} nodes, {cell.bars.sum()} bars, {(~cell.bars).sum()} tendons")
out_of_balance = tsg.equilibrium_matrix(cell) @ tsg.self_stress(cell).states
assert np.abs(out_of_balance).max() < 1e-12

# %%
# Its tangent is the derivative of its stress; braces make it stiffer in every way.

stiffness = {}
for name, tissue in (("plain", plain), ("braced", own)):
    stiffness[name] = tsg.RVESpec.of_kind("bulk", tissue).build().solve_strain(np.zeros(6)).tangent
    print(f"{name:7}: C11 {stiffness[name][0, 0]:8.0f} Pa, C44 {stiffness[name][3, 3]:8.0f} Pa")
rve, small = tsg.RVESpec.of_kind("bulk", own).build(), 1e-5
stress = [tsg.to_mandel(rve.solve_strain([e, 0, 0, 0, 0, 0]).first_piola) for e in (small, -small)]
assert np.allclose((stress[0] - stress[1]) / (2 * small), stiffness["braced"][0], rtol=1e-4, atol=1.0)
assert np.linalg.eigvalsh(stiffness["braced"] - stiffness["plain"]).min() > -1e-6 * stiffness["braced"].max()

# %%
# The picture: one cell.

figure = plot_structure(cell)
