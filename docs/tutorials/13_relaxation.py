"""
Relaxation
==========

Tissue that is stretched and held relaxes. No law here knows time; but where the members relax slowly, each moment is
an equilibrium, and a loop over time is a few lines: rest lengths creep, and the equilibrium follows.

Tendons are Maxwell elements in parallel with their motors: what a tendon carries beyond its active force t_a, that at
rest, lengthens its rest length with the time tau,

    dl0/dt = l0 (t - t_a) / (EA tau),

while bars stay elastic.
"""

from dataclasses import replace

import numpy as np

import tsg_micro as tsg
from tsg_micro.data.figure_style import new_figure, tidy

spec = tsg.RVESpec(tsg.Tissue(bar_force=10e-9), free=("xx", "zz", "yz", "xz", "xy"))
stretch = np.array([0.0, 0.06, 0.0, 0.0, 0.0, 0.0])


def relax(step: float, end: float):
    """Times over tau, stress along y (Pa) and the largest force of a tendon over its active one, in steps of time."""
    rve = spec.build()
    structure = rve.structure
    tendons = ~structure.bars
    length = np.linalg.norm(tsg.member_vectors(structure), axis=1)
    active = structure.law.force(length, structure.rest_length, structure.material)
    state = rve.solve_strain(stretch)
    times, stress = [0.0], [state.first_piola[1, 1]]
    while times[-1] < end - 1e-9:
        force = state.equilibrium.members.force
        creep = step * (force - active) / structure.EA
        structure = replace(structure, rest_length=structure.rest_length * (1.0 + np.where(tendons, creep, 0.0)))
        later = tsg.RVE(structure, free=spec.free)
        later.solver.move_to(rve.solver.y, rve.solver.force)
        rve, state = later, later.solve_strain(stretch)
        times.append(times[-1] + step)
        stress.append(state.first_piola[1, 1])
    over = state.equilibrium.members.force[tendons] / active[tendons]
    return np.array(times), np.array(stress), over.max()


times, stress, over = relax(0.1, 6.0)
print(f"stress at once {stress[0]:.1f} Pa, at tau {stress[10]:.1f} Pa, at 6 tau {stress[-1]:.1f} Pa")
print(f"tendons carry up to {over:.3f} of their active force in the end")

# %%
# The stress falls all the way, to what the motors alone hold. Half the step of time gives the same.

half = relax(0.05, 1.0)[1]
assert (np.diff(stress) < 0).all()
assert abs(half[-1] / stress[10] - 1.0) < 0.02

# %%
# The picture: stress over time.

figure = new_figure(6.0, 4.0)
axes = figure.subplots()
axes.plot(times, stress, "-", label="steps of 0.1")
axes.plot(0.05 * np.arange(len(half)), half, ".", label="steps of 0.05")
axes.set(xlabel=r"time / $\tau$", ylabel="nominal stress / Pa", ylim=(0, None))
axes.legend()
tidy(axes)
