"""A stretch of branch as a polynomial in a coordinate along it: dense output, and where values are passed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyval

from casadi_skin.zero.problem import Array

GRID = 33  # samples in which the crossings of a value, and the turns between them, are separated


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
        grid, powers = np.linspace(0.0, self.length, GRID), _powers_of_unit(GRID, course.size)
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
