"""The unknown in place of Omega where a long chain's tail is eliminated: smooth and well resolved at every length."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property, lru_cache

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.lattice.tail import Tail, Wave

KEPT = 16  # values that are used again
NEWTON_STEPS = 8  # for an angle, before it is bracketed
RESOLVED = 4e-16  # of an angle: a step that ends them


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
        if u >= psi_1 - psi_3:
            return 1, self._wave_beside(1, u, max(u, psi_1), u + psi_3)
        return 3, self._wave_beside(3, -u, psi_1 - u, max(-u, psi_3))

    def _wave_beside(self, k: int, apart: float, low: float, high: float) -> Wave:
        """The wave of harmonic k, 1 or 3, whose angle is `apart` above that of the other one, between two angles."""
        from scipy.optimize import brentq

        def above(psi: float) -> tuple[float, float]:
            wave = self.tail.wave(psi)
            other = self._beside(4 - k, self._squared(k, wave))
            return psi - other.psi - apart, 1.0 - self._slope(4 - k, other) * self._slope_by_psi(k, wave)

        psi = 0.5 * (low + high)
        for _ in range(NEWTON_STEPS):
            value, slope = above(psi)
            step = value / slope
            if not low <= psi - step <= high:
                break
            psi -= step
            if abs(step) <= RESOLVED * psi:
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

    def values(self, u: float) -> TailValues:
        """All that the core needs at u; raises ArithmeticError where a harmonic that should be bound is in the band."""
        return self._kept(u)

    @cached_property
    def _kept(self) -> Callable[[float], TailValues]:
        return lru_cache(KEPT)(self._values)

    def _values(self, u: float) -> TailValues:
        k0, wave = self._resolved(u)
        squared, by_psi = self._squared(k0, wave), self._slope_by_psi(k0, wave)
        ks = 2 * np.arange(self.harmonics) + 1
        edges = np.where(ks == 1, self.edge, -1)
        psi, slopes = np.zeros(ks.size), np.zeros(ks.size)  # and d psi_k / d Omega^2
        for h, k in enumerate(ks.tolist()):
            if k != k0:
                other = self._beside(k, squared)
                psi[h] = other.psi
                slopes[h] = self._slope(k, other)
        h0 = (k0 - 1) // 2
        sign = 1.0 if k0 == 1 else -1.0
        partner = 0.0 if self.edge < 0 else slopes[1 if k0 == 1 else 0] * by_psi
        psi_slope = sign / (1.0 - partner)  # d psi_k0 / d u, with u = psi_1 - psi_3
        squared_slope = by_psi * psi_slope
        psi[h0] = wave.psi
        by_u = slopes * squared_slope
        by_u[h0] = psi_slope
        Omega = math.sqrt(squared)
        return TailValues(
            Omega,
            float(squared_slope / (2.0 * Omega)),
            edges * np.sin(psi),
            edges * np.cos(psi) * by_u,
            np.cos(psi),
            -np.sin(psi) * by_u,
            psi,
        )
