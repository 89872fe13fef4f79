"""
A sweep over bar forces, under mpirun
=====================================

How stiff is a sheet with more or less prestress? One scene, a bar force at a time; every command that solves runs on
any number of MPI ranks with the same answer::

    mkdir -p sweep
    for f in 5 10 20 40; do
        sed "s/10 nN/$f nN/" sheet.toml > sweep/$f.toml
        mpirun -n 2 tsgdd solve sweep/$f.toml --out sweep/$f
    done
"""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from tsg_micro.data.figure_style import new_figure, tidy
from workflows.runs.solve_scene import solve_scene
from workflows.scenes.read import scene_of

folder = Path(mkdtemp())
scene = """
body = {sheet = ["160 um", "80 um"]}
tissue.all = {bar_force = "10 nN"}
support = [{side = "bottom"}]
load = [{side = "top", displacement = [0, "1.6 um", 0]}]    # 2 %
"""
forces = [5, 10, 20, 40]
pull = {}
for force in forces:
    text = scene.replace("10 nN", f"{force} nN")
    found = solve_scene(folder / str(force), scene_of(tomllib.loads(text)), plots=False)
    pull[force] = found["reactions"]["top"][1]
    print(f"{force:2} nN: pull {1e9 * pull[force]:.2f} nN, {found['rves']} RVEs")

# %%
# The last of them again, on two ranks: the RVEs and the elements are shared, and the answer is the same.

(folder / "sheet.toml").write_text(text)
path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
mpirun, tsgdd = shutil.which("mpirun", path=path), shutil.which("tsgdd", path=path)
out = folder / "ranks"
command = [mpirun, "-n", "2", tsgdd, "solve", folder / "sheet.toml", "--out", out, "--no-plots"]
subprocess.run(command, check=True, capture_output=True, env=dict(os.environ))
ranks = json.loads((out / "summary.json").read_text())
print(f"{ranks['ranks']} ranks: pull {1e9 * ranks['reactions']['top'][1]:.2f} nN")
assert abs(ranks["reactions"]["top"][1] / pull[40] - 1.0) < 1e-8

# %%
# The picture: stiffness against prestress, with the slope that it would have if it were all prestress.

modulus = np.array([pull[force] for force in forces]) / (160e-6 * 20e-6) / 0.02
figure = new_figure(6.0, 4.0)
axes = figure.subplots()
axes.loglog(forces, 1e-3 * modulus, "o-", label="sheet")
axes.loglog(forces, 1e-3 * modulus[1] * np.array(forces) / 10, "--", color="0.5", label="in proportion")
axes.set(xlabel="bar force / nN", ylabel="nominal stress over strain / kPa")
axes.set(xticks=forces, xticklabels=forces, yticks=[0.5, 1, 2, 4], yticklabels=["0.5", "1", "2", "4"])
axes.minorticks_off()
axes.legend()
tidy(axes)
