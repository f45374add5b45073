"""Where Lorenz' convection loses its stability, how that place moves with the other parameters, and how far it spreads.

Run: python examples/gradients.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import OdeModel, find_equilibrium, style

x, y, z, r, sigma, beta = (ca.SX.sym(name) for name in ("x", "y", "z", "r", "sigma", "beta"))
rates = ca.vertcat(sigma * (y - x), r * x - y - x * z, x * y - beta * z)
model = OdeModel("Lorenz", ca.vertcat(x, y, z), rates, ca.vertcat(r, sigma, beta))
deviations = {"sigma": 0.5, "beta": 0.1}


def closed_form(sigma, beta):
    """The r at which steady convection loses its stability."""
    return sigma * (sigma + beta + 3) / (sigma - beta - 1)


@style()
def main(picture: Path | str | None = None):
    """The Hopf point in r, its gradient, and the standard deviation of 1,000 draws of the parameters."""
    values = {"r": 20.0, "sigma": 10.0, "beta": 8 / 3}
    convection = find_equilibrium(model, {"x": 7.1, "y": 7.1, "z": 19.0}, parameters=values)
    hopf = convection.follow("r", 28.0).special_points[0]
    gradient = hopf.gradient()
    draws = np.random.default_rng(1).normal([10.0, 8 / 3], list(deviations.values()), (1000, 2))
    places = closed_form(*draws.T)
    if picture is not None:
        draw(hopf, gradient, places).savefig(picture, dpi=150)
    return hopf, gradient, places


def draw(hopf, gradient, places) -> Figure:
    """The place against sigma with its tangent, and the draws beside the normal distribution of first order."""
    figure = Figure(figsize=(6.8, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for to in (8.0, 13.0):
        curve = hopf.curve("sigma", to)
        left.plot(curve["sigma"], curve["r"], "k-", lw=1, label="Hopf points" if to > 10.0 else None)
    start, spread = hopf.parameters["sigma"], gradient.spread(deviations)
    way = np.array([-1.5, 1.5])
    left.plot(start + way, gradient.value + gradient["sigma"] * way, "C1--", lw=1.5, label="first order")
    left.plot(start, gradient.value, "ks", ms=4)
    left.set(xlabel=r"$\sigma$", ylabel="r")
    left.legend(fontsize="small")
    right.hist(places, 30, density=True, color="0.8", label="1,000 draws")
    along = np.linspace(places.min(), places.max(), 201)
    normal = np.exp(-0.5 * ((along - gradient.value) / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
    right.plot(along, normal, "C1-", lw=1.5, label="first order")
    right.set(xlabel="r at the Hopf point", ylabel="density")
    right.legend(fontsize="small")
    return figure


if __name__ == "__main__":
    point, slopes, drawn = main(*sys.argv[1:2])
    print(point)
    print(slopes)
    print(f"standard deviation {slopes.spread(deviations):.4f} to first order, {drawn.std():.4f} of 1,000 draws")
