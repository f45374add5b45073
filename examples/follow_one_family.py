"""Follow the softening end breather and show frequency and energy against amplitude, with stability.

Run: python examples/follow_one_family.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Branch, Chain, follow_family, style


@style()
def main(picture: Path | str | None = None) -> Branch:
    """The family j = 1 of a softening chain up to S = 3, with orbits at every 0.05; drawn where a file is named."""
    chain = Chain(sites=24, alpha=1.0, gamma=0.25, g=-1.0)
    wanted = np.linspace(0.05, 3.0, 60).round(2)
    branch = follow_family(chain, mode=1, amplitude_max=3.0, at=wanted, stability=True, tolerance=1e-9)
    if picture is not None:
        draw(branch).savefig(picture, dpi=150)
    return branch


def unstable_intervals(branch: Branch) -> list[tuple[float, float]]:
    """Where the orbits are unstable: it begins stable."""
    ends = [change.S for change in branch.changes]
    return list(zip(ends[::2], [*ends[1::2], float(branch.S[-1])], strict=False))


def draw(branch: Branch) -> Figure:
    """Omega(S) above, the energy below; unstable intervals are grey."""
    figure = Figure(figsize=(6.4, 5.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    omega, first_change = branch.space.model.linear_frequency(1), branch.at(S=branch.changes[0].S)
    above.plot([0, *branch.S], [omega, *branch.Omega], "k-", marker="o", ms=2.5, label="orbits")
    below.plot([0, *branch.S], [0, *branch.energy], "k-", marker="o", ms=2.5)
    below.plot(
        first_change.S, first_change.energy, "v", color="tab:red", ms=9, mfc="none", label="first change of stability"
    )
    for axes in (above, below):
        for k, (first, last) in enumerate(unstable_intervals(branch)):
            axes.axvspan(first, last, color="0.85", lw=0, label="unstable" if axes is above and k == 0 else None)
    above.set(ylabel=r"frequency $\Omega$", title=r"$N = 24,\ \alpha = 1,\ \gamma = 0.25,\ g = -1,\ j = 1$")
    below.set(xlabel=r"total amplitude $S$", ylabel="energy $H$", xlim=(0, 3), ylim=(0, 4.4))
    figure.legend(loc="outside lower center", ncols=3)
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    for change in found.changes:
        print(f"S = {change.S:.6f}: {change.kind} instability {'ends' if change.stable_after else 'begins'}")
