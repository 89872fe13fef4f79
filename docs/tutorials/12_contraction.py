"""
Contraction
===========

Cells contract as motors shorten their filaments. Here the rest length of every tendon is shortened by a part; that
raises the force in all members, bars too. Between held ends the tissue pulls; left free it shrinks. (More bar force
alone, with rest lengths to match, would make it stiffer, but it would not pull: a cell's self-stress is in balance by
itself.)

There is no key of a scene for it: it is a member law of six lines.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

import dd_macro as dd
import tsg_micro as tsg
from tsg_micro.data.figure_style import new_figure, tidy

linear = tsg.Linear()


@tsg.member_law("contracting tendons")
@dataclass(frozen=True)
class ContractingTendons:
    """The linear law, with tendons whose rest lengths are shorter by the part ``by`` than when the cell was made."""

    by: float = 0.0

    def now(self, rest_length, members):
        return np.where(members.bar, rest_length, (1.0 - self.by) * rest_length)

    def energy(self, length, rest_length, members):
        return linear.energy(length, self.now(rest_length, members), members)

    def force(self, length, rest_length, members):
        return linear.force(length, self.now(rest_length, members), members)

    def stiffness(self, length, rest_length, members):
        return linear.stiffness(length, self.now(rest_length, members), members)

    def rest_length(self, length, force, members):
        return linear.rest_length(length, force, members)


# %%
# One RVE, held in length with free sides, then free: the tension of a muscle that cannot shorten, and the shortening
# of one that carries nothing.

sides = ("yy", "zz", "yz", "xz", "xy")
parts = np.linspace(0.0, 0.01, 6)
tension, shortening = [], []
for part in parts:
    tissue = tsg.Tissue(bar_force=10e-9, law=ContractingTendons(part))
    held = tsg.RVESpec.of_kind("bulk", tissue, free=sides).build().solve_strain(np.zeros(6))
    alone = tsg.RVESpec.of_kind("bulk", tissue, free=("xx", *sides)).build().solve_strain(np.zeros(6))
    tension.append(held.first_piola[0, 0])
    shortening.append(1.0 - alone.F[0, 0])
    print(f"tendons {part:.1%} shorter: held {tension[-1]:5.1f} Pa, free {shortening[-1]:.2%} shorter")

# %%
# A bar of such tissue, 160 x 40 x 40 µm, its ends held: between smooth plates it is homogeneous and pulls as the RVE
# does; glued to them it cannot grow narrower there, and pulls more.

operator = dd.EnhancedGradientOperator(dd.box(MPI.COMM_WORLD, elements=(8, 2, 2), size=(160e-6, 40e-6, 40e-6)))
material = dd.Material(source=tsg.RVESource(tsg.RVESpec.of_kind("bulk", tissue)))
ends = [dd.Displacement(side, (0.0,), (0,)) for side in ("left", "right")]
planes = [dd.Displacement("bottom", (0.0,), (1,)), dd.Displacement("back", (0.0,), (2,))]
glued = [dd.Displacement(side) for side in ("left", "right")]
pull = {}
for name, supports in (("smooth", [*ends, *planes]), ("glued", glued)):
    solution = dd.AdaptiveMethod().prepare(dd.Problem(operator, supports), material).solve()
    pull[name] = solution.reaction("right")[0] / 40e-6**2
    print(f"{name} ends: {pull[name]:.1f} Pa")

assert abs(pull["smooth"] / tension[-1] - 1.0) < 1e-3
assert pull["smooth"] < pull["glued"]

# %%
# The picture: both over the contraction.

figure = new_figure(6.0, 4.0)
left = figure.subplots()
right = left.twinx()
left.plot(100 * parts, tension, "o-", color="tab:red")
left.plot(100 * parts[-1], pull["glued"], "s", color="tab:red", mfc="none")
right.plot(100 * parts, 100 * np.array(shortening), "^--", color="tab:blue")
left.set_xlabel("tendons shorter by / %")
left.set_ylabel("tension between held ends / Pa (square: glued)", color="tab:red")
right.set_ylabel("shortening of a free block / %", color="tab:blue")
left.set_ylim(0.0, 16.0)
right.set_ylim(0.0, 0.6)
tidy(left)
right.spines["right"].set_visible(True)
