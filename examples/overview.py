"""Four things in one picture: a family of the chain, a breather of a plane, a bifurcation diagram, a stability chart.

Run: python examples/overview.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Bond, Branch, Chain, Lattice, OdeModel, Site, find_equilibrium, follow_family, style

GAMMAS = np.linspace(0.1, 0.6, 26)
AMPLITUDES = np.linspace(0.01, 1.0, 60)


@style()
def main(picture: Path | str | None = None, gammas: np.ndarray = GAMMAS):
    """The family, the breather, branches of the diagram, and largest multipliers, shape (amplitudes, gammas)."""
    softening = follow_family(Chain(24, 1.0, 0.25, -1.0), 1, 3.0, stability=True)
    breather = follow_family(plane(), 1, 4.0).at(S=3.0)
    diagram = lorenz()
    largest = np.array([largest_multipliers(gamma) for gamma in gammas]).T
    if picture is not None:
        draw(softening, breather, diagram, gammas, largest).savefig(picture, dpi=110)
    return softening, breather, diagram, largest


def plane() -> Lattice:
    """Ten by eight softening sites whose bonds push harder to the right and up."""
    gain = ("1 - gamma", "1 + gamma")
    bonds = [Bond("a", "a", offset, "d", gain) for offset in ((1, 0), (0, 1))]
    return Lattice((10, 8), [Site("a", "y + g*y^3")], bonds, "fixed", {"gamma": 0.5, "g": -1.0})


def lorenz() -> list[Branch]:
    """Rest, one of the two wings that leave it, and the cycles of that wing's Hopf point up to their homoclinic end."""
    x, y, z, r = (ca.SX.sym(name) for name in "xyzr")
    model = OdeModel("Lorenz", [x, y, z], [10 * (y - x), r * x - y - x * z, x * y - 8 / 3 * z], r)
    rest = find_equilibrium(model, [0, 0, 0], parameters={"r": 0.0}).follow("r", 30.0)
    wing = rest.special_points[0].follow("r", 30.0, side=-1)
    return [rest, wing, wing.special_points[0].follow("r", 10.0, stability=True)]


def largest_multipliers(gamma: float) -> np.ndarray:
    """Of the lowest family of 16 softening sites at each amplitude."""
    stability = follow_family(Chain(16, 0.5, gamma, -1.0), 1, 1.0, stability=True).stability_diagram
    return np.interp(AMPLITUDES, *curve(stability))


def curve(stability) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes and largest multipliers along a family."""
    at = stability.coordinates(400)
    return stability.S(at), stability.max_abs_multiplier(at)


def draw(softening, breather, diagram, gammas, largest) -> Figure:
    """One panel each."""
    figure = Figure(figsize=(7.4, 5.8), layout="constrained")
    (chain, lattice), (ode, chart) = figure.subplots(2, 2)
    softening.plot(chain)
    ends = [0.0, *(change.S for change in softening.changes), 3.0]
    bars = [(a, b - a) for a, b in zip(ends[1::2], ends[2::2], strict=False)]
    chain.broken_barh(bars, (0.0, 0.03), fc="0.25", transform=chain.get_xaxis_transform())
    chain.set(title=f"(a) skin mode of a chain: {len(softening.changes)} changes of stability", xlim=(0.0, 3.0))
    sizes = np.log10(np.abs(breather.profile.reshape(10, 8).T))
    image = lattice.imshow(sizes, cmap="viridis", origin="lower", extent=(0.5, 10.5, 0.5, 8.5))
    figure.colorbar(image, ax=lattice, label=r"$\log_{10}|y(0)|$")
    lattice.set(title="(b) breather at a corner of a plane lattice", xlabel="cell $n$", ylabel="cell $m$")
    for branch in diagram:
        branch.plot(ode, y="z")
    ode.set(title="(c) Lorenz: equilibria, cycles, a homoclinic end", ylim=(-2.0, 54.0))
    ode.get_legend().set_loc("upper left")
    image = chart.pcolormesh(gammas, AMPLITUDES, np.log10(np.maximum(largest, 1.0)), cmap="cividis", shading="nearest")
    figure.colorbar(image, ax=chart, label=r"$\log_{10}$ largest |multiplier|")
    chart.set(title="(d) where the breather is unstable", xlabel=r"nonreciprocity $\gamma$", ylabel="amplitude $S$")
    return figure


if __name__ == "__main__":
    family, _, found, _ = main(*sys.argv[1:2])
    print(f"{len(family.changes)} changes of stability along the family; special points of the diagram:")
    print(*(point for branch in found for point in branch.special_points), sep="\n")
