"""Hermite curves of a branch through points with their tangents: predictor, and where a value is passed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval

from casadi_skin.zero.problem import Array

PREDICTING_POINTS = 4  # points that a prediction is made from
HULL_MARGIN = 1e-9  # of the largest bound on values without a zero: rounding is far below
ALIGNED_COSINE = 0.7  # cosine of the turn since a point, at least: three steps turn by less, a corner by more


@dataclass(frozen=True)
class LocalCurve:
    """Curve z(sigma) with z(0) = z0 and z'(0) = t0, through z1 with slope t1 at sigma1 where these are given.

    sigma = row . (z - z0) is the coordinate in which the corrector takes its step, so that the curve is a smooth graph.
    """

    z0: Array
    t0: Array
    quadratic: Array
    cubic: Array

    @classmethod
    def line(cls, z0: Array, t0: Array) -> LocalCurve:
        """The tangent line."""
        zero = np.zeros_like(z0)
        return cls(z0, t0, zero, zero)

    @classmethod
    def through(cls, z0: Array, t0: Array, z1: Array, t1: Array, row: Array) -> LocalCurve:
        """Cubic Hermite curve; t0 and t1 are tangents of any length with row . t > 0."""
        sigma = float(row @ (z1 - z0))
        slope0, slope1 = t0 / float(row @ t0), t1 / float(row @ t1)
        chord = (z1 - z0) / sigma
        quadratic = (3.0 * chord - 2.0 * slope0 - slope1) / sigma
        cubic = (slope0 + slope1 - 2.0 * chord) / sigma**2
        return cls(z0, slope0, quadratic, cubic)

    def at(self, sigma: float) -> Array:
        """Point of the curve."""
        return self.z0 + sigma * (self.t0 + sigma * (self.quadratic + sigma * self.cubic))

    def slope(self, sigma: float | Array, index: Any = slice(None)) -> Array:
        """Derivative dz/dsigma, or of one component at places."""
        bend = 2.0 * self.quadratic[index] + 3.0 * sigma * self.cubic[index]
        return np.asarray(self.t0[index] + sigma * bend)

    def crossings(self, index: int, value: float, end: float) -> list[float]:
        """All sigma in (0, end] at which component `index` equals `value`, ascending."""
        polynomial = [self.cubic[index], self.quadratic[index], self.t0[index], self.z0[index] - value]
        scale = max(abs(c) for c in polynomial)
        a, b, c, d = polynomial[0] * end**3, polynomial[1] * end**2, polynomial[2] * end, polynomial[3]
        hull = (d, d + c / 3.0, d + (2.0 * c + b) / 3.0, d + c + b + a)  # Bernstein coefficients bound the values
        if min(hull) > HULL_MARGIN * max(hull) > 0.0 or max(hull) < HULL_MARGIN * min(hull) < 0.0:
            return []
        roots = np.roots([0.0 if abs(c) < 1e-300 * scale else c for c in polynomial])
        real = roots.real[np.abs(roots.imag) <= 1e-9 * np.abs(roots)]
        return sorted(float(s) for s in real if 0.0 < s <= end)


def predictor(z: Array, t: Array, before: Sequence[tuple[Array, Array]], row: Array) -> Callable[[float], Array]:
    """The curve through z with tangent t and through earlier points with theirs, latest first, over sigma.

    Hermite interpolation of degree 2 n - 1 through n points; sigma = row . (z(sigma) - z). Only points in order along
    `row` are used, so that the curve of a sharp turn is not wilder than the turn.
    """
    places, values, slopes, last = [0.0], [z], [t / float(row @ t)], 0.0
    for earlier, tangent in before:
        sigma, slope = float(row @ (earlier - z)), float(row @ tangent)
        if not (sigma < last and slope > ALIGNED_COSINE):
            break
        places, values, slopes, last = [*places, sigma], [*values, earlier], [*slopes, tangent / slope], sigma
    return interpolant(np.array(places), np.array(values), np.array(slopes))


def predicting(
    z: Array, before: Sequence[tuple[Array, Array]], row: Array, weights: Array
) -> Sequence[tuple[Array, Array]]:
    """Earlier points to predict the next from: none where the earliest of them predicted z worse than a tangent did.

    Where steps are short the polynomial amplifies what the corrector leaves over, and they would stay as short.
    """
    if len(before) < 2 or not row @ before[0][1] > 0.0:
        return before
    (start, tangent), *earlier = before
    sigma = float(row @ (z - start))
    guesses = predictor(start, tangent, earlier, row)(sigma), start + sigma / float(row @ tangent) * tangent
    by_curve, by_tangent = (float(weights @ (guess - z) ** 2) for guess in guesses)
    return before if by_curve <= by_tangent else ()


def interpolant(places: Array, values: Array, slopes: Array) -> Callable[[float | Array], Array]:
    """The polynomial of least degree through values and slopes, each (places, m), by divided differences.

    Written out, as scipy.interpolate takes a third of a family's time to load.
    """
    nodes, table = np.repeat(places, 2), np.repeat(values, 2, axis=0)
    coefficients = [table[0]]
    for order in range(1, nodes.size):
        rise, apart = np.diff(table, axis=0), (nodes[order:] - nodes[:-order])[:, None]
        if order == 1:
            table = np.repeat(slopes, 2, axis=0)[:-1]
            table[1::2] = rise[1::2] / apart[1::2]
        else:
            table = rise / apart
        coefficients.append(table[0])

    def at(place: float | Array) -> Array:
        height = coefficients[-1]
        for coefficient, node in zip(coefficients[-2::-1], nodes[-2::-1], strict=True):
            height = coefficient + (place - node) * height
        return np.asarray(height)

    return at


# A stretch of branch as a polynomial in a coordinate along it: dense output, and where values are passed --------------

CROSSING_SAMPLES = 33  # samples in which the crossings of a value, and the turns between them, are separated


@dataclass(frozen=True)
class Stretch:
    """z(tau) = sum_k coefficients[k] tau^k for 0 <= tau <= length; coefficients have shape (orders + 1, unknowns)."""

    coefficients: Array
    length: float

    def at(self, tau: float | Array) -> Array:
        """Point of the branch, or points, shape (tau, unknowns)."""
        return np.asarray(_powers(tau, self.coefficients.shape[0]) @ self.coefficients)

    def at_each(self, taus: Array) -> tuple[Array, Array]:
        """Points and slopes at places, shape (taus, unknowns) each: one product a place, whose last bit is its own."""
        powers = _powers(taus, self.coefficients.shape[0])[:, None]
        return (powers @ self.coefficients)[:, 0], (powers[..., :-1] @ self._derivative)[:, 0]

    def samples(self, end: float, count: int) -> tuple[Array, Array]:
        """Points and slopes at equal distances from the base to a place, shape (count, unknowns) each."""
        powers = _powers_of_unit(count, self.coefficients.shape[0]) * end ** np.arange(self.coefficients.shape[0])
        return powers @ self.coefficients, powers[:, :-1] @ self._derivative

    @cached_property
    def _derivative(self) -> Array:
        return np.arange(1, self.coefficients.shape[0])[:, None] * self.coefficients[1:]

    def slope(self, tau: float | Array) -> Array:
        """Derivative dz/dtau, of one shape with `at`."""
        return np.asarray(_powers(tau, self._derivative.shape[0]) @ self._derivative)

    def crossings(self, index: int, values: Iterable[float]) -> list[tuple[float, float]]:
        """All (tau, value) with tau in (0, length] at which component `index` equals one of `values`, ascending."""
        course = self.coefficients[:, index]
        turn = np.arange(1, course.size) * course[1:]
        grid, powers = np.linspace(0.0, self.length, CROSSING_SAMPLES), _powers_of_unit(CROSSING_SAMPLES, course.size)
        scaled = self.length ** np.arange(course.size)
        steepness, slopes = powers[:, :-1] @ (turn * scaled[:-1]), turn.tolist()
        turns = np.array([_zero(slopes, a, b) for a, b in _brackets(grid, steepness)])
        nodes, heights = grid, powers @ (course * scaled)
        if turns.size:
            order = np.argsort(np.concatenate([grid, turns]), kind="stable")
            nodes = np.concatenate([grid, turns])[order]
            heights = np.concatenate([heights, polyval(turns, course)])[order]
        found = set()
        for value in values:
            gap: list[float] | None = None
            for a, b in _brackets(nodes, heights - value):
                gap = gap or [float(course[0] - value), *course[1:].tolist()]
                found.add((_zero(gap, a, b), value))
        return sorted((tau, value) for tau, value in found if tau > 0.0)


@lru_cache(maxsize=8)
def _powers_of_unit(samples: int, count: int) -> Array:
    """Powers of samples of a stretch of length 1 at equal distances, shape (samples, count)."""
    powers = _powers(np.linspace(0.0, 1.0, samples), count)
    powers.flags.writeable = False  # kept and shared
    return powers


def _powers(tau: float | Array, count: int) -> Array:
    return np.asarray(np.power.outer(tau, np.arange(count)))


def _zero(coefficients: list[float], low: float, high: float) -> float:
    """The zero of a polynomial between two places, where it has opposite signs: Newton's method, or halving.

    Written out, as scipy.optimize takes as long to load as a family to be followed.
    """
    rises = _value(coefficients, low)[0] < 0.0
    closest, x = 1e-15 * abs(high - low), 0.5 * (low + high)
    for _ in range(100):
        value, slope = _value(coefficients, x)
        low, high = (x, high) if (value < 0.0) == rises else (low, x)
        step = value / slope if slope else np.inf
        following = x - step if low < x - step < high else 0.5 * (low + high)
        if value == 0.0 or abs(following - x) <= closest:
            return x
        x = following
    return x


def _value(coefficients: list[float], x: float) -> tuple[float, float]:
    """A polynomial and its derivative at x, by Horner's scheme."""
    value = slope = 0.0
    for coefficient in reversed(coefficients):
        slope, value = slope * x + value, value * x + coefficient
    return value, slope


def _brackets(nodes: Array, values: Array) -> list[tuple[float, float]]:
    """Neighbouring nodes between which the values change sign, or where they reach zero."""
    changes = np.flatnonzero((values[:-1] != 0.0) & (np.sign(values[:-1]) != np.sign(values[1:])))
    return [(float(nodes[i]), float(nodes[i + 1])) for i in changes]
