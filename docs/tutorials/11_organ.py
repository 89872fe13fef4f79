"""
From a segmented image to a solved organ
========================================

A segmented image is a stack of whole numbers, 0 outside, another number for each part, as segmentation programs save
it as TIFF. It is filled with cubes of one block each, and each label becomes a region that takes a tissue. At the
command line::

    tsgdd mesh voxels --labels organ.tif --spacing 10um 10um 10um --size 20um --out organ.msh
    tsgdd solve organ.toml --out results

A closed surface (STL, PLY, OBJ) does as well: ``--surface organ.stl --unit mm``.
"""

import tomllib
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import tifffile

import dd_macro as dd
from tsg_micro.figures.hexahedra import plot_hexahedra
from workflows.runs.solve_scene import solve_scene
from workflows.runs.voxels import voxels
from workflows.scenes.read import scene_of

folder = Path(mkdtemp())

# %%
# No microscope is at hand here: label 1 is an ellipsoid, label 2 a stiff core in it, beside the middle.

z, y, x = np.meshgrid(*(10.0 * (np.arange(n) + 0.5) for n in (12, 16, 20)), indexing="ij")  # µm
body = ((x - 100) / 100) ** 2 + ((y - 80) / 80) ** 2 + ((z - 60) / 60) ** 2 < 1
core = (x - 80) ** 2 + (y - 80) ** 2 + (z - 60) ** 2 < 35**2
image = np.where(body & core, 2, body).astype(np.uint8)
tifffile.imwrite(folder / "organ.tif", image, photometric="minisblack")

mesh = voxels(folder / "organ.msh", labels=folder / "organ.tif", spacing=("10um",) * 3, size="20um", plots=False)
print(f"{mesh['voxels']} voxels, regions {mesh['regions']}")

# %%
# It stands on its lowest voxels and carries its own weight under ten times gravity, in a centrifuge.

weight = 1e3 * 9.81 * 10.0  # N/m³
scene = f"""
body = {{mesh = "organ.msh"}}
tissue.soft = {{region = "label-1", bar_force = "10 nN", kind = "bulk"}}
tissue.core = {{region = "label-2", bar_force = "40 nN", kind = "bulk"}}
support = [{{side = "back"}}]
load = [{{body_force = [0, 0, -{weight}]}}]
"""
found = solve_scene(folder / "results", scene_of(tomllib.loads(scene), folder=folder), plots=False)
print(f"{found['rves']} RVEs, estimated error {found['estimated_error']:.1e}")
print(f"its top sinks by {-1e6 * found['displacements']['front'][2]:.2f} µm")

# %%
# What it stands on carries the weight of all its voxels.

assert abs(found["reactions"]["back"][2] / (weight * mesh["volume"]) - 1.0) < 1e-6

# %%
# The picture: vertical stress, an eighth cut out.

fields = dd.read_quadrature(folder / "results" / "quadrature.h5")
stress = fields.cell_mean(fields.mechanical_stress)[:, 2]
figure = plot_hexahedra(fields.corners, stress, "vertical stress $P_{zz}$ / Pa")
