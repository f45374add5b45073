"""Localisation against robustness: the Pareto front of participation ratio and amplification of a far kick.

Run: python examples/design_pareto.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, ParetoFront, follow_family, pareto_front, style

CHAIN = Chain(sites=24, alpha=1.0, gamma=0.4, g=1.0)
BOUNDS = {"gamma": (0.05, 0.8), "alpha": (0.5, 2.0)}


@style()
def main(picture: Path | str | None = None, points: int = 8) -> ParetoFront:
    """Least participation ratio at S = 1 against least log r^((N-1)/2), over gamma and alpha."""
    orbit = follow_family(CHAIN, "last", 1.0).orbits[-1]
    front = pareto_front(
        "participation", "log_amplification", of=orbit, over=("gamma", "alpha"), bounds=BOUNDS, points=points, starts=2
    )
    if picture is not None:
        draw(front).savefig(picture, dpi=150)
    return front


def draw(front: ParetoFront) -> Figure:
    """The front, with gamma and alpha along it."""
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    decades = front.values[:, 1] / np.log(10.0)
    left.plot(decades, front.values[:, 0], "ko-", ms=4, lw=0.8)
    left.set(xlabel=r"$\log_{10}$ of the amplification $r^{(N-1)/2}$", ylabel="participation ratio (sites)")
    right.plot(decades, [design["gamma"] for design in front.points], "ko-", ms=4, lw=0.8, label=r"$\gamma$")
    right.plot(decades, [design["alpha"] for design in front.points], "s--", color="tab:blue", ms=4, lw=0.8,
               mfc="none", label=r"$\alpha$")  # fmt: skip
    right.set(xlabel=r"$\log_{10}$ of the amplification $r^{(N-1)/2}$", ylabel="parameters along the front")
    right.legend()
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    for (participation, amplification), design in zip(found.values, found.points, strict=True):
        parameters = f"gamma = {design['gamma']:.5f}, alpha = {design['alpha']:.5f}"
        print(f"participation {participation:.6f}, log amplification {amplification:.5f}: {parameters}")
