"""Where stability changes between two orbits of a family, by bisection on corrected orbits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.continuation.locating import Locator
from casadi_skin.families.orbit import Orbit

WIDTH = 1e-6  # of the bracket in S, or in S relative to the family's largest where that is below 1


@dataclass(frozen=True)
class StabilityChange:
    """A change of stability at S, with the bracket's width in S.

    `kind` is that of the instability on the unstable side, "real" or "complex"; `mu` is where on the mu axis it is
    born: -1 (where the energy has an extremum along the family) or 0 for a real one, the collision for a complex one.
    """

    S: float
    Omega: float
    kind: str
    stable_before: bool
    stable_after: bool
    mu: float
    S_width: float


def locate_change(locator: Locator, before: Orbit, after: Orbit) -> StabilityChange:
    """Bisect the stretch of branch between two neighbouring orbits of different stability.

    Where the corrector fails inside the bracket the change is given with the bracket reached (`S_width`). Raises
    FlowError from the flow map.
    """
    width = WIDTH * min(1.0, before.tools.request.amplitude_max)
    first, last, low, high = before, after, 0.0, 1.0
    while abs(last.S - first.S) > width and high - low > 1e-14:
        middle = 0.5 * (low + high)
        point = locator.along(before.point, after.point, middle)
        if point is None:
            break
        orbit = Orbit(before.tools, point)
        if orbit.floquet().stable == before.floquet().stable:
            first, low = orbit, middle
        else:
            last, high = orbit, middle
    unstable = (last if first.floquet().stable else first).floquet()
    outside = np.flatnonzero(~unstable.is_inside)
    real = outside[unstable.is_real[outside]]
    chosen = real if real.size else outside
    mu = unstable.mu[chosen[np.argmax(np.abs(unstable.mu[chosen] + 0.5))]]
    return StabilityChange(
        S=0.5 * (first.S + last.S),
        Omega=0.5 * (first.Omega + last.Omega),
        kind="real" if real.size else "complex",
        stable_before=before.floquet().stable,
        stable_after=after.floquet().stable,
        mu=float(mu.real),
        S_width=abs(last.S - first.S),
    )
