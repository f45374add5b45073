"""All changes of localised multipliers of the softening breather at the edge of an infinite chain, among its waves.

Run: python examples/localised_changes.py PICTURE.png
"""

import math
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Branch, Chain, follow_family, style

MARKS = {"real": ("o", 9), "band edge": ("^", 7), "complex": ("s", 13)}  # the last two are 2e-4 in S apart


@style()
def main(picture: Path | str | None = None) -> Branch:
    """The family from the linear mode to S = 3; drawn where a file is named."""
    branch = follow_family(Chain(math.inf, 1.0, 0.25, -1.0), "first", 3.0, stability=True, tolerance=1e-9)
    if picture is not None:
        draw(branch).savefig(picture, dpi=150)
    return branch


def draw(branch: Branch) -> Figure:
    """Angles over half a period against S: waves by their signature, localised multipliers, and their changes."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    S, angle = np.linspace(branch.S[0], branch.S[-1], 1201), np.linspace(0.0, np.pi, 801)[:, None]
    omega = np.interp(S, branch.S, branch.Omega) * (angle + 2.0 * np.pi * np.arange(-3, 4)[:, None, None]) / np.pi
    low, high = np.sqrt(branch.space.model.band())
    waves = [np.any((sign * omega > low) & (sign * omega < high), axis=0) for sign in (1, -1)]
    colours = ["white", "#d9e6f2", "#f5c9a8", "0.6"]  # ever darker
    axes.contourf(S, angle[:, 0], waves[0] + 2.0 * waves[1], [-0.5, 0.5, 1.5, 2.5, 3.5], colors=colours)
    for orbit in branch.orbits:
        mu = orbit.floquet().mu.astype(complex)
        turn = np.abs(np.angle(1.0 + 2.0 * mu + 2.0 * np.sqrt(mu * (mu + 1.0))))
        axes.plot(np.full(mu.size, orbit.S), turn, "k.", ms=3)
    for change in branch.localised_diagram.all:
        mark, size = MARKS[change.kind]
        axes.plot(change.S, change.angle, "k" + mark, mfc="none", ms=size, clip_on=False, zorder=5)
    for kind, (mark, size) in MARKS.items():
        axes.plot([], [], "k" + mark, mfc="none", ms=size, label=kind)
    axes.plot([], [], "k.", ms=3, label="localised multiplier")
    for colour, words in zip(
        colours[1:], ("waves, signature $+$", "waves, signature $-$", "waves of both"), strict=True
    ):
        axes.fill([], [], color=colour, label=words)
    axes.set(
        xlabel=r"total amplitude $S$", ylabel=r"angle of $\lambda$ over half a period", xlim=(0, 3), ylim=(0, np.pi)
    )
    axes.set_title(r"$N = \infty,\ \alpha = 1,\ \gamma = 0.25,\ g = -1$ (dimensionless)")
    axes.set_yticks([0, np.pi / 2, np.pi], ["0", r"$\pi/2$", r"$\pi$"])
    figure.legend(loc="outside lower center", ncols=3)
    return figure


if __name__ == "__main__":
    for change in main(*sys.argv[1:2]).localised_diagram.all:
        print(f"S = {change.S:.13f} +- {change.S_error:.0e}: {change.kind}")
