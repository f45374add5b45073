"""The continuous spectrum of an orbit at the edge of an infinite linear medium: arcs of the unit circle in closed form.

Far from the edge perturbations are waves exp(i omega t) of the linear bands, whatever the orbit does: their multipliers
over the period T are exp(+-i omega T), those of the two signs of opposite Krein signature (Marin and Aubry 1998). In
mu, lambda(M) + 1/lambda(M) = 2 + 4 mu with M the map over T/power, they are -sin^2(theta), theta = omega T/(2 power).
Where theta passes a multiple of pi/2 the band is folded, and arcs of opposite signature overlap: two waves resonate
with the orbit, omega + omega' = power m Omega.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.zero.problem import Array

HALF_TURN = np.pi
TOUCHING = 1e-12  # length of an overlap of arcs that only meet, as where the orbit is pinned to its band


@dataclass(frozen=True)
class Overlap:
    """Arcs of opposite signature that overlap: waves of two bands with omega + omega' = power `order` Omega.

    `bands` are their numbers from 0; `mu` is the interval in which both lie, `angles` the one of omega T that waves of
    the first band have there.
    """

    bands: tuple[int, int]
    order: int
    mu: tuple[float, float]
    angles: tuple[float, float]


@dataclass(frozen=True)
class ContinuousSpectrum:
    """Multipliers of the waves of linear bands, for an orbit of frequency Omega.

    Attributes:
        Omega: frequency of the orbit.
        bands: lowest and highest frequency of each band.
        power: of the map M whose multipliers to this power are those over the period: 2 or 1.
    """

    Omega: float
    bands: tuple[tuple[float, float], ...]
    power: int

    @property
    def arcs(self) -> Array:
        """Angles omega T between which the multipliers of each band lie, not reduced to a turn, shape (bands, 2).

        The multipliers of opposite signature have the opposite angles.
        """
        return 2.0 * np.pi * np.asarray(self.bands, dtype=float).reshape(-1, 2) / self.Omega

    @property
    def mu(self) -> Array:
        """Intervals of mu, shape (bands, 2)."""
        return np.array([_interval(low, high) for low, high in self._phases]).reshape(-1, 2)

    @property
    def _phases(self) -> Array:
        return self.arcs / (2.0 * self.power)

    @property
    def overlaps(self) -> tuple[Overlap, ...]:
        """Where arcs of opposite signature overlap, in order of bands and of the resonance."""
        found, phases = [], self._phases
        for a in range(len(phases)):
            for b in range(a, len(phases)):
                (low, high), (other_low, other_high) = phases[a], phases[b]
                first, last = np.ceil((low + other_low) / HALF_TURN), np.floor((high + other_high) / HALF_TURN)
                for order in range(int(first), int(last) + 1):
                    start = max(low, order * HALF_TURN - other_high)
                    end = min(high, order * HALF_TURN - other_low)
                    if end - start <= TOUCHING:
                        continue
                    mu = _interval(start, end)
                    angles = (2.0 * self.power * float(start), 2.0 * self.power * float(end))
                    found.append(Overlap((a, b), order, mu, angles))
        return tuple(found)

    def distance(self, mu: Array) -> Array:
        """Distances of values of mu from those of the bands, of the shape of `mu`."""
        nearest = np.full(np.shape(mu), np.inf)
        for low, high in self.mu:
            nearest = np.minimum(nearest, np.abs(mu - np.clip(np.real(mu), low, high)))
        return nearest


def _interval(low: float, high: float) -> tuple[float, float]:
    """Smallest and largest -sin^2 between two phases."""
    ends = -(np.sin([low, high]) ** 2)
    turns = np.arange(np.ceil(2.0 * low / np.pi), np.floor(2.0 * high / np.pi) + 1.0)
    between = np.where(turns % 2.0 == 0.0, 0.0, -1.0)
    values = np.concatenate([ends, between])
    return float(np.min(values)), float(np.max(values))
