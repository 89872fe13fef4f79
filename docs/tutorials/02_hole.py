"""
A sheet with a hole
===================

A body can be any mesh of hexahedra that gmsh writes; its named surfaces are sides, its named volumes regions.
``meshes`` builds some of them, here a quarter of a sheet with a round hole, cut along its two planes of symmetry.
With the mesh in ``hole.msh`` and the scene in ``hole.toml``, both beside each other in ``docs/examples``::

    tsgdd solve hole.toml --out results
"""

import tomllib
from pathlib import Path
from tempfile import mkdtemp

import dd_macro as dd
import meshes
import tsg_micro as tsg
from tsg_micro.data.figure_style import plot_maps
from workflows.runs.solve_scene import solve_scene
from workflows.scenes.read import scene_of

folder = Path(mkdtemp())
width, height, thickness, radius = 120e-6, 160e-6, 20e-6, 40e-6
meshes.quarter_with_hole(folder / "hole.msh", elements=(3, 5, 1), size=(width, height, thickness), radius=radius)

# %%
# ``fix = "normal"`` makes a side a plane of symmetry: nothing moves across it, all else is free. The back is one too,
# so that the sheet stays flat.

scene = """
body = {mesh = "hole.msh"}
tissue.sheet = {bar_force = "10 nN"}
support = [
    {side = "left", fix = "normal"},
    {side = "bottom", fix = "normal"},
    {side = "back", fix = "normal"},
]
load = [{side = "top", traction = [0, "20 Pa", 0]}]
"""
found = solve_scene(folder / "results", scene_of(tomllib.loads(scene), folder=folder), plots=False)
print(f"{found['rves']} RVEs, estimated error {found['estimated_error']:.1e}")

# %%
# The ligament beside the hole carries all of the load. Its stress is largest at the hole.

pull = 20.0 * width * thickness
assert abs(found["reactions"]["bottom"][1] / pull + 1.0) < 1e-6
fields = dd.read_quadrature(folder / "results" / "quadrature.h5")
stress = tsg.from_mandel(fields.cell_mean(fields.mechanical_stress))[:, 1, 1]
print(
    f"largest mean of a cell {stress.max():.1f} Pa; mean of the ligament {pull / thickness / (width - radius):.1f} Pa"
)

# %%
# The picture: the stress along the load, and the effective stress.

q = fields.cell_mean(fields.mechanical_q)
figure = plot_maps(fields.corners[:, :4, :2], {"first Piola $P_{yy}$": (stress, "Pa"), "effective $q$": (q, "Pa")})
