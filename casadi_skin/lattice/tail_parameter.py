"""The unknown in place of Omega where a long chain's tail is eliminated: smooth and well resolved at every length."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property, lru_cache

import numpy as np

from casadi_skin.lattice.cell_tail import CellTail, Place
from casadi_skin.lattice.tail import Tail, Wave
from casadi_skin.lattice.tail_series import Harmonics, TailSeries
from casadi_skin.zero.problem import Array

KEPT_VALUES = 256  # values that are used again: those of all places of a series at several steps
NEWTON_STEPS = 10  # for an angle, before it is bracketed
RESOLVED_ANGLE_STEP = 1e-11  # of an angle: a step that ends them


class Regime(Enum):
    """Regime of the linear tail of a long lattice, in words."""

    PINNED = "the frequency is pinned to the edge of the band"
    BOUND = "the breather is bound to the edge of the lattice"
    THIRD = "three times the frequency is pinned to the band: the third harmonic fills the tail"


@dataclass(frozen=True)
class TailValues:
    """Values at one u of the parameter that the core needs, and derivatives by u.

    Harmonic k = 2 h + 1 has a_(c-1) = across[h] b and a_c = down[h] b: across = e sin(psi_k), down = cos(psi_k).
    """

    Omega: float
    Omega_slope: float
    across: Array
    across_slope: Array
    down: Array
    down_slope: Array
    psi: Array


@dataclass(frozen=True)
class TailParameter:
    """A parameter u of the family of an edge mode that resolves Omega where it is pinned to an edge of the band.

    At the upper edge u = psi_1. At the lower one, from which a softening mode falls into the gap, u = psi_1 - psi_3:
    with N infinite Omega does not change below the threshold, where psi_1 does, nor when 3 Omega has come down to the
    upper edge, where psi_3 does. Omega(u) is smooth and monotone for finite N, whatever its length.
    """

    tail: Tail
    edge: int  # +1 for the lower edge of the band, -1 for the upper one
    harmonics: int

    def __post_init__(self) -> None:
        if self.edge > 0 and 9.0 * self.tail.edge_squared(1) <= self.tail.edge_squared(-1):
            raise ValueError("three times the lowest frequency lies in the band: nothing of the tail is bound")

    @property
    def coupling(self) -> float:
        """Coupling of neighbouring sites in the gauge."""
        return self.tail.coupling

    def passed(self, values: TailValues) -> int:
        """Modes of the tail by itself that harmonics lie above, counted from those above which they lie in gaps."""
        return int(np.sum(np.floor(self._edges * values.psi / np.pi + 0.5)))

    def regime(self, values: TailValues) -> Regime:
        """Whether Omega, or three times it, is pinned to the band."""
        edge = self.tail.edge_angle
        if values.psi[0] > edge:
            return Regime.PINNED
        return Regime.THIRD if values.psi[1] > edge else Regime.BOUND

    @cached_property
    def _turn(self) -> tuple[float, float]:
        """psi_1 and psi_3 in the middle of the gap: below it psi_3 is solved for, above it psi_1."""
        squared = 0.5 * (self.tail.edge_squared(1) + self.tail.edge_squared(-1) / 9.0)
        return self._psi(1, squared), self._psi(3, squared)

    def _beyond(self, k: int, Omega_squared: float) -> float:
        """How far (k Omega)^2 is outside its edge, in units of 4 s."""
        edge = self.edge if k == 1 else -1
        return edge * (self.tail.edge_squared(edge) - k**2 * Omega_squared) / (4.0 * self.tail.coupling)

    def _beside(self, k: int, Omega_squared: float) -> Wave:
        return self.tail.wave_at(self._beyond(k, Omega_squared))

    def _psi(self, k: int, Omega_squared: float) -> float:
        return self._beside(k, Omega_squared).psi

    def _squared(self, k: int, wave: Wave) -> float:
        """Omega^2 of a wave of harmonic k."""
        edge = self.edge if k == 1 else -1
        return (self.tail.edge_squared(edge) - 4.0 * edge * self.tail.coupling * self.tail.outside(wave)) / k**2

    def of_frequency(self, Omega: float) -> float:
        """u where the frequency is `Omega`, bound beside the band; NaN where it is pinned or not there."""
        bound = [1] if self.edge < 0 else [1, 3]
        if min(self._beyond(k, Omega**2) for k in bound) <= 0.0:
            return float("nan")
        return self._psi(1, Omega**2) - (0.0 if self.edge < 0 else self._psi(3, Omega**2))

    def at(self, psi: float) -> float:
        """u where psi_1 is `psi`."""
        if self.edge < 0:
            return psi
        return psi - self._psi(3, self._squared(1, self.tail.wave(psi)))

    def _resolved(self, u: float) -> tuple[int, Wave]:
        """The harmonic that resolves Omega at u, and its wave."""
        if self.edge < 0:
            return 1, self.tail.wave(u)
        psi_1, psi_3 = self._turn
        at_1, at_3 = self._at_edges
        turn, edge = psi_1 - psi_3, self.tail.edge_angle
        if u >= turn:  # Omega, and so psi_3, changes with the square of the distance from the edge, nearly
            guess = at_3 + (psi_3 - at_3) * max((edge - at_3 - u) / (edge - at_3 - turn), 0.0) ** 2
            return 1, self._wave_beside(1, u, max(u, psi_1), u + psi_3, u + guess)
        guess = at_1 + (psi_1 - at_1) * max((u - at_1 + edge) / (turn - at_1 + edge), 0.0) ** 2
        return 3, self._wave_beside(3, -u, max(-u, psi_3), psi_1 - u, guess - u)

    @cached_property
    def _at_edges(self) -> tuple[float, float]:
        """psi_1 where the third harmonic is at its edge of the band, and psi_3 where the fundamental is."""
        return self._psi(1, self.tail.edge_squared(-1) / 9.0), self._psi(3, self.tail.edge_squared(1))

    def _wave_beside(self, k: int, apart: float, low: float, high: float, guess: float) -> Wave:
        """The wave of harmonic k, 1 or 3, whose angle is `apart` above that of the other one, between two angles."""
        from scipy.optimize import brentq

        def above(psi: float) -> tuple[float, float]:
            wave = self.tail.wave(psi)
            other = self._beside(4 - k, self._squared(k, wave))
            return psi - other.psi - apart, 1.0 - self._slope(4 - k, other) * self._slope_by_psi(k, wave)

        psi = min(max(guess, low), high)
        for _ in range(NEWTON_STEPS):
            value, slope = above(psi)
            step = value / slope
            psi = min(max(psi - step, low), high)
            if abs(step) <= RESOLVED_ANGLE_STEP * psi:  # the next one is its square
                return self.tail.wave(psi)
        return self.tail.wave(float(brentq(lambda psi: above(psi)[0], low, high, xtol=1e-300, rtol=1e-15)))

    def _slope(self, k: int, wave: Wave) -> float:
        """d psi_k / d Omega^2 of a wave beside the band."""
        edge = self.edge if k == 1 else -1
        return -edge * k**2 * wave.slope / (2.0 * self.tail.coupling * math.sinh(wave.kappa))

    def _slope_by_psi(self, k: int, wave: Wave) -> float:
        """d Omega^2 / d psi_k."""
        edge = self.edge if k == 1 else -1
        return -4.0 * edge * self.tail.coupling * self.tail.outside_slope(wave) / k**2

    @cached_property
    def _as_cells(self) -> CellTail:
        """The same tail as one of cells of one site."""
        tail = self.tail
        return CellTail(tail.sites - 1.0, np.array([[2.0 + tail.alpha]]), tail.coupling, 0, 0)

    def series(self, u: float, orders: int) -> TailSeries:
        """Power series of the same by changes of u; raises ArithmeticError as well where none is found."""
        k0, wave = _place(self.tail, self.edge, u)
        resolved, in_u = (k0 - 1) // 2, np.zeros(self.harmonics)
        offs = self._odd**2 * self._squared(k0, wave) - self._edge_squares
        offs[resolved] = -4.0 * self._edges[resolved] * self.tail.coupling * self.tail.outside(wave)
        numbers = [0 if edge > 0.0 else 1 for edge in self._edges]  # of edges, and of the gaps beside them
        places = [Place(number, number, off) for number, off in zip(numbers, offs.tolist(), strict=True)]
        in_u[:2] = (-1.0, 0.0) if self.edge < 0 else (1.0, 1.0)  # phi is -psi beside the upper edge
        return Harmonics(self._as_cells, places, self._edges * self.values(u).psi, resolved, in_u).series(orders)

    def values(self, u: float) -> TailValues:
        """All that the core needs at u; raises ArithmeticError where a harmonic that should be bound is in the band."""
        return self._kept(u)

    @cached_property
    def _kept(self) -> Callable[[float], TailValues]:
        return lru_cache(KEPT_VALUES)(self._values)

    def _values(self, u: float) -> TailValues:
        k0, wave = _place(self.tail, self.edge, u)
        squared, by_psi = self._squared(k0, wave), self._slope_by_psi(k0, wave)
        k, edges = self._odd, self._edges
        beyond = edges * (self._edge_squares - k**2 * squared) / (4.0 * self.tail.coupling)
        h0 = (k0 - 1) // 2
        beyond[h0] = 1.0  # anything: known already
        kappa, psi, slopes = self.tail.waves_at(beyond)
        by_squared = -edges * k**2 * slopes / (2.0 * self.tail.coupling * np.sinh(kappa))  # d psi / d Omega^2
        sign = 1.0 if k0 == 1 else -1.0
        partner = 0.0 if self.edge < 0 else float(by_squared[1 if k0 == 1 else 0]) * by_psi
        psi_slope = sign / (1.0 - partner)  # d psi_k0 / d u, with u = psi_1 - psi_3
        squared_slope = by_psi * psi_slope
        psi[h0] = wave.psi
        by_u = by_squared * squared_slope
        by_u[h0] = psi_slope
        Omega, across, down = math.sqrt(squared), np.sin(psi), np.cos(psi)
        Omega_slope = float(squared_slope / (2.0 * Omega))
        return TailValues(Omega, Omega_slope, edges * across, edges * down * by_u, down, -across * by_u, psi)

    @cached_property
    def _odd(self) -> Array:
        return np.asarray(2.0 * np.arange(self.harmonics) + 1.0, dtype=np.float64)

    @cached_property
    def _edges(self) -> Array:
        """The edge of the band that each harmonic is beside."""
        return np.where(self._odd == 1.0, float(self.edge), -1.0)

    @cached_property
    def _edge_squares(self) -> Array:
        return np.where(self._edges > 0.0, self.tail.edge_squared(1), self.tail.edge_squared(-1))


@lru_cache(maxsize=2)
def _two_harmonics(tail: Tail, edge: int) -> TailParameter:
    return TailParameter(tail, edge, 2)


@lru_cache(maxsize=KEPT_VALUES)
def _place(tail: Tail, edge: int, u: float) -> tuple[int, Wave]:
    """The harmonic that resolves Omega at u, and its wave, for any number of harmonics."""
    return _two_harmonics(tail, edge)._resolved(u)
