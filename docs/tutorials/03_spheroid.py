"""
A spheroid with graded prestress
================================

A ball of cells, stiff in the middle and soft outside: the bar force falls from 50 nN in the centre to 7 nN at the
rim. A pressure acts on its surface and follows it, and nothing holds it: rigid motions are held in the mean of the
body. As a file, ``docs/examples/spheroid.toml``::

    tsgdd solve spheroid.toml --out results
    tsgdd dns spheroid.toml --out full              # the same with every bar and tendon
    tsgdd compare --dd results --dns full --out c   # shell by shell
"""

import tomllib
from pathlib import Path
from tempfile import mkdtemp

import dd_macro as dd
from tsg_micro.figures.hexahedra import plot_hexahedra
from workflows.runs.solve_scene import solve_scene
from workflows.scenes.read import scene_of

scene = """
[body]
spheroid = 3                            # radius in blocks

[tissue.cells]
bar_force = {profile = "exponential", f_max = "50 nN", decay = 2}

[[support]]
mean = true

[[load]]
side = "surface"
pressure = "100 Pa"

[solve]
kinematics = "finite"
steps = 2                               # 50 Pa, then 100 Pa
"""
out = Path(mkdtemp())
found = solve_scene(out, scene_of(tomllib.loads(scene)), plots=False)

# %%
# Every RVE of such a tissue is asked at a strain and a bar force; it answers with its stress and the derivatives by
# both.

for load, change in zip(found["factor_steps"], found["volume_change_steps"], strict=True):
    print(f"{100 * load:5.0f} Pa: volume {change:+.2%}")
print(f"{found['rves']} RVEs, estimated error {found['estimated_error']:.1e}")

# %%
# It is squeezed alike along all axes, and as much as the full tensegrity, whose volume changes by -5.72 % (the second
# command above; it takes most of a minute).

moved = found["displacements"]
assert abs(moved["left"][0] + moved["right"][0]) < 0.01 * moved["left"][0]
assert abs(moved["left"][0] - moved["bottom"][1]) < 0.01 * moved["left"][0]
assert abs(found["volume_change"] / -0.0572 - 1.0) < 0.05

# %%
# The picture: pressure in the body, an eighth cut out.

fields = dd.read_quadrature(out / "quadrature.h5")
figure = plot_hexahedra(fields.corners, fields.cell_mean(fields.mechanical_p), "pressure $p$ / Pa")
