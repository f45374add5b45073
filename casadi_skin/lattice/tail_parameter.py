"""The unknown u in place of Omega where the tail of a long lattice is eliminated: well resolved at every length.

Where the fundamental or the third harmonic is pinned to an edge of a band, as both are in turn along a softening family
of a leaning lattice, its angle phi changes and Omega does not. So u = phi_1, and u = phi_1 + phi_3 where the third
harmonic comes to a band before the fundamental does: Omega(u) is monotone in gaps and, for a tail of finite length,
smooth and monotone in bands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property, lru_cache

import numpy as np

from casadi_skin.lattice.tail import FARTHEST_FREQUENCY, ComplexArray, Place, Tail
from casadi_skin.zero.problem import Array

KEPT_VALUES = 256  # values that are used again: those of all places of a series at several steps
NEWTON_STEPS = 20  # for an angle in a band
RESOLVED = 4e-16  # of u: a difference that ends them


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
class _End:
    """An end of the frequencies of which all harmonics are bound: the harmonic that meets an edge of a band there."""

    harmonic: int
    edge: Place
    u: float
    phi: float  # of the other harmonic in u, if there is one


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
    def _ends(self) -> tuple[_End | None, _End | None]:
        """The lower and the upper end; None where no harmonic meets a band."""
        found: list[_End | None] = []
        for side, nearest in ((0, max), (1, min)):
            met = [(k, self.tail.sides(gap)[side]) for k, gap in self._gaps.items()]
            squares = {k: (self.tail.edges[edge].square / k**2, edge) for k, edge in met if edge is not None}
            if not squares:
                found.append(None)
                continue
            k = nearest(squares, key=lambda k: squares[k][0])
            edge = Place(self._gaps[k], squares[k][1], 0.0)
            found.append(_End(k, edge, self.tail.angle(edge), 0.0))
        if any(end is not None and end.harmonic == 3 for end in found):
            for side, end in enumerate(found):
                if end is not None:
                    phi = self.tail.angle(self._other(end.harmonic, end.edge))
                    found[side] = _End(end.harmonic, end.edge, end.u + phi, phi)
        return found[0], found[1]

    @cached_property
    def _third(self) -> bool:
        """Whether the third harmonic comes to a band before the fundamental does."""
        return any(end is not None and end.harmonic == 3 for end in self._ends)

    def _other(self, k: int, place: Place) -> Place:
        """Where the other harmonic in u is, 3 or 1; raises ArithmeticError in a band."""
        return self.tail.place(self.tail.square(place) * (9.0 if k == 1 else 1.0 / 9.0))

    def _angle(self, k: int, place: Place) -> float:
        """u where harmonic k is at a place."""
        return self.tail.angle(place) + (self.tail.angle(self._other(k, place)) if self._third else 0.0)

    def _resolved(self, u: float) -> tuple[int, Place, float]:
        """The harmonic that resolves Omega at u, where it is and its angle; raises ArithmeticError for none."""
        lower, upper = self._ends
        end, middle = (lower or upper), self._middle
        if middle is not None and u > middle[1]:
            end = upper
        assert end is not None
        k, inwards, edge = end.harmonic, 1.0 if end is lower else -1.0, self.tail.edges[end.edge.edge].square
        if inwards * (u - end.u) <= 0.0:
            return k, *self._pinned(end, u)
        width = FARTHEST_FREQUENCY * edge if inwards > 0.0 else -edge
        if middle is not None:
            width = k**2 * middle[0] - edge
        place = self.tail.solved(end.edge, width, lambda place: self._angle(k, place), u)
        return k, place, u - (self.tail.angle(self._other(k, place)) if self._third else 0.0)

    @cached_property
    def _middle(self) -> tuple[float, float] | None:
        """Omega^2 in the middle between both ends, and u there; None without one of them."""
        lower, upper = self._ends
        if lower is None or upper is None:
            return None
        squared = 0.5 * sum(self.tail.edges[end.edge.edge].square / end.harmonic**2 for end in (lower, upper))
        return squared, self._angle(1, self.tail.place(squared))

    def _pinned(self, end: _End, u: float) -> tuple[Place, float]:
        """Where the harmonic of an end is, in the band, and its angle."""
        phi = u - end.phi
        for _ in range(NEWTON_STEPS):
            place = self.tail.at_angle(end.edge.gap, phi)
            if not self._third or place.off == 0.0:
                return place, phi
            other = self._other(end.harmonic, place)
            left = phi + self.tail.angle(other) - u
            if abs(left) <= RESOLVED * max(1.0, abs(u)):
                return place, phi
            rate = self.tail.slope(other) * (9.0 if end.harmonic == 1 else 1.0 / 9.0) / self.tail.slope(place)
            phi -= left / (1.0 + rate)
        return place, phi

    # Values -----------------------------------------------------------------------------------------------------------

    def at(self, phi: float) -> float:
        """u where the angle of the fundamental is `phi`."""
        return phi + (self.tail.angle(self._other(1, self.tail.at_angle(self.mode.gap, phi))) if self._third else 0.0)

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
        values, in_u = self.values(u), np.zeros(self.harmonics)
        in_u[: 2 if self._third else 1] = 1.0
        return Harmonics(self.tail, values.places, values.phi, values.resolved, in_u).series(orders)

    def passed(self, values: TailValues) -> int:
        """Modes of the tail by itself that harmonics lie above, of high harmonics as counted from infinity."""
        last = len(self.tail.edges) - 1
        above_all = Place((last + 1) // 2, last, FARTHEST_FREQUENCY * self.tail.edges[last].square)
        passed = np.floor(values.phi / np.pi + 0.5)
        passed[max(self._gaps) // 2 + 1 :] -= np.floor(self.tail.angle(above_all) / np.pi + 0.5)
        return int(np.sum(passed))

    def regime(self, values: TailValues) -> Regime:
        """Whether Omega, or three times it, is pinned to a band."""
        for k, regime in ((1, Regime.PINNED), (3, Regime.THIRD)):
            below, above = self.tail.sides(self._gaps.get(k, 0)) if k in self._gaps else (None, None)
            phi = values.phi[(k - 1) // 2]
            for edge, outwards in ((below, -1.0), (above, 1.0)):
                if edge is not None and outwards * (phi - self.tail.angle(Place(self._gaps[k], edge, 0.0))) > 0.0:
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

    Shapes are (orders + 1,) and (orders + 1, harmonics). They hold up to u = `end` where that is a number: functions of
    an endless tail are not analytic where a harmonic leaves an edge of a band.
    """

    Omega: Array
    across: Array
    down: Array
    end: float = np.nan


@dataclass(frozen=True)
class Harmonics:
    """Places and angles phi of all odd harmonics; place number `resolved` is known best.

    u grows by the sum of the changes of the angles times `in_u`.
    """

    tail: Tail
    places: Sequence[Place]
    phi: Array
    resolved: int
    in_u: Array

    def series(self, orders: int) -> TailSeries:
        """The series by changes of u, as is `end`; raises ArithmeticError where no circle has no singularity within."""
        place, tail = self.places[self.resolved], self.tail
        k2 = np.asarray((2.0 * np.arange(self.phi.size) + 1.0) ** 2, dtype=np.float64)
        squared = tail.square(place) / k2[self.resolved]
        if self._is_pinned(place):
            return self._pinned(place, squared, orders)
        by_root = tail.end_unseen(place)
        radius, root = self._widest(place, k2, by_root), float(np.sqrt(abs(place.off)))
        for _ in range(CIRCLE_HALVINGS):
            zeta = radius * np.exp(2j * np.pi * np.arange(CIRCLE_NODES // 2 + 1) / CIRCLE_NODES)
            change = (tail.side(place) * zeta * (2.0 * root + zeta) if by_root else zeta) / k2[self.resolved]
            turns = np.empty((zeta.size, self.phi.size), dtype=complex)
            for (edge, seen), these in self._alike.items():
                offs = np.array([self.places[h].off for h in these])
                turns[:, these] = tail.turns(edge, offs, np.outer(change, k2[these]), seen)
            if by_root:
                turns[:, self.resolved] = tail.turns_by_root(place, zeta)
            found = self._integrals(turns, change, squared, orders)
            if found is not None:
                return found
            radius *= 0.5
        raise ArithmeticError("the tail has no power series there")

    @cached_property
    def _alike(self) -> dict[tuple[int, bool], list[int]]:
        """Harmonics by their edge and whether the far end of the tail is felt, but for one at a root of its own."""
        found: dict[tuple[int, bool], list[int]] = {}
        for h, place in enumerate(self.places):
            unseen = self.tail.end_unseen(place)
            if not (unseen and h == self.resolved):
                found.setdefault((place.edge, not unseen), []).append(h)
        return found

    def _is_pinned(self, place: Place) -> bool:
        """Whether the frequency hardly changes with u, as on an edge of an endless tail's band."""
        return self.tail.cells >= ENDLESS_CELLS and self.tail.decay(place) == 0.0

    def _pinned(self, place: Place, squared: float, orders: int) -> TailSeries:
        """The angle of the harmonic that is pinned changes alone."""
        h, k = self.resolved, np.arange(orders + 1)
        Omega, across, down = np.zeros(orders + 1), *np.zeros((2, orders + 1, self.phi.size))
        Omega[0], across[0], down[0] = np.sqrt(squared), np.sin(self.phi), np.cos(self.phi)
        rates = np.cumprod(np.append(1.0, 1.0 / (self.in_u[h] * k[1:])))  # of phi by u, and factorials
        across[:, h], down[:, h] = (rates * np.sin(self.phi[h] + (k + turn) * 0.5 * np.pi) for turn in (0, 1))
        endless, outwards = replace(self.tail, cells=np.inf), 1.0 if place.edge % 2 else -1.0
        width = self.tail.edges[place.edge].square - self.tail.edges[place.edge - int(outwards)].square
        turn = endless.angle(Place(place.gap, place.edge, outwards * BAND_EDGE_RTOL * abs(width))) - self.phi[h]
        return TailSeries(Omega, across, down, self.in_u[h] * (turn - np.pi * np.round(turn / np.pi)))

    def _widest(self, place: Place, k2: Array, by_root: bool) -> float:
        """The radius of a circle on which no harmonic meets an edge of a band, but for the one that is resolved."""
        reach = np.inf
        for h, at in enumerate(self.places):
            edges = [abs(self.tail.square(at) - edge.square) for k, edge in enumerate(self.tail.edges) if k != at.edge]
            if h != self.resolved:
                edges.append(abs(at.off))
            reach = min(reach, CIRCLE_RADIUS_RATIO * min(edges) * k2[self.resolved] / k2[h])
        if by_root:
            return float(reach / (np.sqrt(abs(place.off)) + np.sqrt(abs(place.off) + reach)))
        return float(min(reach, CIRCLE_RADIUS_RATIO * abs(place.off) + LOBE_CHANGE * self.tail.lobe(place.edge)))

    def _integrals(self, turns: ComplexArray, change: ComplexArray, squared: float, orders: int) -> TailSeries | None:
        """Coefficients from values on half of the circle; None where that is too wide."""
        w = turns @ self.in_u
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
        values = np.column_stack([np.sqrt(squared + change), np.sin(self.phi + turns), np.cos(self.phi + turns)])
        found = (inverse.T @ values).real
        count = self.phi.size
        return TailSeries(found[:, 0], found[:, 1 : 1 + count], found[:, 1 + count :])
