"""Power series, in the unknown u in place of Omega, of what the core of a long lattice needs of its tail.

All of it is an analytic function of the frequency, in closed form for complex frequencies too. So the coefficients are
integrals over a circle about the place of one harmonic, by the trapezoidal rule; the same integrals invert u
(Lagrange's theorem; Lyness and Moler 1967 for derivatives by such sums).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadi_skin.lattice.cell_tail import CellTail, ComplexArray, Place
from casadi_skin.zero.problem import Array

NODES = 64  # of the circle
WITHIN = 0.5  # of the distance to the next edge of a band that the circle may have
LOBES = 2.0  # of (cells times decay)^2, which waves of the far end change by
HALVINGS = 40  # of the circle, until no singularity lies within
LEFT = 1e-7  # of the largest coefficient: those of negative powers, which a singularity within has
ENDLESS = 8000.0  # cells from which on waves of the far end move Omega by less than the precision of a prediction
ACROSS = 1e-8  # of a band's width: how far Omega may leave its edge before a prediction needs it


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

    tail: CellTail
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
        for _ in range(HALVINGS):
            zeta = radius * np.exp(2j * np.pi * np.arange(NODES // 2 + 1) / NODES)
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
        return self.tail.cells >= ENDLESS and self.tail.decay(place) == 0.0

    def _pinned(self, place: Place, squared: float, orders: int) -> TailSeries:
        """The angle of the harmonic that is pinned changes alone."""
        h, k = self.resolved, np.arange(orders + 1)
        Omega, across, down = np.zeros(orders + 1), *np.zeros((2, orders + 1, self.phi.size))
        Omega[0], across[0], down[0] = np.sqrt(squared), np.sin(self.phi), np.cos(self.phi)
        rates = np.cumprod(np.append(1.0, 1.0 / (self.in_u[h] * k[1:])))  # of phi by u, and factorials
        across[:, h], down[:, h] = (rates * np.sin(self.phi[h] + (k + turn) * 0.5 * np.pi) for turn in (0, 1))
        endless, outwards = replace(self.tail, cells=np.inf), 1.0 if place.edge % 2 else -1.0
        width = self.tail.edges[place.edge].square - self.tail.edges[place.edge - int(outwards)].square
        turn = endless.angle(Place(place.gap, place.edge, outwards * ACROSS * abs(width))) - self.phi[h]
        return TailSeries(Omega, across, down, self.in_u[h] * (turn - np.pi * np.round(turn / np.pi)))

    def _widest(self, place: Place, k2: Array, by_root: bool) -> float:
        """The radius of a circle on which no harmonic meets an edge of a band, but for the one that is resolved."""
        reach = np.inf
        for h, at in enumerate(self.places):
            edges = [abs(self.tail.square(at) - edge.square) for k, edge in enumerate(self.tail.edges) if k != at.edge]
            if h != self.resolved:
                edges.append(abs(at.off))
            reach = min(reach, WITHIN * min(edges) * k2[self.resolved] / k2[h])
        if by_root:
            return float(reach / (np.sqrt(abs(place.off)) + np.sqrt(abs(place.off) + reach)))
        return float(min(reach, WITHIN * abs(place.off) + LOBES * self.tail.lobe(place.edge)))

    def _integrals(self, turns: ComplexArray, change: ComplexArray, squared: float, orders: int) -> TailSeries | None:
        """Coefficients from values on half of the circle; None where that is too wide."""
        w = turns @ self.in_u
        whole = np.concatenate([w, np.conj(w[-2:0:-1])])
        coefficients = np.fft.fft(whole).real / NODES
        powers = np.fft.fftfreq(NODES, 1.0 / NODES)
        if not np.max(np.abs(coefficients[NODES // 2 :])) <= LEFT * np.max(np.abs(coefficients)):
            return None
        slope = (NODES * np.fft.ifft(powers * coefficients))[: w.size]
        weights = np.full(w.size, 2.0 / NODES)
        weights[[0, -1]] = 1.0 / NODES
        turning = weights * slope / w
        if not abs(np.sum(turning).real - 1.0) <= LEFT:
            return None
        inverse = turning[:, None] * np.cumprod(np.column_stack([np.ones_like(w), *[1.0 / w] * orders]), axis=1)
        values = np.column_stack([np.sqrt(squared + change), np.sin(self.phi + turns), np.cos(self.phi + turns)])
        found = (inverse.T @ values).real
        count = self.phi.size
        return TailSeries(found[:, 0], found[:, 1 : 1 + count], found[:, 1 + count :])
