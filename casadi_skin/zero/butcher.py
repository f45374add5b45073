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
    """A collocation method on an interval of length 1: increments from the derivatives at the d stages.

    The values of an interval are the state at its start and at the `ends`; the first d + 1 of them determine the
    polynomial of degree d. Tables are equal where all their numbers are: they are keys of what is kept for a method.

    Attributes:
        nodes: places of the stages, each the start or among the ends, ascending, shape (d,).
        ends: places that the increments lead to, the end of the interval last, ascending, shape (rows,), rows >= d.
        extended: weights of the increments, shape (rows, d).
        order: of the errors at the ends of intervals.
    """

    nodes: Array
    ends: Array
    extended: Array
    order: int

    @cached_property
    def _numbers(self) -> tuple[bytes, ...]:
        return self.nodes.tobytes(), self.ends.tobytes(), self.extended.tobytes()

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self._numbers == other._numbers

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def degree(self) -> int:
        """Number of stages d, which is the degree of the collocation polynomial."""
        return int(self.nodes.size)

    @cached_property
    def stages(self) -> tuple[int, ...]:
        """Which of the values of an interval are those at the stages, counted from its start."""
        return tuple(np.searchsorted(np.append(0.0, self.ends), self.nodes).tolist())

    @cached_property
    def support(self) -> Array:
        """Places of the values that determine the polynomial, shape (d + 1,)."""
        return np.append(0.0, self.ends)[: self.degree + 1]

    @cached_property
    def slopes(self) -> Array:
        """Weights of the values at the support in the derivative at the start and at the ends, (ends + 1, d + 1)."""
        return _polynomials(self.support, np.append(0.0, self.ends), derivative=1)

    @cached_property
    def matrix(self) -> Array:
        """Increments from the start to the stages, shape (d, d)."""
        return np.vstack([np.zeros(self.degree), self.extended])[list(self.stages)]

    @cached_property
    def defect(self) -> DefectTable:
        """Weights of the defect of a solution, from which its error follows."""
        return _defect_table(self)


@cache
def gauss_table(degree: int) -> CollocationTable:
    """The d-stage Gauss method: order 2d, and the end of the interval is no stage."""
    x, quadrature = legendre.leggauss(degree)
    # Lagrange polynomials in the Legendre basis, l_j = sum_k (2k+1) b_j P_k(x_j) P_k, integrated term by term.
    vandermonde = legendre.legvander(x, degree - 1)
    coefficients = (2 * np.arange(degree) + 1)[:, None] * vandermonde.T * (quadrature / 2.0)
    a = _integrals(x, degree) @ coefficients
    nodes = (x + 1.0) / 2.0
    return CollocationTable(nodes, np.append(nodes, 1.0), np.vstack([a, quadrature / 2.0]), 2 * degree)


@cache
def radau_table(degree: int) -> CollocationTable:
    """The d-stage Radau IIA method: order 2d - 1, and the last stage is the end of the interval."""
    x = _radau_points(degree)
    # Legendre coefficients of the Lagrange polynomials: the inverse of the Vandermonde matrix in Legendre polynomials.
    coefficients = np.linalg.inv(legendre.legvander(x, degree - 1))
    nodes = (x + 1.0) / 2.0
    return CollocationTable(nodes, nodes, _integrals(x, degree) @ coefficients, 2 * degree - 1)


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


# The error of a collocation solution from its defect, on its own mesh and with the factors at hand --------------------


@dataclass(frozen=True, eq=False)
class DefectTable:
    """Weights of the defect at check points of an interval of length 1: inner ones, its start and end if no stages.

    Attributes:
        inner: the inner points, halfway between each two stages.
        checked: which of the start, the inner points and the end are check points, shape (inner points + 2,).
        values: weights of the values that determine the polynomial in it at the inner points.
        slopes: the same in its derivative at all check points.
        increments: weights of the defects in their integral to the method's ends.
        between: the same to the inner points, less the polynomial through those at the support.
        quadrature: weights of values at the stages, then at all points, in the integral over the interval.
    """

    inner: Array
    checked: NDArray[np.bool_]
    values: Array
    slopes: Array
    increments: Array
    between: Array
    quadrature: tuple[Array, Array]


def _defect_table(table: CollocationTable) -> DefectTable:
    stages, d = table.nodes, table.degree
    inner = 0.5 * (stages[1:] + stages[:-1])
    places = np.concatenate([[0.0], inner, [1.0]])
    checked = ~np.isin(places, stages)
    points = places[checked]
    values, at_points = _polynomials(table.support, inner), _node_polynomial(stages, points)

    def defects(t: Array) -> Array:
        return np.asarray(_node_polynomial(stages, t)[:, None] * _polynomials(points, t) / at_points)

    increments, to_inner = (_integrals_of(defects, ends, 2 * d) for ends in (table.ends, inner))
    whole = _integrals_of(lambda t: _polynomials(np.concatenate([stages, points]), t), np.ones(1), 2 * d)[0]
    between = to_inner - values[:, 1:] @ increments[:d]
    slopes = _polynomials(table.support, points, derivative=1)
    return DefectTable(inner, checked, values, slopes, increments, between, (whole[:d], whole[d:]))


def _polynomials(support: Array, t: Array, derivative: int = 0) -> Array:
    """Weights of values at `support` in the polynomial through them at t, or in its derivative, a row each."""
    degree = support.size - 1
    coefficients = np.linalg.inv(legendre.legvander(2.0 * support - 1.0, degree))
    if derivative:
        coefficients, degree = 2.0 * legendre.legder(coefficients), max(degree - 1, 0)
    return np.asarray(legendre.legvander(2.0 * t - 1.0, degree) @ coefficients)


def _node_polynomial(stages: Array, t: Array) -> Array:
    return np.asarray(np.prod(t[:, None] - stages, axis=1))


def _integrals_of(weights: Callable[[Array], Array], ends: Array, degree: int) -> Array:
    """Integrals of the polynomials that the weights are, of a degree, from 0 to each end, a row each."""
    x, quadrature = legendre.leggauss(degree // 2 + 1)
    return (
        np.stack([0.5 * end * quadrature @ weights(0.5 * end * (x + 1.0)) for end in ends])
        if ends.size
        else (np.zeros((0, weights(ends).shape[1])))
    )
