"""The gamma at which an end breather is hardest to make, found by optimisation and beside a scan of families.

Run: python examples/design_hardest_breather.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, Design, follow_family, optimise, style

CHAIN = Chain(sites=24, alpha=1.0, gamma=0.4, g=1.0)


@style()
def main(picture: Path | str | None = None) -> Design:
    """The largest S at which the family j = N reaches the upper cutoff of the infinite chain, over gamma."""
    result = optimise(
        "S",
        of=follow_family(CHAIN, "last", 1.0).orbits[-1],
        over=("S", "gamma"),
        bounds={"S": (0.01, 2.0), "gamma": (0.0, 0.95)},
        subject_to=[lambda o: o.Omega - o.upper_cutoff],
        maximise=True,
    )
    if picture is not None:
        draw(result).savefig(picture, dpi=150)
    return result


def threshold(gamma: float) -> float:
    """S at which the family leaves the band, from the family itself and no optimisation."""
    chain = Chain(CHAIN.sites, CHAIN.alpha, gamma, CHAIN.g)
    cutoff = float(np.sqrt(chain.band()[1]))
    return follow_family(chain, "last", 2.0, at_Omega=[cutoff], tolerance=1e-9).at(Omega=cutoff).S


def draw(result: Design) -> Figure:
    """The amplitude needed against gamma, and the profile of the orbit found."""
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    gammas = np.linspace(0.05, 0.95, 37)
    left.plot(gammas, [threshold(gamma) for gamma in gammas], "k-", lw=1, label="families, one gamma each")
    left.plot(result["gamma"], result.value, "o", color="tab:red", mfc="none", ms=9, label="design")
    left.set(xlabel=r"$\gamma$", ylabel=r"$S$ at which $\Omega$ reaches the cutoff", ylim=(0, 1.1))
    left.legend(loc="lower center")
    right.semilogy(np.arange(1, 25), np.abs(result.solution.profile), "ko-", ms=4)
    right.set(
        xlabel="site $n$", ylabel=r"$|y_n(0)|$", title=rf"$\gamma = {result['gamma']:.4f},\ S = {result.value:.4f}$"
    )
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    print(f"{found.reason}: gamma = {found['gamma']:.9f}, S = {found.value:.9f}")
