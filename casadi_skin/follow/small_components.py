"""Components of an orbit that are far smaller than the largest, recomputed to relative accuracy."""

from __future__ import annotations

import numpy as np

from casadi_skin.follow.point_solver import PointSolver
from casadi_skin.follow.settings import Point
from casadi_skin.zero.problem import Array, SingularError
from casadi_skin.zero.trigonometric import TrigonometricProblem

SMALL = 1e-7  # of the largest state: below it the corrector leaves errors relative to the largest
SMALLEST = 1e-250  # of the largest state: below it doubles run out


def with_small_components(point_solver: PointSolver, point: Point) -> tuple[Array, float]:
    """Unknowns whose small components are right relative to themselves, and down to which size, of the largest.

    Small components are left out of the guess of a Newton step, which then does not correct them but solves for them.
    """
    problem = point.problem
    if not isinstance(problem, TrigonometricProblem):
        return point.z, SMALL
    states = np.abs(point.z[: problem.states])
    small = np.flatnonzero(states < SMALL * np.max(states))
    if small.size == 0:
        return point.z, SMALLEST
    guess = point.z.copy()
    guess[small] = 0.0
    row = point_solver.metric(problem, point.z) * point.tangent
    residual, nonzeros = problem.evaluate(guess)
    try:
        solve = point_solver.levels.solver(problem).factor(guess, nonzeros, row)
    except SingularError:
        return point.z, SMALL
    step = solve(np.append(residual, row @ (guess - point.z)))
    z = point.z.copy()
    z[small] = -step[small]
    return z, SMALLEST
