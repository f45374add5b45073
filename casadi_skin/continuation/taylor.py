"""A stretch of branch as a polynomial in a coordinate along it: dense output, and where a value is passed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadi_skin.bvp.problem import Array

GRID = 33  # samples in which the crossings of a value, and the turns between them, are told apart


@dataclass(frozen=True)
class Stretch:
    """z(tau) = sum_k coefficients[k] tau^k for 0 <= tau <= length; coefficients have shape (orders + 1, unknowns)."""

    coefficients: Array
    length: float

    def at(self, tau: float) -> Array:
        """Point of the branch."""
        return np.asarray(tau ** np.arange(self.coefficients.shape[0]) @ self.coefficients)

    @cached_property
    def _derivative(self) -> Array:
        return np.arange(1, self.coefficients.shape[0])[:, None] * self.coefficients[1:]

    def slope(self, tau: float) -> Array:
        """Derivative dz/dtau."""
        return np.asarray(tau ** np.arange(self._derivative.shape[0]) @ self._derivative)

    def crossings(self, index: int, value: float) -> list[float]:
        """All tau in (0, length] at which component `index` equals `value`, ascending."""
        from scipy.optimize import brentq

        c = self.coefficients[:, index].copy()
        c[0] -= value
        gap = np.polynomial.Polynomial(c)
        turn = gap.deriv()
        grid = np.linspace(0.0, self.length, GRID)
        slopes = turn(grid)
        turns = [brentq(turn, a, b) for a, b in _brackets(grid, slopes)]
        nodes = np.sort(np.concatenate([grid, turns]))
        found = [float(brentq(gap, a, b, xtol=1e-15 * self.length)) for a, b in _brackets(nodes, gap(nodes))]
        return sorted({tau for tau in found if tau > 0.0})


def _brackets(nodes: Array, values: Array) -> list[tuple[float, float]]:
    """Neighbouring nodes between which the values change sign, or where they reach zero."""
    changes = np.flatnonzero((values[:-1] != 0.0) & (np.sign(values[:-1]) != np.sign(values[1:])))
    return [(float(nodes[i]), float(nodes[i + 1])) for i in changes]
