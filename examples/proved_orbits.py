"""Orbits of random chains proved to exist, and by the proofs the true errors of what was computed.

Run: python examples/proved_orbits.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from casadi_skin import Chain, follow_family, style


@style()
def main(picture: Path | str | None = None, chains: int = 200) -> NDArray[np.float64]:
    """Relative: estimated error of Omega, its proved bound, the width of the enclosure; shape (proved orbits, 3)."""
    generator, rows = np.random.default_rng(0), []
    for _ in range(chains):
        sites = int(generator.integers(1, 41))
        chain = Chain(sites, generator.uniform(0.0, 3.0), generator.uniform(-0.9, 0.9), generator.choice([-1.0, 1.0]))
        mode, S, digits = int(generator.integers(1, sites + 1)), generator.uniform(0.05, 4.0), generator.uniform(3, 11)
        orbit = follow_family(chain, mode=mode, amplitude_max=S, tolerance=10.0**-digits, max_points=60).orbits[-1]
        certificate = orbit.certify()
        if certificate.proved:
            lower, upper = certificate.Omega
            rows.append(np.array([orbit.Omega_error, certificate.Omega_error, upper - lower]) / orbit.Omega)
        else:
            print(f"{chain}, mode {mode}, S = {orbit.S:.6g}: {certificate}")
    found = np.array(rows)
    if picture is not None:
        draw(found).savefig(picture, dpi=120)
    return found


def draw(found: NDArray[np.float64]) -> Figure:
    """Estimated errors against proved bounds of the true ones."""
    figure = Figure(figsize=(6.4, 4.6), layout="constrained")
    axes = figure.subplots()
    ends = np.array([1e-17, 1e-2])
    axes.fill_between(ends, 1e-20, ends, color="0.92", lw=0)
    axes.plot(ends, ends, color="black", lw=0.8, label="estimate = true error")
    axes.plot(found[:, 1], found[:, 0], "o", ms=4, mfc="none", color="tab:blue", label="orbits, one a chain")
    axes.axvline(np.median(found[:, 2]), color="tab:red", lw=1, ls="--", label="width of the enclosures in doubles")
    axes.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
    axes.set(xlabel=r"proved bound of the true error of $\Omega$, relative", ylabel="estimated error, relative")
    axes.legend(loc="lower right", fontsize="small")  # where no orbit is
    return figure


if __name__ == "__main__":
    errors = main(*sys.argv[1:2])
    print(f"{len(errors)} orbits proved; estimates below the true error: {np.sum(errors[:, 0] < errors[:, 1])}")
