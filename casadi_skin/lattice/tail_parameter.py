"""The unknown u in place of Omega where the tail of a long lattice is eliminated: well resolved at every length.

Where the fundamental or the third harmonic is pinned to an edge of a band, as both are in turn along a softening family
of a leaning lattice, its angle phi changes and Omega does not. So u = phi_1, and u = phi_1 + phi_3 where the third
harmonic comes to a band before the fundamental does: Omega(u) is monotone in gaps and, for a tail of finite length,
smooth and monotone in bands.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property, lru_cache

import numpy as np

from casadi_skin.lattice.tail import FARTHEST_FREQUENCY, ComplexArray, End, Place, Tail
from casadi_skin.zero.problem import Array

KEPT_VALUES = 256  # values that are used again: those of all places of a series at several steps


class Regime(Enum):
    """Regime of the linear tail of a long lattice, in words."""

    PINNED = "the frequency is pinned to the edge of the band"
    BOUND = "the breather is bound to the edge of the lattice"
    THIRD = "three times the frequency is pinned to the band: the third harmonic fills the tail"


@dataclass(frozen=True)
class TailValues:
    """Values at one u of the parameter that the core needs, and derivatives by u.

    Harmonic k = 2 h + 1 is at places[h]; it has the amplitudes across[h] b beyond the bond to the tail and down[h] b
    before it: the sine and the cosine of its angle phi[h]. Harmonic number `resolved` from 0 is known best.
    """

    Omega: float
    Omega_slope: float
    across: Array
    across_slope: Array
    down: Array
    down_slope: Array
    phi: Array
    places: list[Place]
    resolved: int


@dataclass(frozen=True)
class TailParameter:
    """u as a function of Omega, for the family of one linear mode.

    Attributes:
        tail: the tail.
        mode: where the fundamental of the linear mode is.
        harmonics: number of odd harmonics.
        slowest: decay a cell of the fundamental in the gauge below which the core would be too short.
        lean: logarithm by which displacements fall from cell to cell beside the gauge's, away from the core.
    """

    tail: Tail
    mode: Place
    harmonics: int = field(compare=False)
    slowest: float = 0.0
    lean: float = np.inf

    @property
    def coupling(self) -> float:
        """Coupling of neighbouring cells in the gauge."""
        return self.tail.coupling

    # The harmonics that bound Omega -----------------------------------------------------------------------------------

    @cached_property
    def _gaps(self) -> dict[int, int]:
        """Gaps of the fundamental and, where it may be pinned, of the third harmonic."""
        found = {1: self.mode.gap}
        if self.slowest <= 0.0 < self.lean:
            found[3] = self.tail.place(9.0 * self.tail.square(self.mode)).gap
        return found

    @cached_property
    def _ends(self) -> tuple[End | None, ...]:
        """The lower and the upper end; None where no harmonic meets a band."""
        tail, found = self.tail, list[End | None]()
        for side, nearest in ((0, max), (1, min)):
            edges = ((k, tail.sides(gap)[side]) for k, gap in self._gaps.items())
            met = [End(k, edge, tail.angle(edge)) for k, edge in edges if edge is not None]
            found.append(nearest(met, key=lambda end: tail.square(end.edge) / end.harmonic**2, default=None))
        if any(end is not None and end.harmonic == 3 for end in found):
            others = [0.0 if end is None else tail.angle(self._other(end.harmonic, end.edge)) for end in found]
            found = [end and end._replace(angle=end.angle + phi) for end, phi in zip(found, others, strict=True)]
        return tuple(found)

    @cached_property
    def _third(self) -> bool:
        """Whether the third harmonic comes to a band before the fundamental does."""
        return any(end is not None and end.harmonic == 3 for end in self._ends)

    def _other(self, k: int, place: Place) -> Place:
        """Where the other harmonic in u is, 3 or 1; raises ArithmeticError in a band."""
        return self.tail.place(self.tail.square(place) * (9.0 if k == 1 else 1.0 / 9.0))

    def _beside(self, k: int, place: Place) -> float:
        """The part of u that is not the angle of harmonic k."""
        return self.tail.angle(self._other(k, place)) if self._third else 0.0

    def _angle(self, k: int, place: Place) -> float:
        """u where harmonic k is at a place."""
        return self.tail.angle(place) + self._beside(k, place)

    def _resolved(self, u: float) -> tuple[int, Place, float]:
        """The harmonic that resolves Omega at u, where it is and its angle; raises ArithmeticError for none."""
        k, place = self.tail.resolved(self._ends, self._angle, u)
        return k, place, u - self._beside(k, place)

    # Values -----------------------------------------------------------------------------------------------------------

    def at(self, phi: float) -> float:
        """u where the angle of the fundamental is `phi`."""
        return phi + self._beside(1, self.tail.at_angle(self.mode.gap, phi))

    def of_frequency(self, Omega: float) -> float:
        """u where the frequency is `Omega`, bound in the gap; NaN where it is not there."""
        try:
            place = self.tail.place(Omega**2)
            return self._angle(1, place) if place.gap == self.mode.gap else float("nan")
        except ArithmeticError:
            return float("nan")

    def values(self, u: float) -> TailValues:
        """All that the core needs at u; raises ArithmeticError where a harmonic that should be bound is not."""
        return self._kept(u)

    @cached_property
    def _kept(self) -> Callable[[float], TailValues]:
        return lru_cache(KEPT_VALUES)(self._values)

    def _values(self, u: float) -> TailValues:
        (resolved, place, angle), waves = _waves_at(self, u)
        squared, h = self.tail.square(place) / resolved**2, (resolved - 1) // 2
        if not squared > 0.0:
            raise ArithmeticError("the frequency is not real")
        for k in range(2 * len(waves) + 1, 2 * self.harmonics, 2):
            waves.append(self._wave(k, place if k == resolved else self.tail.place(k**2 * squared)))
        places, angles, slopes = zip(*waves[: self.harmonics], strict=True)
        phi, by_square = np.array(angles), np.array(slopes) * (2.0 * np.arange(self.harmonics) + 1.0) ** 2  # by Omega^2
        phi[h] = angle
        apart = [1 - h] if self._third else []
        squared_slope = 0.0 if np.isinf(by_square[h]) else 1.0 / (by_square[h] + np.sum(by_square[apart]))
        by_u = np.where(np.isinf(by_square), 0.0, by_square) * squared_slope
        by_u[h] = 1.0 - np.sum(by_u[apart])
        Omega = math.sqrt(self.tail.square(place)) / resolved
        across, down = np.sin(phi), np.cos(phi)
        slope = squared_slope / (2.0 * Omega)
        return TailValues(Omega, slope, across, down * by_u, down, -across * by_u, phi, list(places), h)

    def _wave(self, k: int, place: Place) -> tuple[Place, float, float]:
        """Where harmonic k is, its angle and its slope by lambda; raises ArithmeticError where it is to be bound."""
        if k == 1 and self.slowest > 0.0 and self.tail.decay(place) < self.slowest:
            raise ArithmeticError("the fundamental decays too slowly for the core")
        if k > 1 and self.lean <= 0.0 and self.tail.decay(place) + self.lean <= 0.0:
            raise ArithmeticError(f"harmonic {k} grows along the lattice")
        return place, *self.tail.angle_and_slope(place)

    def series(self, u: float, orders: int) -> TailSeries:
        """Power series of the same by changes of u; raises ArithmeticError as well where none is found."""
        return series_of(self.tail, self.values(u), 2 if self._third else 1, orders)

    def passed(self, values: TailValues) -> int:
        """Modes of the tail by itself that harmonics lie above, of high harmonics as counted from infinity."""
        last = len(self.tail.edges) - 1
        above_all = Place(last, FARTHEST_FREQUENCY * self.tail.edges[last])
        passed = np.floor(values.phi / np.pi + 0.5)
        passed[max(self._gaps) // 2 + 1 :] -= np.floor(self.tail.angle(above_all) / np.pi + 0.5)
        return int(np.sum(passed))

    def regime(self, values: TailValues) -> Regime:
        """Whether Omega, or three times it, is pinned to a band."""
        for k, regime in ((1, Regime.PINNED), (3, Regime.THIRD)):
            if k in self._gaps and values.places[k // 2].in_band:
                return regime
        return Regime.BOUND


@lru_cache(KEPT_VALUES)
def _waves_at(parameter: TailParameter, u: float) -> tuple[tuple[int, Place, float], list[tuple[Place, float, float]]]:
    """What resolves Omega at u, and all harmonics that any level has asked for: they are the same on all levels."""
    return parameter._resolved(u), []


# Power series, in u, of what the core needs of its tail ---------------------------------------------------------------
#
# All of it is an analytic function of the frequency, in closed form for complex frequencies too. So the coefficients
# are integrals over a circle about the place of one harmonic, by the trapezoidal rule; the same integrals invert u
# (Lagrange's theorem; Lyness and Moler 1967 for derivatives by such sums).

CIRCLE_NODES = 64  # of the circle
CIRCLE_RADIUS_RATIO = 0.5  # of the distance to the next edge of a band that the circle may have
LOBE_CHANGE = 2.0  # of (cells times decay)^2, which waves of the far end change by
CIRCLE_HALVINGS = 40  # of the circle, until no singularity lies within
NEGATIVE_POWER_RATIO = 1e-7  # of the largest coefficient: those of negative powers, which a singularity within has
ENDLESS_CELLS = 8000.0  # cells from which on waves of the far end move Omega by less than the precision of a prediction
BAND_EDGE_RTOL = 1e-8  # of a band's width: how far Omega may leave its edge before a prediction needs it


@dataclass(frozen=True)
class TailSeries:
    """Coefficients by powers of u from its value: of Omega, and by harmonic of the sine and cosine of the angle phi.

    Their shape is (orders + 1, 1 + 2 harmonics). They hold up to u = `end` where that is a number: functions of an
    endless tail are not analytic where a harmonic leaves an edge of a band.
    """

    coefficients: Array
    end: float = np.nan


def series_of(tail: Tail, values: TailValues, in_u: int, orders: int) -> TailSeries:
    """The series about values at a u that is the sum of the first one or two angles.

    Raises ArithmeticError where no circle has no singularity within.
    """
    h, places = values.resolved, values.places
    place, k2 = places[h], np.arange(1.0, 2.0 * len(places), 2.0) ** 2
    if tail.cells >= ENDLESS_CELLS and tail.decay(place) == 0.0:
        return _pinned(tail, values, orders)
    seen = np.array([not tail.end_unseen(one) for one in places])
    sides, offs = (np.array([getattr(one, name) for one in places]) for name in ("side", "off"))
    radius, root = _widest(tail, values, k2, not seen[h]), np.sqrt(abs(place.off))
    for _ in range(CIRCLE_HALVINGS):
        zeta = np.append(0.0, radius * np.exp(2j * np.pi * np.arange(CIRCLE_NODES // 2 + 1) / CIRCLE_NODES))
        squared = (zeta if seen[h] else place.side * zeta * (2.0 * root + zeta)) / k2[h]  # changes of Omega^2
        roots = np.sqrt(sides * (offs + np.outer(squared, k2)))
        if not seen[h]:
            roots[:, h] = root + zeta
        found = _integrals(values, tail.turns(places, roots, seen), squared[1:], in_u, orders)
        if found is not None:
            return found
        radius *= 0.5
    raise ArithmeticError("the tail has no power series there")


def _pinned(tail: Tail, values: TailValues, orders: int) -> TailSeries:
    """Where the frequency hardly changes, as on an edge of an endless tail's band: one angle changes alone."""
    h, H, k = values.resolved, values.phi.size, np.arange(orders + 1)
    found, rates = np.zeros((orders + 1, 1 + 2 * H)), 1.0 / np.cumprod(np.maximum(k, 1))
    found[0] = np.concatenate([[values.Omega], values.across, values.down])
    for turn, column in enumerate((1 + h, 1 + H + h)):
        found[:, column] = rates * np.sin(values.phi[h] + (k + turn) * 0.5 * np.pi)
    endless, place = replace(tail, cells=np.inf), values.places[h]
    turn = endless.angle(Place(place.edge, place.side * BAND_EDGE_RTOL * tail.width(place))) - values.phi[h]
    return TailSeries(found, turn - np.pi * np.round(turn / np.pi))


def _widest(tail: Tail, values: TailValues, k2: Array, by_root: bool) -> float:
    """The radius of a circle on which no harmonic meets an edge of a band, but for the one that is resolved."""
    reach, resolved = np.inf, values.places[values.resolved]
    for h, place in enumerate(values.places):
        edges = [abs(tail.square(place) - edge) for k, edge in enumerate(tail.edges) if k != place.edge]
        if h != values.resolved:
            edges.append(abs(place.off))
        reach = min(reach, CIRCLE_RADIUS_RATIO * min(edges) * k2[values.resolved] / k2[h])
    if by_root:
        return float(reach / (np.sqrt(abs(resolved.off)) + np.sqrt(abs(resolved.off) + reach)))
    return float(min(reach, CIRCLE_RADIUS_RATIO * abs(resolved.off) + LOBE_CHANGE * tail.lobe(resolved.edge)))


def _integrals(
    values: TailValues, turns: ComplexArray, squared: ComplexArray, in_u: int, orders: int
) -> TailSeries | None:
    """Coefficients from changes of the angles and of Omega^2 on half of the circle; None where that is too wide."""
    w = turns[:, :in_u].sum(axis=1)
    whole = np.concatenate([w, np.conj(w[-2:0:-1])])
    coefficients = np.fft.fft(whole).real / CIRCLE_NODES
    powers = np.fft.fftfreq(CIRCLE_NODES, 1.0 / CIRCLE_NODES)
    if not np.max(np.abs(coefficients[CIRCLE_NODES // 2 :])) <= NEGATIVE_POWER_RATIO * np.max(np.abs(coefficients)):
        return None
    slope = (CIRCLE_NODES * np.fft.ifft(powers * coefficients))[: w.size]
    weights = np.full(w.size, 2.0 / CIRCLE_NODES)
    weights[[0, -1]] = 1.0 / CIRCLE_NODES
    turning = weights * slope / w
    if not abs(np.sum(turning).real - 1.0) <= NEGATIVE_POWER_RATIO:
        return None
    inverse = turning[:, None] * np.cumprod(np.column_stack([np.ones_like(w), *[1.0 / w] * orders]), axis=1)
    Omega, phi = np.sqrt(values.Omega**2 + squared), values.phi + turns
    found = inverse.T @ np.column_stack([Omega, np.sin(phi), np.cos(phi)])
    return TailSeries(np.ascontiguousarray(found.real))
