"""A chain of 1000 sites: profiles that stay right far below round-off of their largest displacement.

Run: python examples/thousand_sites.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, Orbit, follow_family, style


@style()
def main(picture: Path | str | None = None) -> tuple[Orbit, Orbit]:
    """The orbits S = 0.2 and S = 1 of the highest family, j = 1000, of a hardening chain."""
    chain = Chain(sites=1000, alpha=1.0, gamma=0.25, g=1.0)
    branch = follow_family(chain, mode=1000, amplitude_max=1.0, at=(0.2, 1.0), tolerance=1e-9, corrector="newton")
    extended, breather = branch.at(S=0.2), branch.at(S=1.0)
    if picture is not None:
        draw(extended, breather).savefig(picture, dpi=130)
    return extended, breather


def linear_tail(orbit: Orbit) -> np.ndarray:
    """Fundamental left of the breather in closed form, shape (site,), scaled to end at 1.

    There y_n is so small that the sites are linear: y_n = rho_n sinh(n kappa) (-1)^n with 2 s cosh(kappa) =
    Omega^2 - 2 - alpha, above the band.
    """
    chain, n = orbit.model, np.arange(1, orbit.model.sites + 1)
    kappa = np.arccosh((orbit.Omega**2 - 2.0 - chain.alpha) / (2.0 * chain.coupling))
    growth = kappa * (n - n[-1]) + np.log1p(-np.exp(-2.0 * kappa * n))
    return np.exp(chain.log_rho + growth)


def draw(extended: Orbit, breather: Orbit) -> Figure:
    """Sizes of the displacements at all sites on the left; the favoured edge as it is on the right."""
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    whole, edge = figure.subplots(1, 2, width_ratios=(1.4, 1))
    n = np.arange(1, 1001)
    for orbit, colour, marker, name in (
        (extended, "tab:blue", "o", "skin mode"),
        (breather, "black", "s", "end breather"),
    ):
        label = f"$S = {orbit.S:g}$: {name}"
        whole.plot(n, np.abs(orbit.coefficients(16)[0]), color=colour, lw=1.5, label=label)
        edge.plot(n[-24:], orbit.profile[-24:] / np.sqrt(orbit.S), marker, ls="-", color=colour, ms=4, lw=0.8,
                  mfc="none", label=label)  # fmt: skip
    tail, site = linear_tail(breather), 900
    whole.plot(n[49::50], tail[49::50] * np.abs(breather.coefficients(16)[0, site - 1]) / tail[site - 1], "x",
               color="tab:red", ms=5, label="closed form of the linear tail")  # fmt: skip
    whole.axhline(2.2e-16, color="0.6", lw=0.8, ls=":", label="round-off of a displacement of 1")
    whole.set(yscale="log", xlabel="site $n$", ylabel="size of the fundamental harmonic", xlim=(1, 1000))
    whole.set_yticks(10.0 ** np.arange(-180, 1, 30))
    whole.legend(fontsize="small", loc="lower right")
    edge.axhline(0, color="0.6", lw=0.6)
    edge.set(xlabel="site $n$", ylabel=r"$y_n(0)\,/\,\Vert y\Vert$", title="the last 24 sites")
    edge.legend(fontsize="small", loc="lower left")
    return figure


if __name__ == "__main__":
    for found in main(*sys.argv[1:2]):
        print(f"S = {found.S:g}: Omega = {found.Omega:.12f}, smallest displacement {np.abs(found.profile).min():.1e}")
