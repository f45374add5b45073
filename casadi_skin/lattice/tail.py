"""The linear tail of a long chain, site by site in closed form, as a boundary condition of the nonlinear core.

Where w_n q_n^2 is below round-off the sites of the gauge are linear and every odd harmonic k is by itself: a_n solves
s (a_(n-1) + a_(n+1)) = (2 + alpha - k^2 Omega^2) a_n with a_0 = 0, so that a_n ~ sin(n theta) in the band and
sinh(n kappa) beside it. With c sites in the tail and the first of the core, the ratio of the last two is all that the
core needs: tan(psi) = e a_(c-1)/a_c, e = +1 at the lower edge of the band and -1 at the upper one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from casadi_skin.zero.problem import Array

EDGE_ANGLE = 0.25 * math.pi  # psi of the band edge, in the limit of a long tail
FAR_END_DECAY = 40.0  # of c kappa: beyond it the far end of the tail is not felt


@dataclass(frozen=True)
class Wave:
    """Where a harmonic is: phase theta > 0 a site in the band, or decay kappa > 0 beside it, and psi with d psi."""

    theta: float
    kappa: float
    psi: float
    slope: float  # d psi / d theta or d psi / d kappa


@dataclass(frozen=True)
class Tail:
    """A tail of which the first site of the core is number `sites` from its fixed end; `sites` may be infinite."""

    sites: float
    alpha: float
    coupling: float  # s = sqrt(1 - gamma^2)

    # One harmonic, from its angle or from its frequency -------------------------------------------------------------

    def wave(self, psi: float) -> Wave:
        """The wave of angle psi > 0: in the band for psi above that of its edge, counted on through the lobes.

        Raises ArithmeticError for psi <= 0, which no frequency has.
        """
        if not psi > 0.0:
            raise ArithmeticError(f"no wave has the angle {psi:g}")
        edge = self.edge_angle
        if psi >= edge:
            return self._in_band(psi)
        return self._beside(psi)

    @property
    def edge_angle(self) -> float:
        """Angle psi at which a harmonic is exactly at the edge of the band."""
        return math.atan2(self.sites - 1.0, self.sites) if math.isfinite(self.sites) else EDGE_ANGLE

    def _in_band(self, psi: float) -> Wave:
        from scipy.optimize import brentq

        c = self.sites
        if not math.isfinite(c):
            return Wave(0.0, 0.0, psi, math.inf)
        lobe = math.floor((psi + 0.5 * math.pi) / math.pi)  # sin(c theta) vanishes at psi = lobe pi - pi / 2

        def angle(phase: float) -> float:
            return _angle_in_band(phase, c) - psi

        low, high = lobe * math.pi, (lobe + 1.0) * math.pi
        if angle(low if lobe else 1e-300) >= 0.0:
            phase = low
        else:
            phase = float(brentq(angle, low, high, xtol=1e-300, rtol=1e-15))
        return Wave(phase / c, 0.0, psi, _slope_in_band(phase / c, c))

    def _beside(self, psi: float) -> Wave:
        from scipy.optimize import brentq

        c, ratio = self.sites, math.tan(psi)
        kappa = -math.log(ratio)
        if math.isfinite(c) and c * kappa < FAR_END_DECAY:
            upper = kappa * (1.0 + 1e-10)  # the root is below kappa, but perhaps by less than rounding
            kappa = float(brentq(lambda k: _ratio_beside(k, c) - ratio, 0.0, upper, xtol=1e-300, rtol=1e-15))
        return Wave(0.0, kappa, psi, _slope_beside(kappa, c))

    def wave_at(self, beyond: float) -> Wave:
        """The wave of a harmonic whose (k Omega)^2 is `beyond` outside its edge of the band, in units of 4 s.

        Raises ArithmeticError in the band, where nothing decays.
        """
        if beyond <= 0.0:
            raise ArithmeticError("a harmonic lies in the band: the tail carries it away")
        kappa = 2.0 * math.asinh(math.sqrt(beyond))
        ratio = _ratio_beside(kappa, self.sites)
        return Wave(0.0, kappa, math.atan(ratio), _slope_beside(kappa, self.sites))

    def waves_at(self, beyond: Array) -> tuple[Array, Array, Array]:
        """kappa, psi and d psi / d kappa of `wave_at`, for all harmonics at once. Raises as that."""
        if not np.min(beyond) > 0.0:
            raise ArithmeticError("a harmonic lies in the band: the tail carries it away")
        kappa, c = 2.0 * np.arcsinh(np.sqrt(beyond)), self.sites
        ratio = np.exp(-kappa)
        slope = -ratio
        if math.isfinite(c):
            far, farther = np.exp(-2.0 * (c - 1.0) * kappa), np.exp(-2.0 * c * kappa)
            inside = -np.expm1(-2.0 * c * kappa)
            # the ratio is a = sinh((c-1) kappa)/b with b = sinh(c kappa); da = c sinh(kappa)/b^2 - cosh((c-1) kappa)/b
            slope = 4.0 * c * np.sinh(kappa) * farther / inside**2 - ratio * (1.0 + far) / inside
            ratio = -ratio * np.expm1(-2.0 * (c - 1.0) * kappa) / inside
        return kappa, np.arctan(ratio), slope / (1.0 + ratio**2)

    # Frequencies ----------------------------------------------------------------------------------------------------

    def edge_squared(self, edge: int) -> float:
        """Square of the frequency at the lower (+1) or upper (-1) edge of the band."""
        return 2.0 + self.alpha - 2.0 * edge * self.coupling

    def outside(self, wave: Wave) -> float:
        """How far (k Omega)^2 of a wave is outside the edge it belongs to, in units of 4 s; negative in the band."""
        return math.sinh(0.5 * wave.kappa) ** 2 - math.sin(0.5 * wave.theta) ** 2

    def outside_slope(self, wave: Wave) -> float:
        """Derivative of `outside` by psi."""
        if wave.kappa > 0.0:
            return 0.5 * math.sinh(wave.kappa) / wave.slope
        if wave.theta > 0.0:
            return -0.5 * math.sin(wave.theta) / wave.slope
        return 0.0 if not math.isfinite(self.sites) else -_edge_slope(self.sites)

    def squares(self, wave: Wave) -> float:
        """Sum of a_n^2/a_c^2 over the tail; infinite where an infinite tail moves along."""
        m = self.sites - 1.0
        if wave.kappa > 0.0:
            decay = math.exp(-2.0 * wave.kappa)
            if m * wave.kappa > FAR_END_DECAY:
                return decay / (1.0 - decay)
            total = 0.5 * (math.sinh(m * wave.kappa) * math.cosh((m + 1.0) * wave.kappa) / math.sinh(wave.kappa) - m)
            return total / math.sinh((m + 1.0) * wave.kappa) ** 2
        if not math.isfinite(m):
            return math.inf
        total = 0.5 * (m - math.sin(m * wave.theta) * math.cos((m + 1.0) * wave.theta) / math.sin(wave.theta))
        return total / math.sin((m + 1.0) * wave.theta) ** 2


def _angle_in_band(phase: float, c: float) -> float:
    """psi of c theta = phase, counted on through the lobes."""
    theta, lobe = phase / c, math.floor(phase / math.pi)
    inside = phase - lobe * math.pi
    return lobe * math.pi + math.atan2(math.sin(inside - theta), math.sin(inside))


def _slope_in_band(theta: float, c: float) -> float:
    """d psi / d theta."""
    a, b = math.sin((c - 1.0) * theta), math.sin(c * theta)
    da, db = (c - 1.0) * math.cos((c - 1.0) * theta), c * math.cos(c * theta)
    return (b * da - a * db) / (a * a + b * b) if theta > 0.0 else math.inf


def _ratio_beside(kappa: float, c: float) -> float:
    """sinh((c - 1) kappa) / sinh(c kappa)."""
    if not math.isfinite(c):
        return math.exp(-kappa)
    if kappa == 0.0:
        return (c - 1.0) / c
    return math.exp(-kappa) * math.expm1(-2.0 * (c - 1.0) * kappa) / math.expm1(-2.0 * c * kappa)


def _slope_beside(kappa: float, c: float) -> float:
    """d psi / d kappa."""
    t = _ratio_beside(kappa, c)
    if math.isfinite(c) and c * kappa < FAR_END_DECAY:
        # d/dkappa of sinh((c-1) kappa)/sinh(c kappa) = (c - 1) cosh((c-1) kappa)/sinh(c kappa) - c t coth(c kappa)
        both = math.sinh(c * kappa)
        slope = ((c - 1.0) * math.cosh((c - 1.0) * kappa) - c * t * math.cosh(c * kappa)) / both
    else:
        slope = -t
    return slope / (1.0 + t * t)


def _edge_slope(c: float) -> float:
    """d(theta^2/4)/d psi at theta = 0, from sin((c-1) theta)/sin(c theta) = (c-1)/c (1 + (2 c - 1) theta^2/6 + ...)."""
    t = (c - 1.0) / c
    return 0.25 * (1.0 + t * t) * 6.0 / (t * (2.0 * c - 1.0))
