"""Multipliers and Floquet vectors of an unstable orbit: every vector has a skin profile.

Run: python examples/floquet_vectors.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from casadi_skin import Chain, Orbit, follow_family, style


@style()
def main(picture: Path | str | None = None) -> tuple[Orbit, NDArray[np.complex128], NDArray[np.complex128]]:
    """The orbit j = 1, g = -1, S = 1, its multipliers (2N,) and vectors (2N, 2N), one a column, in the same order."""
    chain = Chain(sites=24, alpha=1.0, gamma=0.25, g=-1.0)
    orbit = follow_family(chain, mode=1, amplitude_max=1.0, tolerance=1e-10).at(S=1.0)
    multipliers, vectors = orbit.floquet().multipliers, orbit.floquet_vectors()
    if picture is not None:
        draw(chain, multipliers, vectors).savefig(picture, dpi=120)
    return orbit, multipliers, vectors


def draw(chain: Chain, multipliers: NDArray[np.complex128], vectors: NDArray[np.complex128]) -> Figure:
    """The complex plane on the left, sizes of the positions of the vectors on the right."""
    figure = Figure(figsize=(7.2, 3.5), layout="constrained")
    plane, profiles = figure.subplots(1, 2, width_ratios=(1, 1.35))
    angle, sites = np.linspace(0, 2 * np.pi, 400), np.arange(1, chain.sites + 1)
    unstable = np.abs(np.abs(multipliers) - 1) > 1e-8
    plane.plot(np.cos(angle), np.sin(angle), color="0.7", lw=0.8)
    for chosen, marker, colour in ((~unstable, "o", "black"), (unstable, "s", "tab:red")):
        plane.plot(multipliers[chosen].real, multipliers[chosen].imag, marker, color=colour, mfc="none", ms=5)
    plane.set(aspect="equal", xlabel=r"Re $\lambda$", ylabel=r"Im $\lambda$", title="Floquet multipliers")

    positions = vectors[: chain.sites].copy()
    positions[:, 0] = vectors[chain.sites :, 0]  # the velocity of the flow has no positions at t = 0
    sizes = np.abs(positions) / np.linalg.norm(positions, axis=0)
    for column in np.flatnonzero(~unstable):
        label = "on the unit circle" if column == 0 else None
        profiles.plot(sites, sizes[:, column], color="0.6", lw=0.7, label=label)
    for column, look in zip(np.flatnonzero(unstable), ("-s", "--D"), strict=True):
        label = rf"$\lambda = {multipliers[column].real:.6f}$"
        profiles.plot(sites, sizes[:, column], look, color="tab:red", mfc="none", ms=4, label=label)
    profiles.plot(sites, chain.rho / np.linalg.norm(chain.rho), "k:", lw=2, label=r"$r^{n/2}$")
    profiles.set(yscale="log", xlim=(0.5, 24.5), ylim=(1e-5, 2), xlabel="site $n$", ylabel=r"$|x_n|\,/\,\Vert x\Vert$")
    profiles.set_title("Positions of the Floquet vectors")
    profiles.legend(fontsize="small", loc="lower right")
    return figure


if __name__ == "__main__":
    _, found, _ = main(*sys.argv[1:2])
    print(f"largest |multiplier|: {np.abs(found).max():.10f}")
