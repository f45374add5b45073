"""Branch points at which the Jacobian has two null vectors, where their extended equations are singular."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.continuation.points import Point

DOUBLE = "double branch point"
NODES = 0.5 - 0.5 * np.cos(np.pi * (np.arange(12) + 0.5) / 12)  # of a step
SECOND = 1e-3  # of its usual size: a second singular value that is zero


def double_between(
    solver: PointSolver, before: Point, after: Point, test: Callable[[Point], float], second: Callable[[Point], float]
) -> tuple[float, Point] | None:
    """The double branch point between two branch points, with its place; None where the Jacobian has one null vector.

    Unknowns, and a test that changes its sign there, are interpolated from places around it; `second` is the second
    smallest singular value of the Jacobian.
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
    found = replace(near, z=np.asarray(unknowns(roots[0])), error=error, better=None, requested=False, walked=False)
    if second(found) > SECOND * max(second(before), second(after)):
        return None
    return roots[0], replace(found, special=DOUBLE)
