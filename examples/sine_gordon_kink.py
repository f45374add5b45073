"""A kink of a nonreciprocal sine-Gordon chain with free ends, and the family of its internal mode.

Run: python examples/sine_gordon_kink.py PICTURE.png
"""

import sys

import numpy as np

from casadi_skin import Bond, Lattice, Site, find_equilibrium, follow_family, style

sites = 14
bond = Bond("a", "a", (1,), "k*d", ("1 - gamma", "1 + gamma"))
lattice = Lattice(sites, [Site("a", "sin(y)")], [bond], "free", {"k": 0.4, "gamma": 0.02})


@style()
def main(picture=None):
    """The kink, a rest state other than 0, and the families of its two lowest modes."""
    guess = 4.0 * np.arctan(np.exp((np.arange(sites) - (sites - 1) / 2) / np.sqrt(0.4)))
    kink = find_equilibrium(lattice, guess)
    about = kink.centred_model()  # displacements from the kink
    families = [follow_family(about, mode, 0.3, at=(0.1,), tolerance=1e-9) for mode in (1, 2)]
    for name, family in zip(("translation", "internal mode"), families, strict=True):
        orbit = family.at(S=0.1)
        print(f"{name}: Omega = {orbit.Omega:.12f} at S = 0.1, {'stable' if orbit.floquet().stable else 'unstable'}")
    if picture:
        draw(picture, kink, families)
    return kink, families


def draw(picture, kink, families):
    """The kink with the largest orbit about it, and frequencies against S."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    n, orbit = np.arange(1, sites + 1), families[1].orbits[-1]
    left.plot(n, kink.positions, "k.-", lw=0.8, label="kink")
    left.plot(n, kink.positions + orbit.profile, "-", lw=0.8, color="tab:red", label="internal mode, $S = 0.3$")
    left.set(
        xlabel="site",
        xticks=range(2, 15, 4),
        ylabel="angle",
        yticks=[0, np.pi, 2 * np.pi],
        yticklabels=["0", r"$\pi$", r"$2\pi$"],
    )
    left.legend(frameon=False)
    for family, colour, name in zip(families, ("k", "tab:red"), ("translation", "internal mode"), strict=True):
        right.plot(family.S, family.Omega / family.orbits[0].Omega, "-", color=colour, lw=1.0, label=name)
    right.set(xlabel="$S$", ylabel=r"$\Omega / \omega$")
    right.legend(frameon=False)
    figure.savefig(picture, dpi=100)


if __name__ == "__main__":
    main(*sys.argv[1:2])
