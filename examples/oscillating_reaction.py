"""The Brusselator of 1,000 states oscillates: orbits from its first Hopf point, with their leading multipliers.

Run: python examples/oscillating_reaction.py PICTURE.png
"""

import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import OdeModel, find_equilibrium, style

A, B, D = 2.0, 5.45, (0.008, 0.004)  # u' = D1 u''/L^2 + A - (B + 1) u + u^2 v, v' = D2 v''/L^2 + B u - u^2 v


def brusselator(cells: int) -> OdeModel:
    """Second differences on `cells` points inside (0, 1), where u = A and v = B/A at both ends."""
    x, L = ca.SX.sym("x", 2 * cells), ca.SX.sym("L")
    u, v = x[:cells], x[cells:]
    around = ca.vertcat(A, u, A), ca.vertcat(B / A, v, B / A)
    spread = [d / L**2 * (w[2:] - 2 * w[1:-1] + w[:-2]) * (cells + 1) ** 2 for d, w in zip(D, around, strict=True)]
    rates = ca.vertcat(A - (B + 1) * u + u**2 * v, B * u - u**2 * v)
    return OdeModel("Brusselator", x, ca.vertcat(*spread) + rates, L)


@style()
def main(picture: Path | str | None = None, cells: int = 500, points: int = 6):
    """The first orbits on the branch that leaves the uniform state at its first Hopf point."""
    uniform = np.repeat([A, B / A], cells)
    rest = find_equilibrium(brusselator(cells), uniform, parameters={"L": 0.4}).follow("L", 0.7)
    branch = rest.special_points[0].follow("L", 0.7, max_points=points, stability=True)
    if picture is not None:
        draw(branch).savefig(picture, dpi=150)
    return branch


def draw(branch) -> Figure:
    """The last orbit in space and time, and the moduli of the leading multipliers along the branch."""
    figure = Figure(figsize=(6.4, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    orbit = branch.orbits[-1]
    t = np.linspace(0.0, orbit.period, 200)
    u = orbit.evaluate(t)[:, : orbit.model.size // 2]
    left.pcolormesh(np.arange(1, u.shape[1] + 1) / (u.shape[1] + 1), t, u, rasterized=True)
    left.set(xlabel="place", ylabel="time", title="u")
    for orbit in branch.orbits[1:]:
        moduli = np.abs(orbit.floquet().others)
        right.plot(np.full(moduli.size, orbit.parameters["L"]), moduli, "k.", ms=3)
    right.axhline(1.0, color="0.6", lw=0.8)
    right.set(xlabel="L", ylabel="moduli of the leading multipliers")
    return figure


if __name__ == "__main__":
    branch = main(*sys.argv[1:2])
    for orbit in branch.orbits[1:]:
        floquet = orbit.floquet()
        print(
            f"L = {orbit.parameters['L']:.5f}, period {orbit.period:.8f}, largest {floquet.max_abs_multiplier:.8f}, ",
            end="",
        )
        print(f"{floquet.multipliers.size} multipliers, no other above {floquet.beyond:.2g}")
    print(f"{time.process_time():.0f} s")
