"""The quadratic term at folds of boundary-value problems along a curve of them: it vanishes where two of them meet.

With the null vectors v and psi of the linearised equations it is psi . F''(v, v) / 2 (Govaerts 2000, chapter 8), by
differences of the Jacobian, as conditions may be nonlinear as well; at a cusp the parameters do not depend on the place
to first order. The sign of psi is that for which the normal of the curve in the plane of the two parameters, psi . F_p,
goes on as it does through a cusp.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import Point
from casadi_skin.critical_orbits.followed import Followed
from casadi_skin.critical_orbits.linearised import Linearised, null_vectors

DIFFERENCE = 1e-4  # of the null vector, which is as large as the solution


def quadratic_term(space: Followed, beside: Point) -> Callable[[Point], float]:
    """The quadratic term as a function of points of the curve; its sign goes on from a point beside them."""
    reference = _normal(space, beside)[1]

    def term(point: Point) -> float:
        psi, normal = _normal(space, point)
        linear = space.linearised(point)
        v = _null_vector(linear)
        moved = np.zeros(linear.problem.size)
        moved[_places(linear)] = DIFFERENCE * v
        ahead, behind = (replace(linear, z=linear.z + sign * moved).jacobian for sign in (1.0, -1.0))
        bent = psi @ ((ahead - behind) @ v) / (2.0 * DIFFERENCE)
        return float(0.5 * np.copysign(1.0, normal @ reference) * bent)

    return term


def _normal(space: Followed, point: Point) -> tuple[Array, Array]:
    """The left null vector of norm 1, and its products with the derivatives by both parameters."""
    linear = space.linearised(point)
    psi = np.asarray(null_vectors(linear.jacobian)[1])
    return psi, np.array([psi @ linear.by_scalar(len(linear.statement.free)), psi @ linear.by_scalar(-1)])


def _null_vector(linear: Linearised) -> Array:
    """The null vector that is among the unknowns, in the order of the columns of the derivative."""
    problem, n, free = linear.problem, linear.components, len(linear.statement.free)
    states = linear.z[: problem.states].reshape(problem.columns, -1)[:, n : 2 * n]
    changes = linear.z[problem.states + free + 1 :][:free]
    return np.concatenate([states.ravel(), changes])


def _places(linear: Linearised) -> Array:
    """Places of the solution's own unknowns among all of them."""
    problem, n = linear.problem, linear.components
    states = np.arange(problem.states).reshape(problem.columns, -1)[:, :n].ravel()
    return np.concatenate([states, problem.states + np.arange(len(linear.statement.free))])
