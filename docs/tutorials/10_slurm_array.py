"""
A sweep as a Slurm array
========================

The sweep of the last page on a cluster: an array of jobs, one for each bar force, each on some MPI ranks. A task that
was killed goes on after its last step of the load when it is started again. :doc:`/install` says how to install
beside a cluster's MPI and PETSc. With the two files below in a folder that all nodes see, ``sbatch sweep.sbatch``
starts it.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import mkdtemp

from tsg_micro.data.figure_style import new_figure

sweep = """#!/bin/bash
#SBATCH --job-name=bar-force
#SBATCH --array=0-3                     # one task for each bar force
#SBATCH --ntasks=8 --cpus-per-task=1    # MPI ranks of a task
#SBATCH --time=00:10:00
set -euo pipefail
export OMP_NUM_THREADS=1
forces=(5 10 20 40)                     # nN
force=${forces[$SLURM_ARRAY_TASK_ID]}
mkdir -p sweep
sed "s/10 nN/$force nN/" sheet.toml > "sweep/$force.toml"
${LAUNCH-srun} tsgdd solve "sweep/$force.toml" --out "sweep/$force" --no-plots
"""
sheet = """
body = {sheet = ["160 um", "80 um"]}
tissue.all = {bar_force = "10 nN"}
support = [{side = "bottom"}]
load = [{side = "top", displacement = [0, "1.6 um", 0]}]    # 2 %
"""
folder = Path(mkdtemp())
(folder / "sweep.sbatch").write_text(sweep)
(folder / "sheet.toml").write_text(sheet)

# %%
# No scheduler is at hand here. Its part is played by a loop, over two of the four tasks, and ``LAUNCH`` takes the
# place of ``srun``.

path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
for task in (0, 3):
    environment = os.environ | {"PATH": path, "LAUNCH": "", "SLURM_ARRAY_TASK_ID": str(task)}
    subprocess.run(["bash", "sweep.sbatch"], check=True, capture_output=True, cwd=folder, env=environment)

# %%
# Each task leaves a folder; its summary has all numbers with their units (``tsgdd table sweep/*/ --out sweep.csv`` puts
# those of all of them into one table).

pull = {}
for summary in sorted(folder.glob("sweep/*/summary.json"), key=lambda path: int(path.parent.name)):
    found = json.loads(summary.read_text())
    force = found["parameters"]["tissues"]["all"]["bar_force"]
    pull[force] = found["reactions"]["top"][1]
    print(f"{force:.0e} N: pull {pull[force]:.3g} {found['units']['reactions']}")

# %%
# Eight times the prestress makes the sheet some three times as stiff: members stretch too, and clamps hold its width.

assert list(pull) == [5e-9, 40e-9]
assert 2.5 < pull[40e-9] / pull[5e-9] < 8.0

# %%
# The picture: the pull of each task.

figure = new_figure(5.0, 4.0)
axes = figure.subplots()
axes.bar([f"{1e9 * force:.0f} nN" for force in pull], [1e9 * value for value in pull.values()])
axes.set(xlabel="bar force", ylabel="pull / nN")
axes.spines[["top", "right"]].set_visible(False)
