"""The chain whose end breather keeps time best: least dOmega/dS at S = 1 over gamma.

Run: python examples/search_steady_breather.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, follow_family, search_orbit
from casadi_skin.optimise.search import SearchResult
from casadi_skin.results.figures.style import style

CHAIN = Chain(sites=24, alpha=1.0, gamma=0.4, g=1.0)


@style()
def main(picture: Path | str | None = None) -> SearchResult:
    """The gamma at which the frequency of the end breather changes least with its amplitude."""
    result = search_orbit(
        CHAIN, mode="last", S=1.0, objective="Omega_slope", free=("gamma",), bounds={"gamma": (0.0, 0.9)}, starts=4
    )
    if picture is not None:
        draw(result).savefig(picture, dpi=150)
    return result


def slope(gamma: float, h: float = 0.01) -> float:
    """dOmega/dS at S = 1 by central differences of the family, with an error of order h^4."""
    at = 1.0 + h * np.array([-2.0, -1.0, 1.0, 2.0])
    branch = follow_family(Chain(CHAIN.sites, CHAIN.alpha, gamma, CHAIN.g), "last", at[-1], at=at, tolerance=1e-11)
    far_left, left, right, far_right = (branch.at(S=S).Omega for S in at)
    return float((8.0 * (right - left) - (far_right - far_left)) / (12.0 * h))


def draw(result: SearchResult) -> Figure:
    """dOmega/dS against gamma."""
    figure = Figure(figsize=(5.6, 3.6), layout="constrained")
    axes, best = figure.subplots(), result.best
    gammas = np.linspace(0.02, 0.9, 45)
    axes.semilogy(gammas, [slope(gamma) for gamma in gammas], "k-", lw=1, label="differences along families")
    axes.semilogy(best.gamma, best.objective, "o", color="tab:red", mfc="none", ms=9, label="search")
    axes.set(xlabel=r"$\gamma$", ylabel=r"$d\Omega/dS$ at $S = 1$", title=r"$N = j = 24,\ \alpha = 1,\ g = 1$")
    axes.legend(loc="upper center")
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    print(f"{found.reason}: gamma = {found.best.gamma:.9f}, dOmega/dS = {found.best.objective:.9f}")
