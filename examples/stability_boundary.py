"""The amplitude at which the end breather first becomes unstable, against the nonreciprocity.

Run: python examples/stability_boundary.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, follow_family, style

GAMMAS = np.linspace(0.1, 0.6, 51)  # below, the family meets resonances that are too sharp to follow
DEPTHS = (1e-9, 1e-5, 1e-2)  # log |multiplier| over a period, from which on a tongue counts


def first_instabilities(gamma: float) -> list[tuple[float, float]]:
    """S of the first tongue of each depth, with its error; not a number where there is none up to S = 1."""
    chain = Chain(sites=16, alpha=0.5, gamma=gamma, g=-1.0)
    branch = follow_family(chain, mode=1, amplitude_max=1.0, stability=True)
    assert not branch.unresolved
    places = [branch.first_instability(growth=depth) for depth in DEPTHS]
    return [(np.nan, np.nan) if place is None else (place.S, place.S_error) for place in places]


@style()
def main(picture: Path | str | None = None, gammas: np.ndarray = GAMMAS) -> np.ndarray:
    """S and its error by gamma and depth, shape (gammas, depths, 2); drawn where a file is named."""
    found = np.array([first_instabilities(float(gamma)) for gamma in gammas])
    if picture is not None:
        draw(gammas, found[:, :, 0]).savefig(picture, dpi=150)
    return found


def draw(gammas: np.ndarray, S: np.ndarray) -> Figure:
    """S against gamma, a line for each depth."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    looks = zip(DEPTHS, S.T, ("o", "s", "^"), ("0.6", "0.3", "black"), strict=True)
    for depth, values, marker, colour in looks:
        exponent = round(np.log10(depth))
        axes.plot(gammas, values, marker, ms=4, mfc="none", color=colour, label=rf"growth $\geq 10^{{{exponent}}}$")
    axes.set(xlabel=r"nonreciprocity $\gamma$", ylabel=r"$S$ of the first instability", ylim=(0.0, 1.0))
    axes.set_title(r"$N = 16,\ \alpha = 0.5,\ g = -1,\ j = 1$")
    axes.legend(loc="upper right", frameon=True)
    return figure


if __name__ == "__main__":
    for gamma, row in zip(GAMMAS, main(*sys.argv[1:2]), strict=True):
        print(f"gamma = {gamma:.2f}: " + ", ".join(f"{S:.7f} +- {error:.0e}" for S, error in row))
