"""A shock at a turning point, eps u'' + x u' = -eps pi^2 cos(pi x) - pi x sin(pi x), for eps from 1e-2 to 1e-6.

Exactly cos(pi x) + erf(x / sqrt(2 eps)) / erf(1 / sqrt(2 eps)). Run: python examples/boundary_layer.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from scipy.special import erf

from casadi_skin import BoundaryValueProblem, OdeModel, style

u, v, eps, x = (ca.SX.sym(name) for name in ("u", "v", "eps", "x"))
bend = -x * v / eps - np.pi**2 * ca.cos(np.pi * x) - np.pi * x * ca.sin(np.pi * x) / eps
shock = OdeModel("shock", ca.vertcat(u, v), ca.vertcat(v, bend), eps, time=x, forcing_period=2.0)
problem = BoundaryValueProblem(shock, [shock.start(u) + 2, shock.end(u)], interval=(-1.0, 1.0), parameters={"eps": 1.0})


@style()
def main(picture: Path | str | None = None):
    """Solutions, each from nothing: the mesh finds the layer by itself."""
    found = [problem.with_parameters(eps=value).solve([0.0, 0.0], tolerance=1e-7) for value in (1e-2, 1e-4, 1e-6)]
    if picture is not None:
        draw(found).savefig(picture, dpi=150)
    return found


def true_error(solution) -> float:
    """Largest error of u relative to its largest value, at places all over and in the layer."""
    r = np.sqrt(2 * solution["eps"])
    t = np.unique(np.clip(np.concatenate([np.linspace(-1, 1, 2001), r * np.linspace(-6, 6, 2001)]), -1, 1))
    exact = np.cos(np.pi * t) + erf(t / r) / erf(1 / r)
    return float(np.max(np.abs(solution.evaluate(t)[:, 0] - exact)) / np.max(np.abs(exact)))


def draw(found) -> Figure:
    """The solutions, and the lengths of their intervals."""
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for solution, look in zip(found, ("k:", "k--", "k-"), strict=True):
        t = np.unique(np.concatenate([np.linspace(-1, 1, 801), solution.t]))
        left.plot(t, solution.evaluate(t)[:, 0], look, lw=1, label=rf"$\varepsilon$ = {solution['eps']:g}")
        mesh = solution.mesh
        right.semilogy(mesh[:-1] + np.diff(mesh) / 2, np.diff(mesh), look, lw=1)
    left.set(xlabel="x", ylabel="u")
    left.legend(fontsize="small")
    right.set(xlabel="x", ylabel="length of an interval")
    return figure


if __name__ == "__main__":
    for solution in main(*sys.argv[1:2]):
        words = f"{solution.intervals} intervals, error {true_error(solution):.1e}, estimated {solution.error:.1e}"
        print(f"eps = {solution['eps']:g}: {words}")
