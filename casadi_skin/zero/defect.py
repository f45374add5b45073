"""The error of a collocation solution from its defect, on its own mesh and with the factors at hand.

A polynomial that satisfies u' = f at the stages has a defect f(u) - u' between them. Integrated from the start of its
interval it is what the solution leaves in the equations of a method with twice as many stages, and one solve gives the
correction to these (deferred correction: Pereyra 1968; Ascher, Mattheij and Russell 1995, section 5.5.3). The defect
is the stages' polynomial times a smooth function, which is interpolated at the ends of the interval and halfway
between each two stages: no gap is left unseen.
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
