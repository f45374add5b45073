"""Responses of two damped and driven oscillators: the curve that a sweep meets, and an isola that it misses.

Run: python examples/isola.py PICTURE.png
"""

import sys

import numpy as np

from casadi_skin import (
    Bond,
    Lattice,
    Site,
    conservative_part,
    energy_balance,
    find_orbit,
    follow_family,
    resonances,
    style,
)

site = Site("a", "y + 0.05*y^3", damping="c*(1 - 2*y^2 + 0.6*y^4)", drive="F*e*cos(omega*t)")
values = {"c": 0.02, "F": 0.0182, "omega": 1.0, "e": [1.0, 0.0]}
lattice = Lattice(2, [site], [Bond("a", "a", (1,), "0.3*d")], "fixed", values)


def curve(branch):
    """Frequencies of the drive and largest displacements of the first oscillator along a branch."""
    peaks = [np.max(np.abs(o.evaluate(np.linspace(0.0, o.period, 129))[:, 0])) for o in branch.orbits]
    return [o.parameters["omega"] for o in branch.orbits], peaks


@style()
def main(picture=None):
    """The crossings of the conservative family, and the curves of responses through the first and the last of them."""
    crossings = resonances(lattice, mode=1, amplitude_max=9.0, frequency="omega", tolerance=1e-8)
    for crossing in crossings:
        print(f"crossing at S = {crossing.S:.6f}, Omega = {crossing.Omega:.6f}")
    first, last = (crossings[k].response(tolerance=1e-6) for k in (0, -1))
    balance = energy_balance(lattice, last)
    print(f"on the isola a period brings {balance.work:.6f}, and damping takes {balance.loss:.6f}")
    sweep = find_orbit(lattice, np.zeros(4), parameters={"omega": 1.0}, tolerance=1e-6).follow("omega", 1.35)
    isola = last.follow("omega", 0.7, max_points=150)
    print(f"the sweep reaches {max(curve(sweep)[1]):.4f}, at omega = {first.parameters['omega']:.4f}")
    print(f"the isola lies at {min(curve(isola)[0]):.6f} < omega < {max(curve(isola)[0]):.6f}")
    if picture:
        draw(picture, sweep, isola, crossings)
    return crossings, sweep, isola


def draw(picture, sweep, isola, crossings):
    """Both curves with the conservative family."""
    from matplotlib.figure import Figure

    family = follow_family(conservative_part(lattice), mode=1, amplitude_max=9.0, tolerance=1e-8)
    figure = Figure(figsize=(5.0, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(*curve(sweep), "k-", lw=1.2, label="sweep")
    axes.plot(*curve(isola), "-", lw=1.2, color="tab:red", label="isola")
    axes.plot(
        [o.Omega for o in family.orbits], [o.profile[0] for o in family.orbits], "k--", lw=0.8, label="conservative"
    )
    axes.plot(
        [c.Omega for c in crossings], [c.orbit.profile[0] for c in crossings], "ko", mfc="white", label="crossings"
    )
    axes.set(
        xlabel=r"frequency of the drive $\omega$", ylabel="largest displacement", xlim=(1.0, 1.35), ylim=(0.0, None)
    )
    axes.legend(frameon=False)
    figure.savefig(picture, dpi=150)


if __name__ == "__main__":
    main(*sys.argv[1:2])
