"""
A member law of your own
========================

A law is what a member answers to its length: energy, force, stiffness, and the rest length at which it carries some
force. Here tendons stiffen exponentially, as networks of filaments do, and bars stay linear. With k -> 0 it is the
linear law. :doc:`/CONTRIBUTING` says where its file goes so that scenes and commands know it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import simpson

import tsg_micro as tsg
from tsg_micro.data.figure_style import new_figure, shades, tidy


@tsg.member_law("stiffening tendons")
@dataclass(frozen=True)
class StiffeningTendons:
    """t = EA (exp(k e) - 1) / k in tendons, EA e in bars, with e = l / l0 - 1."""

    k: float = 50.0

    def energy(self, length, rest_length, members):
        e, k = length / rest_length - 1.0, self.k
        density = np.where(members.bar, 0.5 * e**2, (np.expm1(k * e) / k - e) / k)
        return float(np.sum(members.EA * rest_length * density))

    def force(self, length, rest_length, members):
        e = length / rest_length - 1.0
        return members.EA * np.where(members.bar, e, np.expm1(self.k * e) / self.k)

    def stiffness(self, length, rest_length, members):
        e = length / rest_length - 1.0
        return members.EA / rest_length * np.where(members.bar, 1.0, np.exp(self.k * e))

    def rest_length(self, length, force, members):
        e = force / members.EA
        return length / (1.0 + np.where(members.bar, e, np.log1p(self.k * e) / self.k))


# %%
# One block of a sheet, its faces free, is stretched along y; it may grow narrower and thinner as it likes.

strains = np.linspace(0.0, 0.16, 9)
curves = {}
for k in (0.01, 50.0, 100.0):
    tissue = tsg.Tissue(bar_force=10e-9, law=StiffeningTendons(k))
    rve = tsg.RVESpec(tissue, free=("xx", "zz", "yz", "xz", "xy")).build()
    states = [rve.solve_strain([0.0, e, 0.0, 0.0, 0.0, 0.0]) for e in strains]
    curves[k] = np.array([state.first_piola[1, 1] for state in states])
    energy = np.array([state.equilibrium.energy for state in states]) / rve.structure.volume
    print(f"k = {k:g}: {curves[k][-1]:.0f} Pa at {strains[-1]:.0%}")

# %%
# What the law stores is the work of the stress, which is how a mistake in a derivative shows.

work = simpson(curves[100.0], x=strains)
print(f"stored {energy[-1] - energy[0]:.3f} J/m³, work of the stress {work:.3f} J/m³")
assert abs(work / (energy[-1] - energy[0]) - 1.0) < 2e-3

# %%
# The picture: stress over strain.

figure = new_figure(6.0, 4.0)
axes = figure.subplots()
for colour, (k, stress) in zip(shades(3), curves.items(), strict=True):
    axes.plot(100 * strains, stress, color=colour, label="linear" if k < 1 else f"$k$ = {k:g}")
axes.set(xlabel="strain / %", ylabel="nominal stress / Pa")
axes.legend()
tidy(axes)
