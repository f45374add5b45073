"""Polynomials of a branch in a coordinate along it: cubics through two points, series, and where a value is passed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyval

from casadi_skin.zero.problem import Array

PREDICTING_POINTS = 4  # points that a prediction is made from
REACH_MARGIN = 1.0 + 1e-9  # times what all terms can change a value by: rounding is far below
CROSSING_SAMPLES = 33  # samples in which the crossings of a value, and the turns between them, are separated
ALIGNED_COSINE = 0.7  # cosine of the turn since a point, at least: three steps turn by less, a corner by more


@dataclass(frozen=True)
class LocalCurve:
    """z(sigma) = sum_k coefficients[k] sigma^k for 0 <= sigma <= length, of shape (orders + 1, unknowns)."""

    coefficients: Array
    length: float

    @classmethod
    def line(cls, z0: Array, t0: Array) -> LocalCurve:
        """The tangent line."""
        return cls(np.array([z0, t0]), np.inf)

    @classmethod
    def through(cls, z0: Array, t0: Array, z1: Array, t1: Array, row: Array) -> LocalCurve:
        """Cubic Hermite curve with z(0) = z0 and z(length) = z1; t0 and t1 are tangents of any length with row . t > 0.

        sigma = row . (z - z0) is the coordinate in which the corrector takes its step: the curve is a smooth graph.
        """
        sigma = float(row @ (z1 - z0))
        slope0, slope1 = t0 / float(row @ t0), t1 / float(row @ t1)
        chord = (z1 - z0) / sigma
        quadratic = (3.0 * chord - 2.0 * slope0 - slope1) / sigma
        return cls(np.array([z0, slope0, quadratic, (slope0 + slope1 - 2.0 * chord) / sigma**2]), sigma)

    def at(self, sigma: float | Array) -> Array:
        """Point of the curve, or points, shape (sigma, unknowns)."""
        return np.asarray(_powers(sigma, self.coefficients.shape[0]) @ self.coefficients)

    def at_each(self, sigmas: Array) -> tuple[Array, Array]:
        """Points and slopes at places, shape (sigmas, unknowns): one product a place, whose last bit is its own."""
        powers = _powers(sigmas, self.coefficients.shape[0])[:, None]
        return (powers @ self.coefficients)[:, 0], (powers[..., :-1] @ self._derivative)[:, 0]

    def samples(self, end: float, count: int) -> tuple[Array, Array]:
        """Points and slopes at equal distances from the start to a place, shape (count, unknowns) each."""
        powers = _powers_of_unit(count, self.coefficients.shape[0]) * end ** np.arange(self.coefficients.shape[0])
        return powers @ self.coefficients, powers[:, :-1] @ self._derivative

    @cached_property
    def _derivative(self) -> Array:
        return np.arange(1, self.coefficients.shape[0])[:, None] * self.coefficients[1:]

    def slope(self, sigma: float | Array) -> Array:
        """Derivative dz/dsigma, of one shape with `at`."""
        return np.asarray(_powers(sigma, self._derivative.shape[0]) @ self._derivative)

    def component(self, index: int) -> LocalCurve:
        """That of one of the unknowns."""
        return LocalCurve(self.coefficients[:, [index]], self.length)

    def crossings(self, index: int, values: Iterable[float], end: float | None = None) -> list[tuple[float, float]]:
        """All (sigma, value) with sigma in (0, end] at which component `index` equals one of `values`, ascending.

        `end` is the length of the curve by default.
        """
        course, end = self.coefficients[:, index], self.length if end is None else end
        scaled = course * end ** np.arange(course.size)
        values = [value for value in values if abs(scaled[0] - value) <= REACH_MARGIN * np.sum(np.abs(scaled[1:]))]
        if not values:
            return []
        turn = np.arange(1, course.size) * course[1:]
        grid, powers = np.linspace(0.0, end, CROSSING_SAMPLES), _powers_of_unit(CROSSING_SAMPLES, course.size)
        steepness, slopes = powers[:, :-1] @ (turn * end ** np.arange(turn.size)), turn.tolist()
        turns = np.array([_zero(slopes, a, b) for a, b in _brackets(grid, steepness)])
        nodes, heights = grid, powers @ scaled
        if turns.size:
            order = np.argsort(np.concatenate([grid, turns]), kind="stable")
            nodes = np.concatenate([grid, turns])[order]
            heights = np.concatenate([heights, polyval(turns, course)])[order]
        found = set()
        for value in values:
            gap = [float(course[0] - value), *course[1:].tolist()]
            found |= {(_zero(gap, a, b), value) for a, b in _brackets(nodes, heights - value)}
        return sorted((sigma, value) for sigma, value in found if sigma > 0.0)


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
