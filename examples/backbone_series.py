"""The softening end breather as a power series in S: its sums over the followed family, and where they stop converging.

Run: python examples/backbone_series.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Branch, Chain, FamilySeries, follow_family, style

ORDERS = (1, 2, 5, 10, 20, 40)


@style()
def main(picture: Path | str | None = None) -> tuple[Branch, FamilySeries]:
    """The family j = 1 of a softening chain up to S = 1.25, and its series to order 40; drawn where a file is named."""
    chain = Chain(sites=24, alpha=1.0, gamma=0.25, g=-1.0)
    branch = follow_family(chain, mode=1, amplitude_max=1.25, at=np.linspace(0.025, 1.25, 50).round(3), tolerance=1e-12)
    series = branch.series(max(ORDERS))
    if picture is not None:
        draw(branch, series).savefig(picture, dpi=150)
    return branch, series


def draw(branch: Branch, series: FamilySeries) -> Figure:
    """Omega(S) above; below how far sums are from it."""
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    S, Omega = branch.S, branch.Omega
    above.plot(S, Omega, color="0.75", lw=5, label="followed family")
    for k, order in enumerate(ORDERS):
        colour = f"C{k}"
        above.plot(S, series.frequency(S, order), color=colour, lw=1, label=f"order {order}")
        below.semilogy(S, np.abs(series.frequency(S, order) - Omega), color=colour, lw=1)
    below.semilogy(S, series.frequency_error(S), "k:", lw=1.2, label=f"estimated error of order {series.order}")
    for axes in (above, below):
        axes.axvspan(series.radius - series.radius_error, series.radius + series.radius_error, fc="0.9")
        axes.axvline(
            series.radius, color="0.4", ls="--", lw=0.8, label="radius of convergence" if axes is above else None
        )
    above.set(ylabel=r"frequency $\Omega$", title=r"$N = 24,\ \alpha = 1,\ \gamma = 0.25,\ g = -1,\ j = 1$")
    above.set_ylim(Omega.min() - 0.002, Omega.max() + 0.002)
    below.set(
        xlabel=r"total amplitude $S$", ylabel=r"$|\Omega_\mathrm{sum} - \Omega|$", xlim=(0, 1.25), ylim=(1e-14, 1e0)
    )
    figure.legend(loc="outside lower center", ncols=3)
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])[1]
    for power, (value, error, digits) in enumerate(zip(found.Omega, found.Omega_error, found.digits, strict=True)):
        print(f"S^{power:<3d} {value: .15e} +- {error:.1e} ({digits:.1f} digits)")
    print(f"converges up to S = {found.radius:.6f} +- {found.radius_error:.1e}")
