"""The chain whose end breather keeps time best: least dOmega/dS at S = 1 over gamma.

Run: python examples/design_steady_breather.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, Design, follow_family, optimise, style

CHAIN = Chain(sites=24, alpha=1.0, gamma=0.4, g=1.0)


@style()
def main(picture: Path | str | None = None) -> Design:
    """The gamma at which the frequency of the end breather changes least with its amplitude."""
    orbit = follow_family(CHAIN, "last", 1.0).orbits[-1]
    result = optimise("Omega_slope", of=orbit, over=["gamma"], bounds={"gamma": (0.0, 0.9)})
    if picture is not None:
        draw(result).savefig(picture, dpi=150)
    return result


def slope(gamma: float, h: float = 0.01) -> float:
    """dOmega/dS at S = 1 by central differences of the family, with an error of order h^4."""
    at = 1.0 + h * np.array([-2.0, -1.0, 1.0, 2.0])
    branch = follow_family(Chain(CHAIN.sites, CHAIN.alpha, gamma, CHAIN.g), "last", at[-1], at=at, tolerance=1e-11)
    far_left, left, right, far_right = (branch.at(S=S).Omega for S in at)
    return float((8.0 * (right - left) - (far_right - far_left)) / (12.0 * h))


def draw(result: Design) -> Figure:
    """dOmega/dS against gamma."""
    figure = Figure(figsize=(5.6, 3.6), layout="constrained")
    axes = figure.subplots()
    gammas = np.linspace(0.02, 0.9, 45)
    axes.semilogy(gammas, [slope(gamma) for gamma in gammas], "k-", lw=1, label="differences along families")
    axes.semilogy(result["gamma"], result.value, "o", color="tab:red", mfc="none", ms=9, label="design")
    axes.set(xlabel=r"$\gamma$", ylabel=r"$d\Omega/dS$ at $S = 1$", title=r"$N = j = 24,\ \alpha = 1,\ g = 1$")
    axes.legend(loc="upper center")
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    print(f"{found.reason}: gamma = {found['gamma']:.9f}, dOmega/dS = {found.value:.9f}")
