"""Turns of the continuation parameter between two points of a branch, also two within one step.

Its rate is known at both ends, and at a place between where it comes near zero or changes much. Hermite curves through
two and through three of them differ by what bounds their errors; a stretch is divided until the rate has no root within
that bound, or one that is simple.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.polynomial import Polynomial

from casadi_skin.follow.point import PointSolver
from casadi_skin.zero.settings import Point

WITHIN = 0.47  # of a stretch: where it is looked at; not the middle, where symmetric functions agree by accident
STEADY = 0.5  # of the largest rate on a stretch: the least one for which nothing turns back within it
DEEPEST = 14  # divisions of a stretch
BOUND = 0.25  # of the largest difference of both curves: the error of the finer one
MARGIN = 0.05  # of the change of the rate on a stretch: is added, for errors that both curves have in common
STILL = 1e-9  # rate of a quantity that does not change
_NEAR = 0.5 ** np.arange(7.0, 24.0, 2.0)
PLACES = np.concatenate([[0.0], _NEAR[::-1], np.linspace(0.0, 1.0, 65)[1:-1], 1.0 - _NEAR, [1.0]])


def turning(point_solver: PointSolver, before: Point, after: Point) -> list[tuple[Point, Point]]:
    """The parts of a stretch on each of which the quantity that is followed turns back once, in order."""
    return list(_turning(point_solver, before, after, 0))


def _turning(point_solver: PointSolver, before: Point, after: Point, depth: int) -> Iterator[tuple[Point, Point]]:
    turns = rate(before) * rate(after) < 0.0 and max(abs(rate(before)), abs(rate(after))) > STILL
    ends = _through(point_solver, [before, after])
    known = depth >= DEEPEST or (not turns and _steady(ends))
    middle = None if known else _between(point_solver, before, after, WITHIN)
    place = None if middle is None else _unsettled(ends, _through(point_solver, [before, middle, after]))
    if middle is None or place is None:
        if turns:
            yield before, after
        return
    divided = middle if place == WITHIN else _between(point_solver, before, after, place) or middle
    yield from _turning(point_solver, before, divided, depth + 1)
    yield from _turning(point_solver, divided, after, depth + 1)


def rate(point: Point) -> float:
    """Rate of the continuation parameter along the branch."""
    return float(point.tangent[point.problem.parameter_index])


def _between(point_solver: PointSolver, before: Point, after: Point, fraction: float) -> Point | None:
    """The point at a fraction of the way on the level of the second one, for the search alone."""
    correction, tangent = point_solver.corrected_along(before, after, fraction)
    if correction is None or tangent is None:
        return None
    return replace(after, z=correction.z, tangent=tangent, better=None, special="", walked=False)


def _through(point_solver: PointSolver, points: list[Point]) -> Polynomial:
    """The rate of the continuation parameter from 0 to 1, by the polynomial through values and rates at points."""
    problem = points[-1].problem
    index = problem.parameter_index
    z = [point.problem.prolong(point.z, problem) for point in points]
    t = [point.problem.prolong(point.tangent, problem) for point in points]
    row = point_solver.metric(problem, z[0]) * t[0]
    sigma = np.array([float(row @ (one - z[0])) for one in z])
    places, powers = sigma / sigma[-1], np.arange(2 * len(points))
    values = [one[index] - z[0][index] for one in z]
    rates = [one[index] / float(row @ one) * sigma[-1] for one in t]
    by_rate = powers * places[:, None] ** np.maximum(powers - 1, 0)
    matrix = np.vstack([places[:, None] ** powers, by_rate])
    return Polynomial(np.linalg.solve(matrix, np.concatenate([values, rates]))).deriv()


def _steady(found: Polynomial) -> bool:
    """Whether a rate is nowhere less than a share of its largest value, or vanishes throughout."""
    g = found(PLACES)
    size = np.abs(g)
    return bool(np.max(size) <= STILL or (np.all(g * g[0] > 0.0) and np.min(size) >= STEADY * np.max(size)))


def _unsettled(coarse: Polynomial, fine: Polynomial) -> float | None:
    """The place to divide a stretch; None where the rate has no root, or a simple one, within the bounds."""
    g, missed = fine(PLACES), float(np.max(np.abs(fine(PLACES) - coarse(PLACES))))
    half = np.where(PLACES < WITHIN, PLACES / WITHIN, (PLACES - WITHIN) / (1.0 - WITHIN))
    bound = BOUND * missed + MARGIN * float(np.ptp(g))
    sign = np.sign(g[0] if abs(g[0]) > STILL * np.max(np.abs(g)) else g[-1])  # a special point may be its start
    if g[0] * g[-1] < 0.0:
        shaky = bound * 4.0 * np.abs(1.0 - 2.0 * half) / np.where(PLACES < WITHIN, WITHIN, 1.0 - WITHIN)
        return None if np.all(np.sign(g[-1]) * fine.deriv()(PLACES) >= shaky) else WITHIN
    if np.all((sign * g > bound * 4.0 * half * (1.0 - half))[1:-1]):
        return None
    least = int(np.argmin(sign * g))
    return float(PLACES[least]) if sign * g[least] <= 0.0 < sign * fine(WITHIN) else WITHIN
