"""Kicks followed by CVODES, independently of the search that found them: whether they escape, and at which size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from casadi_skin.dynamics import EvolutionError, distance_from_orbit, evolve
from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.closed_forms import Array
from casadi_skin.optimise.kick_nlp import KickedFlow
from casadi_skin.optimise.optimum import CosineOrbit

SAMPLES_PER_PERIOD = 64  # a period; the largest distance is that of the parabola through the three largest
FINER_SAMPLES = 17  # samples around the largest
NARROWEST_BRACKET = 1e-9  # of the bracket of a size, relative to it


@dataclass(frozen=True, eq=False)
class Escape:
    """Distance from the orbit against time, each (times,), as `dynamics.distance_from_orbit` defines it."""

    t: Array
    distance: Array

    @property
    def farthest(self) -> tuple[float, float]:
        """The largest distance and its time, by a parabola where it lies between samples."""
        k = int(np.argmax(self.distance))
        if 0 < k < len(self.t) - 1:
            a, b, c = np.polyfit(self.t[k - 1 : k + 2] - self.t[k], self.distance[k - 1 : k + 2], 2)
            if a < 0:
                return float(c - b * b / (4 * a)), float(self.t[k] - b / (2 * a))
        return float(self.distance[k]), float(self.t[k])


def escape(orbit: Orbit | CosineOrbit, kick: ArrayLike, t: ArrayLike, tolerance: float = 1e-11) -> Escape:
    """Distance from the orbit after a kick (2N,) of positions and velocities at t = 0, by CVODES.

    Where the state runs to infinity, as with g < 0, up to the last time before.
    """
    z, sites = np.asarray(kick, dtype=float), orbit.model.sites
    try:
        evolution = evolve(orbit.model, orbit.profile + z[:sites], z[sites:], t, tolerance=tolerance)
    except EvolutionError as error:
        if error.evolution is None:
            raise
        evolution = error.evolution
    return Escape(evolution.t, distance_from_orbit(orbit, evolution))


def sampled(orbit: Orbit, time: float) -> Array:
    """Times from 0 to `time`, SAMPLES or more a period."""
    return np.linspace(0.0, time, 1 + max(8, int(np.ceil(SAMPLES_PER_PERIOD * time / orbit.period))))


def farthest(orbit: Orbit, kick: Array, time: float) -> tuple[float, float]:
    """Largest distance up to `time` after a kick (2N,), and its time: sampled, then finer around the largest sample."""
    coarse = escape(orbit, kick, sampled(orbit, time))
    k = int(np.argmax(coarse.distance))
    around = coarse.t[max(0, k - 1)], coarse.t[min(k + 1, len(coarse.t) - 1)]
    fine = escape(orbit, kick, np.linspace(*around, FINER_SAMPLES))
    return max(
        coarse.farthest if len(fine.t) < FINER_SAMPLES else fine.farthest, (float(coarse.distance[k]), coarse.t[k])
    )


def size_to_escape(orbit: Orbit, direction: Array, time: float, distance: float) -> tuple[float, float]:
    """Smallest size of a kick along `direction` (2N,) that escapes, and its time of escape: bisection on CVODES runs.

    The bracket comes from a scan of sizes around that of linear growth. Raises ArithmeticError where none escapes.
    """
    flow = KickedFlow.up_to(orbit, time)
    in_gauge = direction / (np.sqrt(orbit.S) * np.tile(orbit.model.rho, 2))
    near = distance / float(flow.linear_gains(in_gauge[:, None])[1].max())
    found = flow.first_to_escape(in_gauge, distance, near)
    if found is None:
        raise ArithmeticError(f"size_to_escape: no size up to {1000 * near:.3g} comes to the distance {distance:g}")

    def excess(size: float) -> float:
        return farthest(orbit, size * direction, time)[0] - distance

    low, high = 0.95 * found[0], found[0]
    while excess(high) < 0:  # the scan had fewer samples in time
        low, high = high, 1.02 * high
    while excess(low) >= 0:
        low, high = 0.9 * low, low
    size = float(brentq(excess, low, high, xtol=NARROWEST_BRACKET * high, rtol=NARROWEST_BRACKET))
    return size, farthest(orbit, size * direction, time)[1]
