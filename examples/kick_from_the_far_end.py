"""Why a stable orbit is kicked out from the far end: transient growth in physical coordinates.

Run: python examples/kick_from_the_far_end.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, Orbit, TransientGrowth, follow_family, style

SITES = 24


def unit_displacement(site: int) -> np.ndarray:
    """A displacement of one site, counted from 1, as (positions, velocities)."""
    kick = np.zeros(2 * SITES)
    kick[site - 1] = 1.0
    return kick


@style()
def main(picture: Path | str | None = None) -> tuple[Orbit, TransientGrowth]:
    """The stable orbit j = 1, g = -1, S = 0.2 and the growth of its perturbations over ten periods."""
    chain = Chain(SITES, alpha=1.0, gamma=0.25, g=-1.0)
    orbit = follow_family(chain, mode=1, amplitude_max=0.2, at=(0.2,), tolerance=1e-10).at(S=0.2)
    growth = orbit.transient_growth(quarters=40)
    if picture is not None:
        draw(orbit, growth).savefig(picture, dpi=130)
    return orbit, growth


def draw(orbit: Orbit, growth: TransientGrowth) -> Figure:
    """Amplification against time on the left, the optimal perturbation and its response on the right."""
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    gains, shapes = figure.subplots(1, 2, width_ratios=(1.3, 1))
    periods = growth.t / orbit.period
    gains.plot(periods, growth.log10_bounded, "k-", lw=2, label="largest of all perturbations, trivial pair left out")
    gains.plot(periods, growth.of(unit_displacement(1)), "s-", color="tab:red", ms=3, lw=0.8, label="kick at site 1")
    gains.plot(periods, growth.of(unit_displacement(SITES)), "o-", color="tab:blue", ms=3, lw=0.8,
               label=f"kick at site {SITES}")  # fmt: skip
    condition = -orbit.model.log_rho.min() / np.log(10)
    gains.axhline(condition, color="0.5", ls=":", label=r"$r^{(N-1)/2}$: spread of the skin envelope")
    gains.set(xlabel="time in periods", ylabel=r"$\log_{10}$ of the amplification", xlim=(0, 10), ylim=(-1.4, 4.4))
    gains.legend(fontsize="small", loc="upper left")

    sites = np.arange(1, SITES + 1)
    for vector, look, label in (
        (growth.optimal, "k-^", "optimal perturbation"),
        (growth.response, "r--v", "what becomes of it"),
    ):
        size = np.hypot(vector[:SITES], vector[SITES:])
        shapes.plot(sites, size, look, ms=4, mfc="none", label=label)
    shapes.set(xlabel="site $n$", ylabel=r"$(z_n^2 + \dot z_n^2)^{1/2}$", xlim=(0.5, 24.5))
    shapes.legend(fontsize="small", loc="upper center")
    return figure


if __name__ == "__main__":
    _, found = main(*sys.argv[1:2])
    print(f"largest amplification: {10 ** found.log10_bounded.max():.1f}")
    for place in (1, SITES):
        print(f"of a kick at site {place}: {10 ** found.of(unit_displacement(place)).max():.2f}")
