"""Van der Pol's limit cycle from mu = 0.1 to 10: period, estimated error and the multiplier that is not 1.

Run: python examples/van_der_pol.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import OdeModel, find_orbit, style

x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
model = OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu)


@style()
def main(picture: Path | str | None = None):
    """The branch of orbits, with those at mu = 1 and 10 exactly."""
    first = find_orbit(model, lambda t: [2 * np.cos(t), -2 * np.sin(t)], 2 * np.pi, parameters={"mu": 0.1})
    branch = first.follow("mu", 10.0, at=[1.0, 10.0], max_step=0.5)
    if picture is not None:
        draw(branch).savefig(picture, dpi=150)
    return branch


def draw(branch) -> Figure:
    """Orbits in the plane of x and y, and the period against mu."""
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for orbit, look in ((branch.solutions[0], "k:"), (branch.at(1.0), "k--"), (branch.at(10.0), "k-")):
        states = orbit.evaluate(np.linspace(0.0, orbit.period, 2001))
        left.plot(*states.T, look, lw=1, label=rf"$\mu$ = {orbit['mu']:g}")
    left.set(xlabel="x", ylabel="y")
    left.legend(loc="upper left", fontsize="small")
    right.plot(branch["mu"], [orbit.period for orbit in branch.solutions], "k-", marker=".", ms=4)
    right.set(xlabel=r"$\mu$", ylabel="period T")
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    for orbit in (found.at(1.0), found.at(10.0)):
        other = orbit.floquet().others[0].real
        print(
            f"mu = {orbit['mu']:g}: T = {orbit.period:.11f} +- {orbit.period_error:.0e}, other multiplier {other:.6g}"
        )
