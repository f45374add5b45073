"""The forced Duffing oscillator through its resonance: two folds, between them three orbits, the middle one unstable.

Run: python examples/forced_duffing.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import OdeModel, find_orbit, style

q, v, omega, a, delta, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "a", "delta", "t"))
duffing = OdeModel(
    "Duffing", ca.vertcat(q, v), ca.vertcat(v, -q - q**3 - delta * v + a * ca.cos(omega * t)),
    ca.vertcat(omega, a, delta), time=t, forcing_period=2 * ca.pi / omega, nominal=(0.8, 0.5, 0.1),
)  # fmt: skip


@style()
def main(picture: Path | str | None = None):
    """The response from omega = 0.8 to 3, with all orbits at omega = 2."""
    branch = find_orbit(duffing, [0.0, 0.0]).follow("omega", 3.0, at=[2.0])
    if picture is not None:
        draw(branch).savefig(picture, dpi=150)
    return branch


def draw(branch) -> Figure:
    """Amplitude against frequency, stable and unstable, and the multipliers between the folds."""
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    size = np.array([np.abs(orbit["q"]).max() for orbit in branch.solutions])
    stable = np.array([orbit.floquet().stable for orbit in branch.solutions])
    axes.plot(branch.values, size, "-", color="0.7", lw=1)
    axes.plot(branch.values[stable], size[stable], "ko", ms=3.5, label="stable")
    axes.plot(branch.values[~stable], size[~stable], "ko", ms=3.5, mfc="none", label="unstable")
    for fold in branch.folds:
        axes.plot(fold["omega"], np.abs(fold["q"]).max(), "s", color="tab:red", mfc="none", ms=9)
    axes.plot([], [], "s", color="tab:red", mfc="none", ms=9, label="fold")
    axes.set(xlabel=r"frequency of the forcing $\omega$", ylabel=r"largest $|q|$", title=r"$a = 0.5,\ \delta = 0.1$")
    axes.legend(loc="upper left")
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    for fold in found.folds:
        print(f"fold at omega = {fold['omega']:.8f}: multipliers {np.round(fold.floquet().multipliers.real, 6)}")
    for which in range(3):
        orbit = found.at(2.0, which)
        print(f"omega = 2: largest |q| {np.abs(orbit['q']).max():.4f}, stable: {orbit.floquet().stable}")
