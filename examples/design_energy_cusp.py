"""Where real instability is born: the smallest gamma at which the energy along a family has an extremum.

Run: python examples/design_energy_cusp.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, Design, follow_family, optimise, style

CHAIN = Chain(sites=24, alpha=1.0, gamma=0.25, g=1.0)


@style()
def main(picture: Path | str | None = None) -> Design:
    """The smallest gamma with dE/dS = 0 at an S up to 2, on the family j = N."""
    result = optimise(
        "gamma",
        of=follow_family(CHAIN, "last", 1.0).orbits[-1],
        over=("S", "gamma"),
        bounds={"S": (0.05, 2.0), "gamma": (0.05, 0.5)},
        subject_to=["energy_slope"],
    )
    if picture is not None:
        draw(result).savefig(picture, dpi=150)
    return result


def energy_slope(gamma: float, S: np.ndarray) -> np.ndarray:
    """dE/dS of the family at these S by differences."""
    h = 1e-3
    at = np.sort(np.concatenate([S - h, S + h]))
    branch = follow_family(Chain(CHAIN.sites, CHAIN.alpha, gamma, CHAIN.g), "last", at[-1], at=at, tolerance=1e-11)
    energy = np.array([branch.at(S=value).energy for value in at])
    return (energy[1::2] - energy[::2]) / (at[1::2] - at[::2])


def draw(result: Design) -> Figure:
    """dE/dS along families below, at and above the gamma found."""
    figure = Figure(figsize=(5.6, 3.6), layout="constrained")
    axes = figure.subplots()
    S = np.linspace(0.3, 1.6, 53)
    for gamma, dashes in ((0.14, ":"), (result.value, "-"), (0.17, "--")):
        axes.plot(S, energy_slope(gamma, S), "k" + dashes, lw=1, label=rf"$\gamma = {gamma:.4f}$")
    axes.plot(result["S"], 0.0, "o", color="tab:red", mfc="none", ms=9, label="design")
    axes.axhline(0.0, color="0.6", lw=0.8)
    axes.set(xlabel=r"total amplitude $S$", ylabel=r"$dE/dS$", title=r"$N = j = 24,\ \alpha = 1,\ g = 1$")
    axes.legend(loc="upper center", ncols=2)
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    print(f"{found.reason}: gamma = {found.value:.9f} at S = {found['S']:.9f}")
