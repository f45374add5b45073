"""The chain whose first instability is at the largest amplitude, with every tongue taken in that comes before it.

Run: python examples/design_first_instability.py PICTURE.png
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Branch, Chain, Design, follow_family, optimise, style

CHAIN = Chain(sites=4, alpha=1.0, gamma=0.3, g=-1.0)
APART = 1e-3  # of S, by which other tongues stay behind the first: where two edges meet, neither has a gradient


def family(gamma: float) -> Branch:
    """The first mode's family with its changes of stability."""
    return follow_family(replace(CHAIN, gamma=gamma), 1, 2.2, stability=True)


@style()
def main(picture: Path | str | None = None) -> Design:
    """The gamma at which the family is stable up to the largest S: followed at each design, until none comes first."""
    watched = [family(CHAIN.gamma).edge(0)]
    while True:
        names = [f"tongue_{k}" for k in range(len(watched))]
        result = optimise(
            lambda first, *others: first.S,
            of=dict(zip(names, watched, strict=True)),
            over=["gamma"],
            bounds={"gamma": (0.2, 0.5)},
            subject_to=[(f"{name}.S - tongue_0.S", APART, None) for name in names[1:]],
            maximise=True,
        )
        at_design = family(result["gamma"])
        comes_first = result.value - at_design.changes[0].S > APART / 2
        if not comes_first:
            break
        watched.append(at_design.edge(0))
    if picture is not None:
        draw(result).savefig(picture, dpi=150)
    return result


def draw(result: Design) -> Figure:
    """The first change of stability against gamma."""
    figure = Figure(figsize=(5.6, 3.6), layout="constrained")
    axes = figure.subplots()
    gammas = np.sort([*np.linspace(0.2, 0.5, 31), result["gamma"]])
    axes.plot(gammas, [family(gamma).changes[0].S for gamma in gammas], "k.-", lw=1, label="of families")
    axes.plot(result["gamma"], result.value, "o", color="tab:red", mfc="none", ms=9, label="design")
    axes.set(xlabel=r"$\gamma$", ylabel="$S$ of the first instability", title=r"$N = 4,\ j = 1,\ \alpha = 1,\ g = -1$")
    axes.legend()
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    print(f"{found.reason}: gamma = {found['gamma']:.9f}, S = {found.value:.9f}")
