"""Collocation methods as Butcher tables: Gauss-Legendre and Radau IIA (Hairer and Wanner 1996, sections IV.5, II.7).

Tables come from numpy's Legendre polynomials, which keep digits that casadi.collocation_coeff loses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CollocationTable:
    """Increments over an interval of length 1 from the derivatives at the d stages.

    Tables are equal where all their numbers are: what is kept for a method is kept by its table.

    `nodes` are the stages, shape (d,); `ends` the places that the increments lead to, the end of the interval last,
    shape (rows,); `extended` the increments' weights, shape (rows, d). Where the last stage is the end of the interval
    there are d rows, else d + 1.
    """

    nodes: Array
    ends: Array
    extended: Array

    @cached_property
    def _numbers(self) -> tuple[bytes, ...]:
        return self.nodes.tobytes(), self.ends.tobytes(), self.extended.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, CollocationTable) and self._numbers == other._numbers

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def degree(self) -> int:
        """Number of stages d, which is the degree of the collocation polynomial."""
        return int(self.nodes.size)


@cache
def gauss_table(degree: int) -> CollocationTable:
    """The d-stage Gauss method: order 2d, and the end of the interval is no stage."""
    x, quadrature = legendre.leggauss(degree)
    # Lagrange polynomials in the Legendre basis, l_j = sum_k (2k+1) b_j P_k(x_j) P_k, integrated term by term.
    vandermonde = legendre.legvander(x, degree - 1)
    coefficients = (2 * np.arange(degree) + 1)[:, None] * vandermonde.T * (quadrature / 2.0)
    a = _integrals(x, degree) @ coefficients
    nodes = (x + 1.0) / 2.0
    return CollocationTable(nodes, np.append(nodes, 1.0), np.vstack([a, quadrature / 2.0]))


@cache
def radau_table(degree: int) -> CollocationTable:
    """The d-stage Radau IIA method: order 2d - 1, and the last stage is the end of the interval."""
    x = _radau_points(degree)
    # Legendre coefficients of the Lagrange polynomials: the inverse of the Vandermonde matrix in Legendre polynomials.
    coefficients = np.linalg.inv(legendre.legvander(x, degree - 1))
    nodes = (x + 1.0) / 2.0
    return CollocationTable(nodes, nodes, _integrals(x, degree) @ coefficients)


def _radau_points(degree: int) -> Array:
    """Roots of P_d - P_(d-1) on [-1, 1], the last of which is 1, to round-off by Newton's method."""
    polynomial = np.zeros(degree + 1)
    polynomial[-2:] = -1.0, 1.0
    x = np.sort(legendre.legroots(polynomial).real)
    for _ in range(3):
        x = x - legendre.legval(x, polynomial) / legendre.legval(x, legendre.legder(polynomial))
    x[-1] = 1.0
    return np.asarray(x)


def _integrals(x: Array, degree: int) -> Array:
    """Integrals of the Legendre polynomials P_0 .. P_(d-1) from -1 to x, halved, shape (len(x), d)."""
    vandermonde = legendre.legvander(x, degree)
    below = np.concatenate([np.zeros((x.size, 1)), vandermonde[:, : degree - 1]], axis=1)
    integrals = (vandermonde[:, 1:] - below) / (2 * (2 * np.arange(degree) + 1))
    integrals[:, 0] = (x + 1.0) / 2.0
    return np.asarray(integrals)


TABLES: Mapping[str, Callable[..., CollocationTable]] = {"gauss": gauss_table, "radau": radau_table}
