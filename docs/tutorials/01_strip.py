"""
A strip with loads of your own
==============================

A strip of tissue, 400 x 60 x 20 µm, is held at its root and pulled at its tip. The scene is text; as a file,
``strip.toml``, the same is::

    tsgdd solve strip.toml --out results

Lengths, forces and stresses have units; :doc:`/scenes` has all keys.
"""

import tomllib
from pathlib import Path
from tempfile import mkdtemp

import dd_macro as dd
from tsg_micro.data.figure_style import plot_maps
from workflows.runs.solve_scene import solve_scene
from workflows.scenes.read import scene_of

scene = """
[body]
box = ["400 um", "60 um", "20 um"]      # 20 x 3 x 1 blocks of 2 x 2 x 2 cells

[tissue.all]
bar_force = "10 nN"                     # prestress: compression of the bars

[[support]]
side = "left"

[[load]]
side = "right"
traction = ["15 Pa", 0, 0]              # or displacement, pressure; body_force without a side
"""

# %%
# The method is adaptive if nothing is said: RVEs are computed where the strip's strains need them, and it ends with
# an estimate of the error which the data leave.

out = Path(mkdtemp())
found = solve_scene(out, scene_of(tomllib.loads(scene)), plots=False)
print(f"{found['rves']} RVEs, estimated error {found['estimated_error']:.1e}")
print(f"force on the root {found['reactions']['left'][0]:.3g} N")
print(f"the tip moves {1e6 * found['displacements']['right'][0]:.2f} µm")

# %%
# The root carries what pulls at the tip, and the tip moves as that of the full tensegrity does, by 7.12 µm
# (``tsgdd dns strip.toml --out full``).

assert abs(found["reactions"]["left"][0] + 15.0 * 60e-6 * 20e-6) < 1e-14
assert abs(found["displacements"]["right"][0] / 7.117e-6 - 1.0) < 0.04

# %%
# Fields are read from ``quadrature.h5``; ParaView opens ``fields.vtkhdf``. The picture: the stress along the pull,
# and the effective stress.

fields = dd.read_quadrature(out / "quadrature.h5")
along, q = fields.cell_mean(fields.mechanical_stress)[:, 0], fields.cell_mean(fields.mechanical_q)
shown = {"first Piola $P_{xx}$": (along, "Pa"), "effective stress $q$": (q, "Pa")}
figure = plot_maps(fields.corners[:, :4, :2], shown, columns=1)
