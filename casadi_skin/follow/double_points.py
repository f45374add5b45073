"""Points of codimension two at which extended equations are singular, as where two null vectors meet: interpolated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from casadi_skin.follow.point import PointSolver
from casadi_skin.zero.settings import Point

DOUBLE = "double branch point"
NODES = 0.5 - 0.5 * np.cos(np.pi * (np.arange(12) + 0.5) / 12)  # of a step
SECOND = 1e-3  # of its usual size: a second singular value that is zero


def double_between(
    solver: PointSolver, before: Point, after: Point, test: Callable[[Point], float], second: Callable[[Point], float]
) -> tuple[float, Point] | None:
    """The double branch point between two branch points, with its place; None where the Jacobian has one null vector.

    `test` changes its sign there; `second` is the second smallest singular value of the Jacobian.
    """
    found = interpolated(solver, before, after, test)
    if found is None or second(found[1]) > SECOND * max(second(before), second(after)):
        return None
    return found[0], replace(found[1], special=DOUBLE)


def interpolated(
    solver: PointSolver, before: Point, after: Point, test: Callable[[Point], float]
) -> tuple[float, Point] | None:
    """The point between two at which a test changes its sign, with its place; None where it does not.

    Unknowns and test are interpolated from places around it.
    """
    from scipy.interpolate import KroghInterpolator
    from scipy.optimize import brentq

    tried = [(float(f), solver.along(before, after, float(f))) for f in NODES]
    around = [(f, point) for f, point in tried if point is not None]
    places, values = np.array([f for f, _ in around]), np.array([test(point) for _, point in around])
    roots = list[float]()
    for chosen in (slice(None), slice(1, -1)):  # fewer of them, for the error
        polynomial = KroghInterpolator(places[chosen], values[chosen])
        if polynomial(0.0) * polynomial(1.0) >= 0.0:
            return None
        roots.append(float(brentq(lambda f, p=polynomial: float(p(f)), 0.0, 1.0, xtol=1e-14)))
    near = min(around, key=lambda one: abs(one[0] - roots[0]))[1]
    unknowns = KroghInterpolator(places, [point.problem.prolong(point.z, near.problem) for _, point in around])
    rate = float(np.asarray(unknowns.derivative(roots[0]))[-1])
    apart = abs((roots[1] - roots[0]) * rate) + near.error.relative(1.0)
    error = replace(near.error, parameter=float(apart))
    z = np.asarray(unknowns(roots[0]))
    return roots[0], replace(near, z=z, error=error, better=None, requested=False, walked=False)
