"""Planar Lyapunov orbits about the point between Earth and Moon: half of each is unknown, their energy picks them.

The energy E is a parameter that only `select` knows. Run: python examples/lyapunov_orbit.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import OdeModel, find_orbit, style

x, y, u, v, mu, E = (ca.SX.sym(name) for name in ("x", "y", "u", "v", "mu", "E"))
effective = (x**2 + y**2) / 2 + (1 - mu) / ca.sqrt((x + mu) ** 2 + y**2) + mu / ca.sqrt((x - 1 + mu) ** 2 + y**2)
energy = (u**2 + v**2) / 2 - effective
three_bodies = OdeModel(
    "three bodies", ca.vertcat(x, y, u, v),
    ca.vertcat(u, v, 2 * v + ca.gradient(effective, x), -2 * u + ca.gradient(effective, y)),
    ca.vertcat(mu, E), reversal=(1, -1, -1, 1), hamiltonian=energy, nominal=(0.0121505856, -1.594),
)  # fmt: skip


def linear(t: float) -> list[float]:
    """The small ellipse of the linearised equations about L1."""
    w, k, size = 2.33439, 3.5868, 1e-3
    return [0.8369151 - size * np.cos(w * t), k * size * np.sin(w * t), w * size * np.sin(w * t),
            k * w * size * np.cos(w * t)]  # fmt: skip


@style()
def main(picture: Path | str | None = None):
    """The family from E = -1.594 to -1.55, with orbits exactly at some energies."""
    first = find_orbit(three_bodies, linear, 2.69, select=energy - E, symmetric=True)
    branch = first.follow("E", -1.55, at=[-1.59, -1.58, -1.57, -1.56, -1.55])
    if picture is not None:
        draw(branch).savefig(picture, dpi=150)
    return branch


def draw(branch) -> Figure:
    """Some orbits in the rotating plane, and the period against the energy."""
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for value, grey in zip((-1.59, -1.58, -1.57, -1.56, -1.55), (0.75, 0.6, 0.45, 0.25, 0.0), strict=True):
        orbit = branch.at(value)
        states = orbit.evaluate(np.linspace(0.0, orbit.period, 801))
        left.plot(states[:, 0], states[:, 1], color=str(grey), lw=1, label=f"E = {value:g}")
    left.plot(1 - 0.0121505856, 0.0, "o", color="tab:blue", ms=5, label="Moon")
    left.set(xlabel="x", ylabel="y", aspect="equal")
    left.legend(fontsize="small", loc="upper right", handlelength=1.2)
    right.plot(branch.values, [orbit.period for orbit in branch.solutions], "k-", marker=".", ms=4)
    right.set(xlabel="energy E", ylabel="period T")
    right.locator_params(axis="x", nbins=4)
    return figure


if __name__ == "__main__":
    for orbit in main(*sys.argv[1:2]).solutions:
        largest = orbit.floquet().multipliers[0].real
        print(f"E = {orbit['E']:.6f}: T = {orbit.period:.10f} +- {orbit.period_error:.0e}, multiplier {largest:.5f}")
