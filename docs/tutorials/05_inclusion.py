"""
An inclusion: two tissues
=========================

A cube of soft tissue with a stiff inclusion in its middle, between two plates. Each tissue takes a region of the
mesh, and RVEs of its own. As a file, ``docs/examples/inclusion.toml``::

    tsgdd solve inclusion.toml --out results
"""

import tomllib
from pathlib import Path
from tempfile import mkdtemp

import dd_macro as dd
import meshes
from tsg_micro.figures.hexahedra import plot_hexahedra
from workflows.runs.solve_scene import solve_scene
from workflows.scenes.read import scene_of

folder = Path(mkdtemp())
edge = 80e-6
meshes.box_with_inclusion(folder / "inclusion.msh", elements=(4, 4, 4), size=(edge, edge, edge), radius=18e-6)

scene = """
body = {mesh = "inclusion.msh"}
tissue.soft = {region = "matrix", bar_force = "5 nN"}
tissue.stiff = {region = "inclusion", bar_force = "20 nN"}
support = [{side = "back"}]
load = [{side = "front", displacement = [0, 0, "-1.6 um"]}]
"""


def force_on_the_plate(name: str, text: str) -> float:
    """Of the scene, N."""
    found = solve_scene(folder / name, scene_of(tomllib.loads(text), folder=folder), plots=False)
    print(f"{name}: {1e9 * found['reactions']['front'][2]:.3f} nN, estimated error {found['estimated_error']:.1e}")
    return float(found["reactions"]["front"][2])


# %%
# The force is between that of a cube of the soft tissue alone and one of the stiff tissue alone.

both = force_on_the_plate("both", scene)
soft = force_on_the_plate("soft", scene.replace("20 nN", "5 nN"))
stiff = force_on_the_plate("stiff", scene.replace("5 nN", "20 nN"))
assert stiff < both < soft < 0

# %%
# The picture: pressure where an eighth of the cube is cut out.

fields = dd.read_quadrature(folder / "both" / "quadrature.h5")
figure = plot_hexahedra(fields.corners, fields.cell_mean(fields.mechanical_p), "pressure $p$ / Pa")
