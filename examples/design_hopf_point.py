"""The least change of parameters that keeps Lorenz's Hopf point beyond r = 30, with the way over the map of all.

Run: python examples/design_hopf_point.py PICTURE.png
"""

import sys
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Design, OdeModel, find_equilibrium, optimise, style

X, Y, Z, SIGMA, R, BETA = (ca.SX.sym(name) for name in ("x", "y", "z", "sigma", "r", "beta"))
FIELD = ca.vertcat(SIGMA * (Y - X), X * (R - Z) - Y, X * Y - BETA * Z)
LORENZ = OdeModel("Lorenz", ca.vertcat(X, Y, Z), FIELD, ca.vertcat(SIGMA, R, BETA))
OWN = {"sigma": 10.0, "r": 20.0, "beta": 8 / 3}


def change(hopf: Any) -> ca.SX:
    """The sum of squares of the relative changes."""
    return (hopf.sigma / OWN["sigma"] - 1) ** 2 + (hopf.beta / OWN["beta"] - 1) ** 2


@style()
def main(picture: Path | str | None = None) -> Design:
    """The nearest (sigma, beta) at which the Hopf point is at r = 30 or more."""
    branch = find_equilibrium(LORENZ, [8.0, 8.0, 19.0], parameters=OWN).follow("r", 30.0)
    (hopf,) = (point for point in branch.special_points if point.kind == "hopf")
    bounds = {"sigma": (5.0, 20.0), "beta": (1.0, 6.0), "r": (30.0, None)}
    result = optimise(change, of=hopf, over=["sigma", "beta"], bounds=bounds)
    if picture is not None:
        draw(result).savefig(picture, dpi=150)
    return result


def hopf_of(sigma: Any, beta: Any) -> Any:
    """r of the Hopf point in closed form."""
    return sigma * (sigma + beta + 3) / (sigma - beta - 1)


def draw(result: Design) -> Figure:
    """The way of the design over the places of all Hopf points."""
    figure = Figure(figsize=(5.6, 3.8), layout="constrained")
    axes = figure.subplots()
    sigma, beta = np.meshgrid(np.linspace(8.0, 12.0, 81), np.linspace(2.2, 4.2, 81))
    others = [r for r in np.arange(20, 45, 2.5) if r != 30.0]
    lines = axes.contour(sigma, beta, hopf_of(sigma, beta), levels=others, colors="0.7", linewidths=0.8)
    axes.clabel(lines, fmt="r = %g", fontsize=7)
    limit = axes.contour(sigma, beta, hopf_of(sigma, beta), levels=[30.0], colors="tab:blue", linewidths=1.2)
    axes.clabel(limit, fmt="r = %g", fontsize=7, manual=[(11.2, 3.57)])  # off the way of the design
    result.plot(axes)
    axes.legend(loc="lower right")
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    print(f"{found.reason}: sigma = {found['sigma']:.9f}, beta = {found['beta']:.9f}")
