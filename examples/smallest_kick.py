"""The smallest kick that takes a linearly stable breather away within the time that the paper's figure 6 shows.

Run: python examples/smallest_kick.py PICTURE.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, SmallestKick, follow_family, smallest_kick, style

SITES, TIME = 24, 40.0


@style()
def main(picture: Path | str | None = None, starts: int = 4) -> SmallestKick:
    """The kick of the stable orbit j = 1, g = -1, S = 0.2 after which it is half its own size away from itself."""
    chain = Chain(SITES, alpha=1.0, gamma=0.25, g=-1.0)
    orbit = follow_family(chain, mode=1, amplitude_max=0.2, at=(0.2,), tolerance=1e-10).at(S=0.2)
    kick = smallest_kick(orbit, time=TIME, distance=0.5, starts=starts)
    if picture is not None:
        draw(kick).savefig(picture, dpi=130)
    return kick


def draw(kick: SmallestKick) -> Figure:
    """The kick at each site on the left, the distance against time after it and others on the right."""
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    profile, distances = figure.subplots(1, 2, width_ratios=(1, 1.3))
    sites = np.arange(1, SITES + 1)
    profile.axhline(0.0, color="0.7", lw=0.8)
    profile.plot(sites, 1e3 * kick.displacements, "k-o", ms=4, label="displacements")
    profile.plot(sites, 1e3 * kick.velocities, "--s", color="tab:red", ms=4, mfc="none", label="velocities")
    profile.set(
        xlabel="site $n$", ylabel=r"smallest kick $\times\,10^3$", xlim=(0.5, SITES + 0.5), xticks=(1, 6, 12, 18, 24)
    )
    profile.legend(fontsize="small")

    alone = kick.far_end_kick * kick.norm / kick.far_end_norm
    for z, look, label in (
        (kick.best.kick, "k-", f"smallest kick, norm {kick.norm:.2e}"),
        (alone, "r--", f"site 1 displaced by {kick.norm:.2e}"),
        (kick.far_end_kick, "r:", f"site 1 displaced by {kick.far_end_norm:.2e}"),
    ):
        run = kick.evolution(z)
        distances.plot(run.t, run.distance, look, lw=1.3, label=label)
    distances.axhline(kick.distance, color="0.5", lw=0.8)
    distances.set(xlabel="time $t$", ylabel="distance from the breather / its size", xlim=(0, TIME), ylim=(0, 0.75))
    distances.legend(fontsize="small", loc="upper left")
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    print(found.status)
    print(f"norm: {found.norm:.6e}; by linear growth {found.linear_norm:.6e}; site 1 alone {found.far_end_norm:.6e}")
