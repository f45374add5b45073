"""Orbits that turn: a pendulum on both sides of its separatrix, and the voltage of a Josephson junction.

Both branches of the pendulum, and that of the junction, end where the period grows without bound.

Run: python examples/turning_orbits.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from scipy.special import ellipk

from casadi_skin import OdeModel, find_orbit, style

q, v, E, current, damping = (ca.SX.sym(name) for name in ("q", "v", "E", "I", "c"))
energy = v**2 / 2 - ca.cos(q)
pendulum = OdeModel("pendulum", ca.vertcat(q, v), ca.vertcat(v, -ca.sin(q)), E, hamiltonian=energy, reversal=(-1, 1))
junction = OdeModel(
    "junction", ca.vertcat(q, v), ca.vertcat(v, current - damping * v - ca.sin(q)), ca.vertcat(current, damping)
)


@style()
def main(picture: Path | str | None = None):
    """Orbits that swing and that go round, and those of the junction at a small damping."""
    common = {"select": energy - E, "symmetric": True}
    swings = find_orbit(pendulum, lambda t: [np.sin(t), np.cos(t)], 6.7, parameters={"E": -0.5}, **common)
    turns = find_orbit(pendulum, lambda t: [2.0 * t, 2.0], np.pi, parameters={"E": 3.0}, rotations={"q": 1}, **common)
    carries = find_orbit(junction, lambda t: [3.0 * t, 3.0], 2.1, parameters={"I": 1.5, "c": 0.5}, rotations={"q": 1})
    branches = swings.follow("E", 1.5), turns.follow("E", 0.5), carries.follow("I", 0.1)
    if picture is not None:
        draw(*branches).savefig(picture, dpi=150)
    return branches


def draw(swings, turns, carries) -> Figure:
    """The periods of the pendulum with their closed forms; current and mean voltage, which is 2 pi/T."""
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    below, above = np.linspace(-0.6, 0.9999, 400), np.linspace(1.0001, 3.0, 400)
    left.plot(below, 4 * ellipk((1 + below) / 2), "-", color="0.7", lw=3, label="closed form")
    left.plot(above, 2 * np.sqrt(2 / (1 + above)) * ellipk(2 / (1 + above)), "-", color="0.7", lw=3)
    left.plot(swings["E"], swings.period, "k.", ms=4, label="swings")
    left.plot(turns["E"], turns.period, "k^", ms=3, mfc="white", label="goes round")
    left.axvline(1.0, color="0.5", ls=":", lw=1)
    left.set(xlabel="energy E", ylabel="period T", ylim=(0, 30))
    left.legend(fontsize="small")
    right.plot(2 * np.pi / carries.period, carries["I"], "k-", lw=1.2)
    (end,) = carries.special_points
    right.plot(0.0, end.parameters["I"], "k_", ms=14, mew=2, label=f"{end.kind}, I = {end.parameters['I']:.4f}")
    right.plot([0, 0], [0, 1], "-", color="0.6", lw=2, label="rests")
    right.set(xlabel="mean voltage", ylabel="current I")
    right.legend(fontsize="small")
    return figure


if __name__ == "__main__":
    for branch in main(*sys.argv[1:2]):
        print(branch.special_points[0], branch.reason, sep="\n")
