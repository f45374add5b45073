"""The intervals of a collocation mesh: equidistribution of a monitor of the solution.

With polynomials of degree d on intervals of length h the error between mesh points is proportional to h^(d+1) times
the derivative of order d + 1. That derivative is estimated from the differences of the constant derivatives of order d
of neighbouring intervals, and its root of order d + 1 is spread evenly (de Boor 1973; Ascher, Mattheij and Russell
1995, section 9.1). Lengths are relative to the whole: they sum to 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.discretisation import Discretisation
from casadi_skin.zero.problem import Array

DENSITY_FLOOR = 0.2  # of the mean density: no interval is longer than 1/DENSITY_FLOOR mean ones
ON_EDGE = 1e-14  # of the whole: distance of a place from an edge that is rounding
NEIGHBOUR_LENGTH_RATIO = 2.0  # largest ratio of the lengths of neighbouring intervals, about


def uniform(intervals: int) -> Array:
    """Equal lengths, shape (intervals,)."""
    return np.full(intervals, 1.0 / intervals)


def graded(intervals: int, smallest: float) -> Array:
    """Lengths that grow by a factor from `smallest` at both ends up to a quarter, between which they are equal."""
    outer = intervals // 3
    left = np.geomspace(smallest, 0.25, outer)
    inner = np.linspace(0.25, 0.75, intervals - 2 * outer + 1)[1:-1]
    return np.diff(np.concatenate([[0.0], left, inner, 1.0 - left[::-1], [1.0]]))


def edges(lengths: Array) -> Array:
    """Ends of the intervals from 0 to 1, shape (intervals + 1,)."""
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    return np.asarray(ends / ends[-1])


def density(lengths: Array, leading: Array, degree: int, noise: float = 0.0) -> Array:
    """Wanted number of intervals per unit of length, up to a factor, in each interval; shape (intervals,).

    `leading` holds the coefficient of s^degree of each interval's polynomial in its own coordinate s in [0, 1], shape
    (intervals, components); `noise` is the size of its round-off. The density is smoothed, has a floor, and varies
    slowly enough for neighbouring intervals to be of similar length (Kautsky and Nichols 1980).
    """
    K = lengths.size
    if K == 1:
        return np.ones(1)
    scale = lengths**-degree
    jumps = np.max(np.abs(np.diff(leading * scale[:, None], axis=0)), axis=1)
    jumps = np.maximum(jumps - noise * (scale[1:] + scale[:-1]), 0.0)
    slopes = jumps / (0.5 * (lengths[1:] + lengths[:-1]))
    wanted = np.concatenate([slopes[:1], 0.5 * (slopes[1:] + slopes[:-1]), slopes[-1:]]) ** (1.0 / (degree + 1))
    if not np.any(wanted):
        return np.ones(K)
    return _slowly_varying(lengths, wanted)


def _slowly_varying(lengths: Array, wanted: Array) -> Array:
    """The smallest density above `wanted` and the floor whose inverse changes no faster than NEIGHBOURS allows."""
    middles = edges(lengths)[1:] - 0.5 * lengths
    padded = wanted
    for _ in range(3):  # floor and rate depend on the mean of the result
        mean = float(lengths @ padded)
        rate = np.log(NEIGHBOUR_LENGTH_RATIO) * lengths.size / mean
        inverse = 1.0 / np.maximum(wanted, DENSITY_FLOOR * mean)
        forward = rate * middles + np.minimum.accumulate(inverse - rate * middles)
        backward = np.minimum.accumulate((inverse + rate * middles)[::-1])[::-1] - rate * middles
        padded = 1.0 / np.minimum(forward, backward)
    return np.asarray(padded)


def equidistributed(lengths: Array, wanted: Array, intervals: int) -> Array:
    """Lengths of `intervals` intervals that hold equal parts of the density `wanted` on the mesh of `lengths`."""
    total = np.concatenate([[0.0], np.cumsum(lengths * wanted)])
    return np.diff(np.interp(np.linspace(0.0, total[-1], intervals + 1), total, edges(lengths)))


def imbalance(lengths: Array, wanted: Array) -> float:
    """Largest over mean part of the density that an interval holds; 1 where it is spread evenly."""
    parts = lengths * wanted
    return float(np.max(parts) / np.mean(parts))


def with_edges(lengths: Array, places: Array) -> Array:
    """The mesh moved so that an edge is at each of the places, in ascending order between 0 and 1.

    As it is where they are edges already, or are more than there are edges between the intervals.
    """
    ends, inner = edges(lengths), lengths.size - 1
    nearest = np.interp(places, ends, np.arange(ends.size))
    if places.size > inner or not places.size or np.all(np.abs(ends[np.round(nearest).astype(int)] - places) < ON_EDGE):
        return lengths
    order = np.arange(places.size)
    chosen = np.maximum.accumulate(np.round(nearest) - order) + order  # each place its own edge
    last = inner - places.size + 1 + order
    chosen = np.clip(np.minimum(chosen, last), 1 + order, last).astype(int)
    fixed = np.concatenate([[0], chosen, [lengths.size]])
    return np.diff(np.interp(ends, ends[fixed], np.concatenate([[0.0], places, [1.0]])))


def resampled(lengths: Array, intervals: int) -> Array:
    """A mesh of another number of intervals placed alike: a multiple of the number divides each interval evenly."""
    return equidistributed(lengths, 1.0 / lengths, intervals)


# The error of a collocation solution from its defect, on its own mesh and with the factors at hand --------------------


@dataclass(frozen=True, eq=False)
class DefectTable:
    """Weights of the defect at check points of an interval of length 1: its start, inner ones, its end if no stage.

    Attributes:
        inner: the inner points, halfway between each two stages.
        values: weights of the start and the stages in the polynomial at the inner points.
        slopes: the same in its derivative at all points.
        increments: weights of the defects in their integral to the method's ends.
        between: the same to the inner points, less the polynomial through those at the start and the stages.
        quadrature: weights of values at the stages, then at all points, in the integral over the interval.
    """

    inner: Array
    values: Array
    slopes: Array
    increments: Array
    between: Array
    quadrature: tuple[Array, Array]

    @property
    def points(self) -> int:
        """Number of check points."""
        return int(self.slopes.shape[0])


@lru_cache(maxsize=16)
def defect_table(table: CollocationTable) -> DefectTable:
    """The weights that belong to a collocation method."""
    stages, targets = table.nodes, table.ends
    d, support, inner = stages.size, np.append(0.0, stages), 0.5 * (stages[1:] + stages[:-1])
    points = np.concatenate([[0.0], inner, np.ones(targets.size - d)])
    values, at_points = _polynomials(support, inner), _node_polynomial(stages, points)

    def defects(t: Array) -> Array:
        return np.asarray(_node_polynomial(stages, t)[:, None] * _polynomials(points, t) / at_points)

    increments, to_inner = (_integrals(defects, ends, 2 * d) for ends in (targets, inner))
    whole = _integrals(lambda t: _polynomials(np.concatenate([stages, points]), t), np.ones(1), 2 * d)[0]
    between = to_inner - values[:, 1:] @ increments[:d]
    slopes = _polynomials(support, points, derivative=1)
    return DefectTable(inner, values, slopes, increments, between, (whole[:d], whole[d:]))


def missed(equations: Discretisation, z: Array, numbers: Array) -> tuple[Array, Array]:
    """The residual of the solution z in a method of twice as many stages, on its own mesh.

    Arguments:
        equations: the equations that z solves.
        z: unknowns.
        numbers: lengths of the intervals, and constants.

    Returns:
        The residual, shape (size - 1,), and the integral of the defect from the start of its interval to each inner
        check point, less the polynomial through those at the stages, shape (inner points, states).
    """
    of, table = equations.layout, defect_table(equations.table)
    n, K, rows = of.states, of.intervals, of.increments
    lengths, constants = numbers[:K], numbers[K:]
    values, scalars = z[: of.values].reshape(-1, n), z[of.values :]
    column = np.arange(K)[:, None] * rows
    polynomials = values[column + np.arange(of.degree + 1)]
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    inner = ends[:-1, None] + lengths[:, None] * table.inner
    places = np.concatenate([inner.ravel(), ends])[:, None]
    states = np.concatenate([(table.values @ polynomials).reshape(-1, n), values[::rows]])
    field, integrands = (_by_intervals(f, K, table) for f in equations.along(places, states, scalars, constants))
    defects = lengths[:, None, None] * field - table.slopes @ polynomials
    residual = [-(table.increments @ defects).ravel(), np.zeros(of.conditions)]
    if of.integrals:
        at_stages = equations.along(*equations.stages(z, numbers))[1][:-1].reshape(K, of.degree, -1)
        whole = table.quadrature[0] @ at_stages + table.quadrature[1] @ integrands
        residual.append(lengths @ whole - lengths @ (equations.table.extended[-1] @ at_stages))
    return np.concatenate(residual), (table.between @ defects).reshape(-1, n)


def _by_intervals(found: Array, intervals: int, table: DefectTable) -> Array:
    """Values at the check points, inner ones first, then all ends, as an array (intervals, points, values)."""
    count = intervals * table.inner.size
    inner, ends = found[:count].reshape(intervals, table.inner.size, found.shape[1]), found[count:, None]
    parts = [ends[:-1], inner, ends[1:]]
    return np.concatenate(parts[: 1 + table.points - table.inner.size], axis=1)


def _polynomials(support: Array, t: Array, derivative: int = 0) -> Array:
    """Weights of values at `support` in the polynomial through them at t, or in its derivative, a row each."""
    degree = support.size - 1
    coefficients = np.linalg.inv(legendre.legvander(2.0 * support - 1.0, degree))
    if derivative:
        coefficients, degree = 2.0 * legendre.legder(coefficients), max(degree - 1, 0)
    return np.asarray(legendre.legvander(2.0 * t - 1.0, degree) @ coefficients)


def _node_polynomial(stages: Array, t: Array) -> Array:
    return np.asarray(np.prod(t[:, None] - stages, axis=1))


def _integrals(weights: Callable[[Array], Array], ends: Array, degree: int) -> Array:
    """Integrals of the polynomials that the weights are, of a degree, from 0 to each end, a row each."""
    x, quadrature = legendre.leggauss(degree // 2 + 1)
    return (
        np.stack([0.5 * end * quadrature @ weights(0.5 * end * (x + 1.0)) for end in ends])
        if ends.size
        else (np.zeros((0, weights(ends).shape[1])))
    )
